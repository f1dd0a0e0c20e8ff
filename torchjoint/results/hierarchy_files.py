"""The levels of a result on disk (output after step 8): hierarchy.npz, and the pieces of the images in pieces/."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from torchjoint.datasets.files.readers import read_image
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.foreign_files import damage_is, has_file
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Hierarchy
from torchjoint.scene.votes import Votes

HIERARCHY, PIECES = "hierarchy.npz", "pieces"
#: Largest number of a piece in an image of pieces, which stores piece + 1 in three bytes; 0 = none.
MAX_PIECE = 2**24 - 2
#: Names of the arrays of the votes. Results without judges have none.
_VOTES = ("votes", "piece_size")


def write_hierarchy(folder: Path, hierarchy: Hierarchy, names: Sequence[str], piece_images: Sequence[Tensor]) -> None:
    """Writes hierarchy.npz and pieces/NAME.png; equal arguments give equal bytes.

    Args:
        folder: the result.
        hierarchy: of the points.
        names: of the images, without suffix.
        piece_images: [H, W] int64 per image, -1 = none.

    Raises:
        ValueError: more pieces than an image can hold.
    """
    if hierarchy.num_pieces - 1 > MAX_PIECE:
        raise ValueError(f"hierarchy: {hierarchy.num_pieces} pieces do not fit 24-bit images (at most {MAX_PIECE + 1})")
    arrays = {"piece": hierarchy.piece, "merges": hierarchy.merges}
    if hierarchy.votes is not None:
        arrays |= dict(zip(_VOTES, hierarchy.votes, strict=True))
    np.savez_compressed(
        folder / HIERARCHY,
        heights=hierarchy.heights.numpy(),
        default=np.float64(hierarchy.default),
        **{name: array.numpy().astype(np.int32) for name, array in arrays.items()},  # type: ignore[arg-type]
    )
    shutil.rmtree(folder / PIECES, ignore_errors=True)
    if not len(piece_images):
        return
    (folder / PIECES).mkdir()

    def write(index: int) -> None:
        stored = (piece_images[index] + 1).numpy()
        channels = np.stack([stored >> 16, stored >> 8 & 255, stored & 255], axis=-1).astype(np.uint8)
        # Compression level 3 takes half the time of level 6, and makes the files a fifth larger.
        Image.fromarray(channels).save(folder / PIECES / f"{names[index]}.png", compress_level=3)

    parallel_map(write, range(len(names)))


def read_hierarchy(folder: Path, num_points: int) -> Hierarchy:
    """Reads hierarchy.npz of a result that has `num_points` points.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged or of other points; the message names it.
    """
    file = folder / HIERARCHY
    if not has_file(file):
        raise FileNotFoundError(
            f"{file}: missing; expected a result of point_segments.method learned: only this method makes all levels"
        )
    with damage_is(f"{file}: not a whole hierarchy", OSError):
        arrays = read_archive(file)
        piece, merges = (torch.from_numpy(arrays[name].astype(np.int64)) for name in ("piece", "merges"))
        votes = (
            Votes(*(torch.from_numpy(arrays[name].astype(np.int64)) for name in _VOTES))
            if _VOTES[0] in arrays
            else None
        )
        hierarchy = Hierarchy(piece, merges, torch.from_numpy(arrays["heights"]), float(arrays["default"]), votes)
    if len(hierarchy.piece) != num_points:
        raise ValueError(f"{file}: expected a hierarchy of {num_points} points, got {len(hierarchy.piece)}")
    return hierarchy


def read_piece_image(path: Path, num_pieces: int) -> Tensor:
    """Reads an image of pieces; returns [H, W] int64, -1 = none.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged or has other pieces; the message names it.
    """
    red, green, blue = read_image(path).to(torch.int64)
    pieces = (red << 16) + (green << 8) + blue - 1
    if int(pieces.max()) >= num_pieces:
        raise ValueError(f"{path}: expected pieces below {num_pieces}, got {int(pieces.max())}; of another result?")
    return pieces
