"""Reads depth in OpenEXR files (openexr.com), with the package OpenEXR of its authors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchjoint.runtime.extras import needed_for
from torchjoint.runtime.foreign_files import present


def read_exr(path: Path, channel: str, max_pixels: int) -> Tensor:
    """Reads a channel of the first part of a file.

    Returns:
        [H, W] float32.

    Raises:
        FileNotFoundError, ValueError: the message names the file; it is damaged, larger, or lacks the channel.
        ModuleNotFoundError: OpenEXR is not installed.
    """
    present(path, "an image, .exr")
    with needed_for("reading .exr", "OpenEXR", "torchjoint[record3d]"):
        import OpenEXR
    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            first, last = (np.asarray(corner, dtype=np.float64) for corner in file.header()["dataWindow"])
        width, height = last - first + 1
        if not (width >= 1 and height >= 1 and width * height <= max_pixels):
            raise ValueError(f"expected at most {max_pixels} pixels, got {width:g} x {height:g}")
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = file.channels()
            if channel not in channels:
                raise ValueError(f"expected a channel {channel}, got {', '.join(channels) or 'none'}")
            pixels = np.array(channels[channel].pixels, dtype=np.float32)
    except Exception as error:  # the library raises several types of its own
        raise ValueError(f"{path}: not a whole EXR image: {error}") from error
    if pixels.shape != (height, width):
        raise ValueError(f"{path}: expected {width:g} x {height:g} pixels, got an array {list(pixels.shape)}")
    return torch.from_numpy(pixels)
