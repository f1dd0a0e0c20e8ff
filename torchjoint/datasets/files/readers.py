"""Reads single files: images, depth, matrices, arrays. Content does not choose the decoder. Errors name the file."""

import hashlib
import io
import os
import re
import stat
import struct
import warnings
import zlib
from collections.abc import Iterable, Iterator, Set
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
from PIL import ExifTags, Image, ImageOps, UnidentifiedImageError
from torch import Tensor

from torchjoint.datasets.files import las
from torchjoint.datasets.files.text import parse_numbers
from torchjoint.runtime import bounds
from torchjoint.runtime.archives import as_int64, read_npy
from torchjoint.runtime.foreign_files import damage_is, has_file, has_folder, is_there, read_file, read_text

#: Formats of images that are read. The content must not choose another decoder: Pillow gives EPS to Ghostscript, which
#: runs it; a TIFF file can name the same bytes 65,000 times.
RASTERS = ("PNG", "JPEG", "WEBP", "BMP", "PPM")
#: What colours of 12 bits in 16 are below, after Pillow has dropped the lower 8 bits.
DARK = 17
#: Folders with one of these files hold results, of one recording or of many. They are no part of a recording.
RESULTS = frozenset({"run.yaml", "batch.yaml"})
#: Suffixes of clouds and recordings that stand alone: no other file belongs to them.
ALONE = (".ply", ".npy", ".npz", ".xyz", ".txt", ".asc", ".csv", ".pts", *las.SUFFIXES, ".e57", ".off", ".stl", ".r3d")


def read_raster(path: Path, *, header_only: bool = False) -> Image.Image:
    """Reads an image file (or only its header); errors as of :func:`decode_image`, also if it is missing."""
    return decode_image(read_file(path, "an image", bounds.IMAGE_BYTES), str(path), header_only=header_only)


def decode_image(data: bytes, name: str, *, header_only: bool = False, kinds: tuple[str, ...] = RASTERS) -> Image.Image:
    """Decodes an image file's bytes (or only its header); errors begin with `name`."""
    try:
        image = Image.open(io.BytesIO(data), formats=kinds)
        bounds.check_pixels(image.height, image.width)
        if image.format == "PPM" and isinstance(to := image.tile[0].args, tuple) and to[1] not in (0, 255, 65535):
            raise ValueError(f"expected 255 or 65535 as its largest number, got {to[1]}: Pillow scales others")
        bounds.check(len(image.info.get("exif", b"")), bounds.EXIF_BYTES, "bytes of EXIF")
        scans = data.count(b"\xff\xda") if image.format == "JPEG" else 0
        bounds.check(scans * image.width * image.height, bounds.SCANNED, "pixels in all scans")
        if not header_only:
            if image.format == "PNG":  # Pillow compares the checksums of pixels only if it is asked to
                Image.open(io.BytesIO(data), formats=("PNG",)).verify()
            if data[:2] == b"\xff\xd8" and data.endswith(bytes(64)) and data.rstrip(b"\0")[-2:] != b"\xff\xd9":
                raise ValueError("its end is lost, there are zeros in its place")
            how = str([tile.args for tile in image.tile])
            image.load()
            image.info["step"] = 85 if "L;2" in how else 17 if "L;4" in how else 1  # Pillow stretches to 255
            deep = {"RGB": 3, "RGBA": 3, "LA": 1}.get(image.mode, 0) if re.search(";16B|65535", how) else 0
            if deep and (top := int(np.asarray(image)[..., :deep].max())) < DARK:
                raise ValueError(f"expected colours up to 65535, got less than {256 * (top + 1)}; make them 8 bits")
    except (OSError, SyntaxError, ValueError, TypeError, EOFError, OverflowError, MemoryError, struct.error,
            Image.DecompressionBombError, Image.DecompressionBombWarning, zlib.error) as error:  # fmt: skip
        # Pillow's own message names the buffer in memory.
        reason = f"expected one of {', '.join(kinds)}" if isinstance(error, UnidentifiedImageError) else error
        raise ValueError(f"{name}: not a whole image: {reason}") from error
    return image


def read_image(path: Path, camera_size: tuple[int, int] | None = None) -> Tensor:
    """Reads an 8-bit image of any mode.

    Args:
        path: of the image.
        camera_size: (H, W) for which its camera was calibrated; tells whether to turn an image as its EXIF tag says.

    Returns:
        [3, H, W] uint8 RGB.
    """
    return rgb_of(_as_calibrated(read_raster(path), camera_size, str(path)), str(path))


