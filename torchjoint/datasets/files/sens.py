"""Reads ScanNet's sensor stream, `.sens` version 4: a header, then posed frames with a JPEG and zlib-packed depth.

A. Dai et al., "ScanNet: Richly-annotated 3D Reconstructions of Indoor Scenes" (CVPR 2017).
"""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.files.binary import BinaryFile
from torchjoint.datasets.files.readers import decode_image, rgb_of
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import damage_is, open_file
from torchjoint.scene.checks import as_intrinsics

VERSION = 4
_PNG, _JPEG = 1, 2
_RAW, _ZLIB = 0, 1

#: Intrinsics and extrinsics of colour and depth, their codecs, their sizes, depth units per metre.
_HEADER = "64f2i4If"
#: Pose, times of colour and depth, bytes of colour and depth.
_FRAME, _FRAME_BYTES = "16f4Q", 96


class _Blobs(NamedTuple):
    """Byte offset and sizes of a frame's images in the file."""

    start: int
    color_bytes: int
    depth_bytes: int


class SensFile:
    """A `.sens` file. Opening reads the file header and all frame headers; images are decoded on access.

    Attributes:
        color_intrinsics: [3, 3] float64, for images of `color_size`; pixel centres at integer coordinates.
        depth_intrinsics: [3, 3] float64, for images of `depth_size`.
        color_size: (H, W).
        depth_size: (H, W).
        poses: [F, 4, 4] float64, camera-to-world, OpenCV axes, metres; -inf where tracking was lost.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with BinaryFile(path) as file:
            self._read_header(file)
            self._blobs, poses = _index(file)
        self.poses = torch.from_numpy(np.array(poses, dtype=np.float64).reshape(-1, 4, 4))

    def __len__(self) -> int:
        return len(self._blobs)

    def color(self, index: int) -> Tensor:
        """Decodes a frame's colours, [3, H, W] uint8 RGB, at the image's own size. ValueError if damaged."""
        blobs = self._blobs[index]
        name = f"{self.path}, colour of frame {index}"
        return rgb_of(decode_image(self._read(blobs.start, blobs.color_bytes, name), name), name)

    def depth(self, index: int) -> Tensor:
        """Decodes a frame's depth, [h, w] float32 metres, 0 = unknown, of `depth_size`. ValueError if damaged."""
        blobs = self._blobs[index]
        name = f"{self.path}, depth of frame {index}"
        data = self._read(blobs.start + blobs.color_bytes, blobs.depth_bytes, name)
        expected = 2 * math.prod(self.depth_size)
        if self._depth_codec == _ZLIB:
            data = _inflate(data, expected, name)
        if len(data) != expected:
            raise ValueError(f"{name}: expected {expected} bytes, got {len(data)}")
        raw = np.frombuffer(data, dtype="<u2").reshape(self.depth_size)
        metres = np.where(raw == 65535, 0, raw).astype(np.float32) / np.float32(self._depth_shift)
        return torch.from_numpy(metres)

    def _read_header(self, file: BinaryFile) -> None:
        (version,) = file.read("I")
        if version != VERSION:
            raise ValueError(f"{self.path}: expected a .sens file of version {VERSION}, got version {version}")
        (name_bytes,) = file.read("Q")
        file.skip(name_bytes)
        *cameras, color_codec, depth_codec, cw, ch, dw, dh, shift = file.read(_HEADER)
        matrices = torch.tensor(cameras, dtype=torch.float64).reshape(4, 4, 4)
        self.color_intrinsics = as_intrinsics(matrices[0, :3, :3], f"{self.path}, colour's intrinsics")
        self.depth_intrinsics = as_intrinsics(matrices[2, :3, :3], f"{self.path}, depth's intrinsics")
        self.color_size, self.depth_size = (ch, cw), (dh, dw)
        self._depth_codec, self._depth_shift = depth_codec, shift
        if color_codec not in (_PNG, _JPEG) or depth_codec not in (_RAW, _ZLIB):
            raise ValueError(
                f"{self.path}: expected colour as PNG or JPEG (1, 2) and depth raw or by zlib (0, 1), got codecs "
                f"{color_codec} and {depth_codec}"
            )
        if not all(0 < h * w <= bounds.PIXELS for h, w in (self.color_size, self.depth_size)):
            raise ValueError(f"{self.path}: impossible image sizes {cw} x {ch}, {dw} x {dh}")
        if not (math.isfinite(shift) and shift > 0):
            raise ValueError(f"{self.path}: expected a positive number of depth units per metre, got {shift}")

    def _read(self, start: int, count: int, name: str) -> bytes:
        with open_file(self.path) as stream:
            stream.seek(start)
            data = stream.read(count)
        if len(data) != count:
            raise ValueError(f"{name}: the file has become shorter since it was opened")
        return data


def _index(file: BinaryFile) -> tuple[list[_Blobs], list[tuple[float, ...]]]:
    """Positions of the frames' images in the file, and the poses of the frames."""
    blobs, poses = [], []
    for _ in range(file.count(_FRAME_BYTES)):
        *pose, _, _, color_bytes, depth_bytes = file.read(_FRAME)
        blobs.append(_Blobs(file.place, color_bytes, depth_bytes))
        poses.append(tuple(pose))
        file.skip(color_bytes + depth_bytes)
    return blobs, poses


def _inflate(data: bytes, expected: int, name: str) -> bytes:
    """Decompresses data to `expected` bytes; allocates at most one byte more."""
    stream = zlib.decompressobj()
    with damage_is(f"{name}: not a whole zlib stream"):
        unpacked = stream.decompress(data, expected + 1)
    if not stream.eof or len(unpacked) != expected:
        raise ValueError(f"{name}: expected a zlib stream of {expected} bytes, got another or a truncated one")
    return unpacked
