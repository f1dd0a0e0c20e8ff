"""Reads single files: images, depth, matrices, point clouds. Errors name the file and what is wrong."""

from __future__ import annotations

import hashlib
import io
import re
import struct
import tokenize
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from PIL import Image
from torch import Tensor

from torchjoint.datasets.pcd import read_pcd
from torchjoint.runtime.files import atomic_write

#: Larger images are rejected before they are decoded.
MAX_PIXELS = 64_000_000


def read_image(path: Path) -> Tensor:
    """Reads an 8-bit image of any mode; returns [3, H, W] uint8 RGB."""
    return rgb_of(_opened(path), str(path))


def read_image_size(path: Path) -> tuple[int, int]:
    """Returns (H, W) of an image, from the header of its file."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected an image")
    image = decode_image(path.read_bytes(), str(path), header_only=True)
    return image.height, image.width


def read_depth(path: Path, unit: float = 0.001) -> Tensor:
    """Reads a 16-bit depth image in `unit` metres; returns [H, W] float32 metres, 0 = unknown (raw 0 and 65535)."""
    image = _opened(path)
    if image.mode not in ("I;16", "I;16B", "I"):
        raise ValueError(f"{path}: expected a 16-bit grey image, got mode {image.mode}")
    raw = np.array(image, dtype=np.int32)
    return torch.from_numpy(np.where((raw == 65535) | (raw < 0), 0, raw).astype(np.float32) * np.float32(unit))


def read_label_image(path: Path) -> Tensor:
    """Reads an 8- or 16-bit label image; returns [H, W] int64."""
    return labels_of(_opened(path), str(path))


def read_grey_image(path: Path) -> Tensor:
    """Reads a grey image of 8 or 16 bits; returns [H, W] float32 in [0, 1]."""
    image = _opened(path)
    if image.mode not in ("1", "L", "I;16", "I;16B", "I"):
        raise ValueError(f"{path}: expected a grey image of 8 or 16 bits, got mode {image.mode}")
    white = {"1": 1, "L": 255}.get(image.mode, 65535)
    return torch.from_numpy(np.array(image).astype(np.float32)) / white


def read_matrix(path: Path, shape: tuple[int, int]) -> Tensor:
    """Reads a matrix from a text file; returns float64 of this shape."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected a text file with a {shape[0]}x{shape[1]} matrix")
    try:
        values = np.array(path.read_text(encoding="utf-8").replace(",", " ").split(), dtype=np.float64)
    except ValueError as error:
        raise ValueError(f"{path}: expected numbers, got {error}") from error
    if values.size != shape[0] * shape[1]:
        raise ValueError(f"{path}: expected {shape[0]}x{shape[1]} = {shape[0] * shape[1]} numbers, got {values.size}")
    return torch.from_numpy(values.reshape(shape))


def read_cloud(path: Path) -> tuple[Tensor, Tensor | None, Tensor | None]:
    """Reads a PLY or PCD file.

    Returns:
        points [N, 3] float64; colours [N, 3] in [0, 1] or None; normals [N, 3] or None (also if all are zero).

    Raises:
        FileNotFoundError, ValueError: naming the file and its error.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected a point cloud")
    if path.suffix.lower() == ".pcd":
        pcd = read_pcd(path)
        points, packed, normals = pcd.points(), pcd.colors(), pcd.normals()
        colors = None if packed is None else packed.float() / 255
    else:
        points, colors, normals = _read_ply(path)
    if not torch.isfinite(points).all():
        bad = int((~torch.isfinite(points)).any(1).sum())
        raise ValueError(f"{path}: {bad} of {len(points)} points are NaN or infinite; remove them")
    return points, colors, normals if normals is not None and normals.any() else None


def _read_ply(path: Path) -> tuple[Tensor, Tensor | None, Tensor | None]:
    header = _check_ply_is_whole(path)
    import open3d

    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        cloud = open3d.io.read_point_cloud(str(path))
    if not cloud.has_points():
        raise ValueError(f"{path}: no points could be read; truncated, empty or not a point cloud")
    points = torch.from_numpy(np.asarray(cloud.points))
    colors = torch.from_numpy(np.asarray(cloud.colors)).float() if cloud.has_colors() else None
    if colors is not None and ["property", "float", "red"] in header:
        colors = colors * 255  # Open3D treats all colours as 8-bit, whatever their type
    normals = torch.from_numpy(np.asarray(cloud.normals)).float() if cloud.has_normals() else None
    return points, colors, normals


def read_array(path: Path) -> Tensor:
    """Reads a .npy file of numbers, of any shape."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected an array of numbers, .npy")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about headers of Python 2, or of old numpy
            # Memory-mapped, so that the shape is checked against the file size before memory is allocated.
            array: npt.NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
        if array.dtype.kind == "u" and array.dtype.itemsize > 1:  # torch supports few operations on these types
            array = array.astype(np.int64)
        return torch.from_numpy(np.array(array, dtype=array.dtype.newbyteorder("="), order="C", subok=False))
    except (ValueError, TypeError, OSError, EOFError, OverflowError, SyntaxError, tokenize.TokenError) as error:
        raise ValueError(f"{path}: not a whole .npy array of numbers: {error}") from error


