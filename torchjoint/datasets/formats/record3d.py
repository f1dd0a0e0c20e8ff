"""Reads recordings of Record3D (record3d.app), of an iPhone's depth cameras: .r3d files, and its export "EXR + JPG".

FILE.r3d, a zip, or the folder of the unpacked zip:
  metadata       JSON: w, h, K (3x3, column after column), dw, dh; of each frame `poses` qx qy qz qw tx ty tz,
                 camera-to-world, OpenGL axes (y up, z back), and (optional) `perFrameIntrinsicCoeffs` fx fy cx cy
  rgbd/N.jpg     8-bit RGB, N from 0
  rgbd/N.depth   LZFSE: dh x dw float32, metres along z; NaN = unknown
  rgbd/N.conf    LZFSE: dh x dw bytes, 0 low to 2 high (optional); depth of low confidence is left out
EXR_RGBD/, or the folder that holds it: metadata.json, rgb/N.jpg, depth/N.exr (channel R, metres)

The cloud is `cloud.ply` in the folder, or fused from depth. No recording was at hand: the layout is that of public
readers, nerfstudio's record3d_utils.py (poses, K, the export) and USA-Net's r3d.py (zip, LZFSE, confidence, axes).
"""

import math
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.cameras import FLIP_YZ, Camera, invert_pose, pinhole_matrix, poses_from_quaternions
from torchjoint.datasets.files.binary import Members
from torchjoint.datasets.files.readers import decode_image, rgb_of
from torchjoint.datasets.files.text import Record, parse_record
from torchjoint.datasets.recording import Frames, Options, Shot, read_shots, scene_of_frames, tell_lost
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import damage_is, has_file, has_folder, present
from torchjoint.runtime.messages import needed_for
from torchjoint.scene import Scene

WHAT = "an .r3d file, metadata with rgbd/, or EXR_RGBD/ with metadata.json, rgb/ and depth/ (Record3D)"
EXPORT = "EXR_RGBD"
#: Pixels of packed depth: those of TrueDepth; a LiDAR has 256 x 192.
MAX_DEPTH = 640 * 480
#: A packed block starts so. It holds at most 10,000 matches of 2,359 bytes, whatever size its header declares.
_BLOCKS = (b"bvx1", b"bvx2")
#: Apple's encoder begins a new block after so many bytes or more: 10,000 matches of at least 4, or 40,000 literals.
_BLOCK_BYTES = 40_000


def recognizes(path: Path) -> bool:
    if has_file(path):
        return path.suffix.lower() == ".r3d"
    unpacked = has_file(path / "metadata") and has_folder(path / "rgbd")
    folder = _folder(path)
    return unpacked or (has_file(folder / "metadata.json") and any((folder / "depth").glob("*.exr")))


def load(path: Path, options: Options) -> Scene:
    scene = scene_of_frames(path, _read_frames(Members(_folder(path))), options)
    return replace(scene, name=path.stem if has_file(path) else path.name)


def _folder(path: Path) -> Path:
    return path / EXPORT if has_folder(path / EXPORT) else path


def _read_frames(files: Members) -> Frames:
    metadata, folder = ("metadata", "rgbd") if "metadata" in files.names else ("metadata.json", "rgb")
    values = parse_record(files.read(metadata, bounds.JSON_BYTES), f"{files.path}: {metadata}")
    found = (re.fullmatch(rf"{folder}/([0-9]{{1,9}})\.jpg", file) for file in files.names)
    images = sorted((int(match[1]), match[0]) for match in found if match)
    poses = _read_poses(values)
    if not images or images[-1][0] >= len(poses):
        last = images[-1][1] if images else "none"
        raise ValueError(f"{values.name}: poses: expected one for each image, got {len(poses)}; last image: {last}")
    tell_lost(str(files.path), range(len(poses)), [number for number, _ in images])
    cameras = _read_cameras(values, len(poses))

    shots = []
    for number, file in images:
        has_depth = not {f"depth/{number}.exr", f"rgbd/{number}.depth"}.isdisjoint(files.names)
        depth = partial(_read_depth, files, number, values) if has_depth else None
        shots.append(Shot(partial(_read_image, files, file), cameras[number], poses[number], str(number), depth))
    return read_shots(shots)


def _read_image(files: Members, file: str) -> Tensor:
    name = f"{files.path}: {file}"
    return rgb_of(decode_image(files.read(file, bounds.IMAGE_BYTES), name), name)


