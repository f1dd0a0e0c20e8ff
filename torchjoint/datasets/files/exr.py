"""Reads depth in OpenEXR files (openexr.com), with the package OpenEXR of its authors."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import present
from torchjoint.runtime.messages import needed_for


def read_exr(path: Path, channel: str) -> Tensor:
    """Reads a channel of the first part of a file. The library unpacks all channels of all parts, so all are bounded.

    Returns:
        [H, W] float32.
    """
    present(path, "an image, .exr")
    with needed_for("reading .exr", "OpenEXR", "torchjoint[record3d]"):
        import OpenEXR
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            sizes = [_size(part.header) for part in file.parts]
        height, width, _ = sizes[0]
        bounds.check(sum(map(math.prod, sizes)), bounds.PIXELS, "numbers in all channels")
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.channels()
            if channel not in channels:
                raise ValueError(f"expected a channel {channel}, got {', '.join(channels) or 'none'}")
            pixels = np.array(channels[channel].pixels, dtype=np.float32)
    except Exception as error:  # the library raises several types of its own
        raise ValueError(f"{path}: not a whole EXR image: {error}") from error
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