def fingerprint(path: Path) -> str:
    """Returns a hash of file names, sizes and times, to detect changed files.

    For a folder it covers all files in and below the folder. For a file it covers the file's folder, and the files with
    the same stem in sibling folders (KITTI's layout); but for a cloud that stands alone, only the file.
    """
    if path.is_file() and path.suffix.lower() in (".ply", ".npy", ".npz", ".xyz"):
        status = path.stat()
        return hashlib.sha256(repr((str(path.resolve()), status.st_size, status.st_mtime_ns)).encode()).hexdigest()
    folder = path if path.is_dir() else path.parent
    files = sorted({*folder.rglob("*"), *(() if path.is_dir() else folder.parent.glob(f"*/{path.stem}.*"))})
    stats = [(str(file), file.stat().st_size, file.stat().st_mtime_ns) for file in files if file.is_file()]
    return hashlib.sha256(repr((str(path.resolve()), stats)).encode()).hexdigest()


def write_cloud(path: Path, points: Tensor, colors: Tensor | None = None, labels: Tensor | None = None) -> None:
    """Writes a binary PLY with positions [N, 3], 8-bit colours (from [0, 1]) and an int32 property `label`; atomic."""
    from open3d import core, t

    cloud = t.geometry.PointCloud(core.Tensor(points.float().numpy()))
    if colors is not None:
        cloud.point.colors = core.Tensor((colors.clamp(0, 1) * 255).round().to(torch.uint8).numpy())
    if labels is not None:
        cloud.point.label = core.Tensor(labels.to(torch.int32)[:, None].numpy())
    with atomic_write(path) as partial:
        if not t.io.write_point_cloud(str(partial), cloud):
            raise OSError(f"{path}: could not be written")


_PLY_SIZES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
    "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8, "float64": 8,
}  # fmt: skip


def _check_ply_is_whole(path: Path) -> list[list[str]]:
    """Open3D reads a truncated file without an error and returns undefined points. Returns the header."""
    data = path.read_bytes()
    end = re.search(rb"end_header\r?\n", data)
    header, body = (data[: end.start()], data[end.end() :]) if end else (data[:1000], b"")
    lines = [line.split() for line in header.decode("ascii", errors="replace").splitlines()]
    formats = [line[1] for line in lines if line[:1] == ["format"] and len(line) > 1]
    if not header.startswith(b"ply") or end is None or not formats:
        raise ValueError(f"{path}: not a PLY file, or its header is truncated")
    count, stride, element = 0, 0, ""
    for line in lines:
        if line[:1] == ["element"] and len(line) == 3 and line[2].isdigit():
            element = line[1]
            count = int(line[2]) if element == "vertex" else count
        elif line[:1] == ["property"] and element == "vertex":
            stride += _PLY_SIZES.get(line[1], 0)
    ascii_body = formats[0] == "ascii"
    present = body.count(b"\n") + (not body.endswith(b"\n")) if ascii_body else len(body) // max(stride, 1)
    if present < count:
        raise ValueError(f"{path}: truncated: expected {count} points, got {present}")
    return lines


def _opened(path: Path) -> Image.Image:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected an image")
    return decode_image(path.read_bytes(), str(path))


def rgb_of(image: Image.Image, name: str) -> Tensor:
    """Converts an 8-bit image of any mode to [3, H, W] uint8 RGB; errors give the name."""
    if image.mode.startswith(("I", "F")):
        raise ValueError(f"{name}: expected an 8-bit image, got mode {image.mode}")
    return torch.from_numpy(np.array(image.convert("RGB"))).permute(2, 0, 1).contiguous()


def labels_of(image: Image.Image, name: str) -> Tensor:
    """Converts an 8- or 16-bit label image to [H, W] int64; errors give the name."""
    if image.mode not in ("L", "P", "I;16", "I;16B", "I"):
        raise ValueError(f"{name}: expected a grey or palette image of labels, got mode {image.mode}")
    return torch.from_numpy(np.array(image).astype(np.int64))


def decode_image(data: bytes, name: str, *, header_only: bool = False) -> Image.Image:
    """Decodes an image file's bytes (or only its header); errors give the name.

    Raises:
        ValueError: a damaged image, or an image of more than `MAX_PIXELS`.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the check below is stricter
            image = Image.open(io.BytesIO(data))
            if image.width * image.height > MAX_PIXELS:
                raise ValueError(f"{image.width} x {image.height} pixels are too many (at most {MAX_PIXELS})")
            if not header_only:
                image.load()
    except (OSError, SyntaxError, ValueError, TypeError, EOFError, OverflowError, MemoryError, struct.error,
            Image.DecompressionBombError, zlib.error) as error:  # fmt: skip
        raise ValueError(f"{name}: not a whole image: {error}") from error
    return image