def read_image_size(path: Path) -> tuple[int, int]:
    """Returns (H, W) of an image, from the header of its file; it must be clear whether the image is to be turned."""
    image = read_raster(path, header_only=True)
    if "exif" in image.info:  # of a PNG without, Pillow would decode the pixels
        _as_calibrated(image, None, str(path))
    return image.height, image.width


def of_size(image: Tensor, file: object, other: Path) -> Tensor:
    """Returns an image [..., H, W] of a file, which must have the size of another file's image."""
    if (came := tuple(image.shape[-2:])) != (size := read_image_size(other)):
        raise ValueError(f"{file}: expected {list(size)} pixels, as {other.name} has, got {list(came)}")
    return image


def read_depth(path: Path, unit: float = 0.001) -> Tensor:
    """Reads a 16-bit depth image, one step = `unit` metres, as [H, W] float32 metres; 0 and 65535 give 0 = unknown."""
    image = read_raster(path)
    if image.mode not in ("I;16", "I;16B", "I"):
        raise ValueError(f"{path}: expected a 16-bit grey image, got mode {image.mode}")
    raw = np.array(image, dtype=np.int32)
    return torch.from_numpy(np.where((raw == 65535) | (raw < 0), 0, raw).astype(np.float32) * np.float32(unit))


def read_label_image(path: Path) -> Tensor:
    """Reads a label image of 2 to 16 bits; returns [H, W] int64. Warns if its largest number may mean none."""
    image = read_raster(path)
    labels, most = labels_of(image, str(path)), 255 if image.mode in ("L", "P") else 65535
    if int(labels.max()) == most and 0 < int(labels.where(labels < most, 0).max()) < most - 1:
        told = f"{path.parent}: {most} is a label in images of labels; if it means none, as in VOC, make it 0"
        warnings.warn(told, stacklevel=3)
    return labels


def read_matrix(path: Path, shape: tuple[int, int]) -> Tensor:
    """Reads a matrix from a text file; returns float64 of this shape."""
    words = read_text(path, f"a {shape[0]}x{shape[1]} matrix", bounds.LINE).replace(",", " ").split()
    values = torch.tensor(parse_numbers(words, str(path), finite=False), dtype=torch.float64)
    if len(values) != shape[0] * shape[1]:
        raise ValueError(f"{path}: expected {shape[0]}x{shape[1]} = {shape[0] * shape[1]} numbers, got {len(values)}")
    return values.reshape(shape)


def read_array(path: Path) -> Tensor:
    """Reads a .npy file of numbers, of any shape."""
    array = read_npy(path)
    with damage_is(f"{path}: not a whole .npy array of numbers"):
        array = as_int64(array, "array")  # torch supports few operations on unsigned numbers
        return torch.from_numpy(np.array(array, dtype=array.dtype.newbyteorder("="), order="C", subok=False))


def fingerprint(path: Path, without: Iterable[Path] = (), *, changed: bool = False, alone: bool = False) -> str:
    """Returns a hash of file names, sizes and times, to detect changed files.

    That of a folder covers all files in and below it, without folders of results, and what formats read around it;
    links are followed. That of a file covers its folder, if formats read other names there. That of a scan covers files
    of the same stem in sibling folders (KITTI's layout), that of a file with a suffix in `ALONE` only itself.

    Args:
        path: of a recording.
        without: files and folders to ignore, such as the result of a run if it is inside the recording.
        changed: whether also the times (ctime) count that no copy keeps and no program sets: for a run that goes on.
        alone: whether any file counts only itself.
    """
    if not is_there(path):
        raise FileNotFoundError(f"{path} does not exist")
    path = path.absolute()  # a batch gives the same recording by a relative path and by the whole one
    # VGGT's predictions.npz has others beside it
    if has_file(path) and (alone or (path.suffix.lower() in ALONE and path.name != "predictions.npz")):
        return hashlib.sha256(repr((str(path.resolve()), *_size_and_time(path, changed))).encode()).hexdigest()
    folder = path if has_folder(path) else path.parent
    left_out = {os.path.abspath(one) for one in without}
    is_scan = folder != path and path.suffix.lower() in (".bin", ".pcd", ".png")
    # A folder of this stem is OUT.partial of a run beside the scan.
    beside = (path, *(one for one in folder.parent.glob(f"*/{path.stem}.*") if not one.is_dir())) if is_scan else ()
    near = () if is_scan else {*files_below(folder, left_out), *_around(folder, left_out)}
    stats = [(str(file), *_size_and_time(file, changed)) for file in sorted({*near, *beside})]
    return hashlib.sha256(repr((str(path.resolve()), stats)).encode()).hexdigest()


