"""A tiny data set in the form of BSDS500."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image
from scipy.io import savemat

Labels = npt.NDArray[np.integer]


def write_bsds(folder: Path, truths: Mapping[str, Sequence[Labels]], split: str = "val") -> Path:
    """Writes an image of the first annotator's regions, and the truth, for each name. Returns the folder."""
    images, mats = folder / "images" / split, folder / "groundTruth" / split
    images.mkdir(parents=True)
    mats.mkdir(parents=True)
    for name, annotators in truths.items():
        cells = np.empty((1, len(annotators)), dtype=object)
        for i, regions in enumerate(annotators):
            cells[0, i] = {"Segmentation": regions.astype(np.uint16), "Boundaries": borders(regions).astype(np.uint8)}
        savemat(mats / f"{name}.mat", {"groundTruth": cells}, do_compression=True)
        grey = (100 + 150 * annotators[0] / max(annotators[0].max(), 1)).astype(np.uint8)
        Image.fromarray(grey).convert("RGB").save(images / f"{name}.jpg", quality=95)
    return folder


def borders(regions: Labels) -> npt.NDArray[np.bool_]:
    """The pixels whose right or lower neighbour is of another region."""
    found = np.zeros(regions.shape, dtype=bool)
    found[:, :-1] |= regions[:, :-1] != regions[:, 1:]
    found[:-1] |= regions[:-1] != regions[1:]
    return found
