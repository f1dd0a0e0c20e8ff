"""Reads the Berkeley segmentation data set (BSDS500): photographs, each segmented by several annotators.

P. Arbelaez, M. Maire, C. Fowlkes and J. Malik, "Contour Detection and Hierarchical Image Segmentation" (PAMI 2011).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.files.readers import read_image

SPLITS = ("train", "val", "test")

#: Where the folder `images` may be: in the given folder, or in the folders of the original archive.
_ROOTS = (".", "data", "BSDS500/data", "BSR/BSDS500/data")


@dataclass(frozen=True)
class BsdsImage:
    """One image of the data set. Each access of a property reads its file again; nothing is cached.

    Reading raises FileNotFoundError or ValueError; the message names the file and its error.
    """

    name: str  #: for example "101085"
    image_file: Path
    truth_file: Path

    @property
    def image(self) -> Tensor:
        """[3, H, W] float32, RGB in [0, 1]."""
        return read_image(self.image_file).float() / 255

    @property
    def segmentations(self) -> list[Tensor]:
        """Per annotator [H, W] int64 region ids, from 0; -1 = none."""
        return _read_truth(self.truth_file, "Segmentation", lambda values: values.astype(np.int64) - 1)

    @property
    def boundaries(self) -> list[Tensor]:
        """Per annotator [H, W] bool, lines one pixel wide."""
        return _read_truth(self.truth_file, "Boundaries", lambda values: values != 0)


def bsds_images(folder: str | Path, split: str) -> list[BsdsImage]:
    """Returns all images of a split, sorted by name.

    Args:
        folder: holds ``images/SPLIT/NAME.jpg`` and ``groundTruth/SPLIT/NAME.mat``; or the folder ``BSR`` of the
            original archive, or the parent of ``BSR``.
        split: "train", "val" or "test".

    Raises:
        FileNotFoundError: no such folder or split, or an image without ground truth.
        ValueError: an unknown split.
    """
    if split not in SPLITS:
        raise ValueError(f"split: expected {', '.join(SPLITS)}, got {split!r}")
    root = _root(Path(folder))
    images = root / "images" / split
    truths = root / "groundTruth" / split
    for needed in (images, truths):
        if not needed.is_dir():
            raise FileNotFoundError(f"{needed}: missing; expected the folder of the split {split!r}")
    files = sorted(images.glob("*.jpg"))
    if not files:
        raise FileNotFoundError(f"{images}: expected images NAME.jpg, found none")
    records = [BsdsImage(file.stem, file, truths / f"{file.stem}.mat") for file in files]
    for record in records:
        if not record.truth_file.is_file():
            raise FileNotFoundError(f"{record.truth_file}: missing; expected the ground truth of {record.image_file}")
    return records


def _root(folder: Path) -> Path:
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such folder; expected the BSDS500 data set")
    for root in _ROOTS:
        if (folder / root / "images").is_dir():
            return folder / root
    raise FileNotFoundError(f"{folder}: expected images/ and groundTruth/ in it, or the original BSR/BSDS500/data")


def _read_truth(path: Path, field: str, convert: Callable[[Any], Any]) -> list[Tensor]:
    from scipy.io import loadmat

    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected a ground truth of BSDS500")
    try:
        truth = loadmat(path)
    except Exception as error:  # for a damaged file, scipy raises errors of a dozen types
        raise ValueError(f"{path}: not a whole .mat file: {error}") from error
    try:
        maps = [annotator[field][0, 0] for annotator in truth["groundTruth"][0]]
        shapes = {values.shape for values in maps}
        is_right = bool(maps) and shapes == {(*maps[0].shape[:2],)} and all(v.dtype.kind in "uib" for v in maps)
    except (KeyError, IndexError, ValueError, TypeError, AttributeError):
        is_right = False
    if not is_right:
        raise ValueError(f"{path}: expected groundTruth{{1, k}}.{field}, an integer map of one size for each annotator")
    return [torch.from_numpy(convert(values)) for values in maps]