@contextmanager
def unchanged(*files: Path) -> Iterator[None]:
    """Raises ValueError if files are not what they were before, by size and time: for who reads them more than once."""
    before = [_size_and_time(file, False) for file in files]
    yield
    if [_size_and_time(file, False) for file in files] != before:
        raise ValueError(f"{', '.join(map(str, files[:9]))}: changed while it was read; start again")


def _around(folder: Path, without: Set[str]) -> Iterator[Path]:
    """What formats read around a folder: Replica's camera and mesh, the scans of ScanNet, the images of a model."""
    name, beside = folder.name, folder.parent
    files = [beside / "cam_params.json", beside / f"{name}_mesh.ply"]
    folders = [beside / "scans" if name in ("dslr", "iphone") else beside.parent / "scans" / name]
    levels = 2 if any(folder.glob("cameras.*")) else int(any(folder.glob("transforms*.json")))  # COLMAP, nerfstudio
    for scene in folder.parents[:levels]:
        files.append(scene / "fused.ply")
        folders += [scene / one for one in ("images", "images_2", "images_4", "images_8", "dense")]
    yield from filter(os.path.lexists, files)
    for other in filter(os.path.isdir, folders):
        yield from files_below(other, without)


def files_below(folder: Path, without: Set[str] = frozenset()) -> Iterator[Path]:
    """Files in and below a folder without results; links are followed, but not those to a folder around it."""
    entered, count, root = set(), 0, os.path.realpath(folder)
    for place, folders, names in os.walk(folder, followlinks=True):
        if place != str(folder) and not RESULTS.isdisjoint(names):
            folders.clear()
            continue
        entered.add(os.path.realpath(place))
        inside = [name for name in folders if os.path.abspath(os.path.join(place, name)) not in without]
        folders[:] = [
            name
            for name in sorted(inside)
            if (real := os.path.realpath(os.path.join(place, name))) not in entered
            and os.path.commonpath([real, root]) != real
        ]
        count += len(names) + len(folders)
        bounds.check(count, bounds.FILES, "files below it (does a link lead out of the recording?)", str(folder))
        yield from (Path(place, name) for name in names if os.path.abspath(os.path.join(place, name)) not in without)


def _size_and_time(file: Path, changed: bool) -> tuple[int | str, ...]:
    """Of a file; a link that leads nowhere has its target, so that it counts as a change when it leads somewhere."""
    if os.path.islink(file) and not os.path.exists(file):
        return os.readlink(file), 0
    status = file.stat()
    if not stat.S_ISREG(status.st_mode):
        return "no file", 0
    return status.st_size, status.st_mtime_ns, *((status.st_ctime_ns,) if changed else ())


def _as_calibrated(image: Image.Image, camera_size: tuple[int, int] | None, name: str) -> Image.Image:
    """Turns an image as its EXIF tag says if that gives the shape of the camera's images.

    Programs for cameras and poses differ: COLMAP reads the stored pixels, others what a person sees.
    """
    turn = image.getexif().get(ExifTags.Base.Orientation, 1)
    if turn not in range(2, 9):
        return image
    height, width = camera_size if camera_size is not None and turn >= 5 else (0, 0)  # both are exchanged
    if wide := (image.width - image.height) * (width - height):
        return image if wide > 0 else ImageOps.exif_transpose(image)
    raise ValueError(
        f"{name}: EXIF says that this image is to be turned (orientation {turn}), and it is not known whether its "
        "camera is that of the stored or of the turned image; turn the image, or remove its tag"
    )


def rgb_of(image: Image.Image, name: str) -> Tensor:
    """Converts an 8-bit image of any mode to [3, H, W] uint8 RGB; errors begin with `name`."""
    if image.mode.startswith(("I", "F")):
        raise ValueError(f"{name}: expected an 8-bit image, got mode {image.mode}")
    return torch.from_numpy(np.array(image.convert("RGB"))).permute(2, 0, 1).contiguous()


def labels_of(image: Image.Image, name: str) -> Tensor:
    """Converts a label image of :func:`decode_image` to [H, W] int64; errors begin with `name`."""
    if image.mode not in ("L", "P", "I;16", "I;16B", "I") or image.format in ("JPEG", "MPO"):  # they make other numbers
        raise ValueError(f"{name}: expected a grey or palette image of labels, got mode {image.mode} of {image.format}")
    return torch.from_numpy(np.array(image).astype(np.int64) // image.info["step"])