def _read_depth(files: Members, number: int, values: Record) -> Tensor:
    exr, packed, confidence = f"depth/{number}.exr", f"rgbd/{number}.depth", f"rgbd/{number}.conf"
    depth = read_exr(files.path / exr, "R") if exr in files.names else _unpack(files, packed, values, "<f4")
    known = torch.isfinite(depth) & (depth > 0)
    if confidence in files.names:
        known &= _unpack(files, confidence, values, "u1") > 0
    return torch.where(known, depth, 0.0)


def _unpack(files: Members, file: str, values: Record, dtype: str) -> Tensor:
    height, width = round(values.number("dh")), round(values.number("dw"))
    if not (width > 0 and height > 0 and width * height <= MAX_DEPTH):
        raise ValueError(f"{values.name}: dw, dh: expected the size of depth images, got {width} x {height}")
    size = np.dtype(dtype).itemsize * height * width
    raw = decompress_lzfse(files.read(file, 2 * size + 64), size, f"{files.path}: {file}")
    return torch.from_numpy(np.frombuffer(raw, dtype).reshape(height, width).copy())


def _read_poses(values: Record) -> list[Tensor]:
    """World-to-camera poses [4, 4] float64."""
    rows = values.matrix("poses", 7).numpy()
    poses = poses_from_quaternions(rows[:, :4], rows[:, 4:], f"{values.name}: poses")
    return [invert_pose(pose @ FLIP_YZ) for pose in poses]


def _read_cameras(values: Record, count: int) -> list[Camera]:
    """The camera of each of `count` frames."""
    size, key = (round(values.number("h")), round(values.number("w"))), "perFrameIntrinsicCoeffs"
    rows = values.matrix(key, 4) if values.values.get(key) else values.numbers("K", 9)[None, [0, 4, 6, 7]]
    if len(rows) not in (1, count):
        raise ValueError(f"{values.name}: {key}: expected a row for each of {count} poses, got {len(rows)} rows")
    return [Camera(pinhole_matrix(*row), size, name=values.name) for row in rows.expand(count, 4).tolist()]


def decompress_lzfse(data: bytes, size: int, name: str = "data") -> bytes:
    """Decompresses data to `size` bytes; `name` is for messages.

    Data that have too many blocks for this size are not unpacked: a few bytes can become gigabytes.
    """
    with needed_for("reading depth of Record3D", "lzfse", "torchjoint[record3d]"):
        import lzfse
    # The library allocates the size that the first block declares, and then as much as the blocks give.
    declared = int.from_bytes(data[4:8], "little")
    blocks = sum(data.count(magic) for magic in _BLOCKS)
    if len(data) < 12 or len(data) > 2 * size + 64 or declared > size or blocks > 4 + size // _BLOCK_BYTES:
        raise ValueError(f"{name}: damaged: expected {size} bytes of LZFSE data, got {len(data)} packed bytes")
    with damage_is(f"{name}: damaged: not whole LZFSE data", lzfse.error, MemoryError):
        out: bytes = lzfse.decompress(data)
    if len(out) != size:
        raise ValueError(f"{name}: damaged: expected {size} bytes of LZFSE data, got {len(out)}")
    return out


def read_exr(path: Path, channel: str) -> Tensor:
    """Reads a channel of the first part of a file. The library unpacks all channels of all parts, so all are bounded.

    Returns:
        [H, W] float32.
    """
    present(path, "an image, .exr")
    with needed_for("reading .exr", "OpenEXR", "torchjoint[record3d]"):
        import OpenEXR
    with damage_is(f"{path}: not a whole EXR image", Exception):  # the library raises several types of its own
        with OpenEXR.File(str(path), header_only=True) as file:
            sizes = [_size(part.header) for part in file.parts]
        height, width, _ = sizes[0]
        bounds.check(sum(map(math.prod, sizes)), bounds.PIXELS, "numbers in all channels")
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.channels()
            if channel not in channels:
                raise ValueError(f"expected a channel {channel}, got {', '.join(channels) or 'none'}")
            pixels = np.array(channels[channel].pixels, dtype=np.float32)
    if pixels.shape != (height, width):
        raise ValueError(f"{path}: expected {width} x {height} pixels, got an array {list(pixels.shape)}")
    return torch.from_numpy(pixels)


def _size(header: dict[str, Any]) -> tuple[int, int, int]:
    """Height, width and number of channels of a part."""
    first, last = (np.asarray(corner, dtype=np.int64) for corner in header["dataWindow"])
    width, height = (int(count) for count in last - first + 1)
    if width < 1 or height < 1 or "deep" in str(header["type"]):
        raise ValueError(f"expected an image with pixels, got {width} x {height}, {header['type']}")
    return height, width, len(header["channels"])
