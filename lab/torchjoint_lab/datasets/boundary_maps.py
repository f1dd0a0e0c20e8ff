"""Reads predicted boundary maps: a folder with a file NAME.png or NAME.npy per image."""

from __future__ import annotations

import tokenize
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.files.readers import decode_image


def find_boundary_map(folder: Path, name: str) -> Path:
    """Finds the boundary map of an image.

    Raises:
        FileNotFoundError: there is no map.
        ValueError: there are two maps.
    """
    found = [file for file in (folder / f"{name}.png", folder / f"{name}.npy") if file.is_file()]
    if not found:
        raise FileNotFoundError(f"{folder / name}.png: missing (and so is {name}.npy); expected a boundary map")
    if len(found) > 1:
        raise ValueError(f"{folder}: holds both {name}.png and {name}.npy; remove one")
    return found[0]


def read_boundary_map(path: Path) -> Tensor:
    """Reads a grey .png of 8 or 16 bits, or a floating [H, W] .npy in [0, 1]; returns [H, W] float32 in [0, 1].

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    if path.suffix == ".png":
        return _read_grey_image(path)
    try:
        values = np.load(path, allow_pickle=False, mmap_mode="r")  # checks the size before memory is allocated
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: missing; expected a boundary map") from None
    except (ValueError, OSError, EOFError, SyntaxError, tokenize.TokenError) as error:
        raise ValueError(f"{path}: not a whole .npy file: {error}") from error
    if not isinstance(values, np.ndarray) or values.ndim != 2 or values.dtype.kind != "f":
        got = f"{values.dtype} {list(values.shape)}" if isinstance(values, np.ndarray) else "an archive"
        raise ValueError(f"{path}: expected floating numbers of shape [H, W], got {got}")
    wrong = values[~((values >= 0) & (values <= 1))]  # NaN is wrong, too
    if len(wrong):
        raise ValueError(f"{path}: expected numbers in [0, 1], got {wrong[0]:g} and {len(wrong) - 1} others")
    return torch.from_numpy(values.astype(np.float32))


def _read_grey_image(path: Path) -> Tensor:
    """Reads a grey image of 8 or 16 bits; returns [H, W] float32 in [0, 1]."""
    image = decode_image(path.read_bytes(), str(path))
    if image.mode not in ("1", "L", "I;16", "I;16B", "I"):
        raise ValueError(f"{path}: expected a grey image of 8 or 16 bits, got mode {image.mode}")
    white = {"1": 1, "L": 255}.get(image.mode, 65535)
    return torch.from_numpy(np.array(image).astype(np.float32)) / white
