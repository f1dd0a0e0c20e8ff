"""Reads and writes the masks of one frame."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchjoint.datasets.files.rasters import read_raster
from torchjoint.datasets.files.readers import read_label_image
from torchjoint.masks.arrays import as_binary, as_scores
from torchjoint.masks.labels import from_labels
from torchjoint.masks.sam import from_sam
from torchjoint.masks.segmentation import Pixels, merged, pixels_of
from torchjoint.runtime import bounds
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import DAMAGE, has_file, has_folder, is_there, read_json, read_text
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.masks import Masks

#: The files that :func:`read_masks` reads, besides folders.
SUFFIXES = (".png", ".npz", ".json")
#: Scores in a folder of PNGs, as SAM's command line writes them: columns id, predicted_iou, stability_score.
METADATA = "metadata.csv"


@on_cpu()
def read_masks(path: Path | str) -> Masks:
    """Reads the masks of one frame. The kind of file determines the reader.

    Args:
        path: one of

            * ``NAME.png``: 8- or 16-bit labels, 0 = none;
            * a folder of PNGs, each one mask (0 outside), in the order of their numbers, and an optional
              ``metadata.csv`` with scores, as SAM's command line writes it;
            * ``NAME.npz``: what :func:`save_masks` wrote; or ``masks`` ([M, H, W] booleans, or labels [H, W], -1 =
              none), and optional ``scores``;
            * ``NAME.json``: SAM's list of dicts with run lengths, or SA-1B's dict with such a list as ``annotations``.

    Raises:
        FileNotFoundError: there is no such file or folder.
        ValueError: an unknown kind of file, or a damaged one; the message names it.
    """
    path = Path(path)
    if not is_there(path):
        raise FileNotFoundError(f"{path}: missing; expected masks")
    readers = {".png": lambda path: from_labels(read_label_image(path), none=0), ".npz": _read_npz, ".json": _read_json}
    reader = _read_pngs if has_folder(path) else readers.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: expected masks in a folder or in a file of kind {', '.join(SUFFIXES)}")
    try:
        return reader(path)
    except DAMAGE as error:
        message = str(error)
        raise ValueError(message if message.startswith(str(path)) else f"{path}: {message}") from error


@on_cpu()
def save_masks(path: Path | str, masks: Masks) -> None:
    """Writes masks for :func:`read_masks`, compressed, to a temporary file that is then renamed; makes the folder.

    An earlier file is replaced, as NumPy does.

    Raises:
        ValueError: the file name does not end with .npz.
    """
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"path: expected a file name with .npz, got {path.name}")
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as partial:
        arrays = {"atom": masks.atom.numpy(), "pairs": masks.pairs.numpy(), "mask_scores": masks.scores.numpy()}
        arrays |= {key: np.array(of) for key, of in (("ids", masks.ids), ("names", masks.names)) if of}
        np.savez_compressed(partial, **arrays)  # type: ignore[arg-type]


def _read_json(path: Path) -> Masks:
    content = read_json(path, "masks")
    if not isinstance(content, Mapping):
        return from_sam(content)
    if "annotations" not in content:
        raise ValueError(f"{path}: expected a list of masks, or a dict with annotations, got {', '.join(content)}")
    image: Any = content.get("image", {})
    size = (int(image["height"]), int(image["width"])) if {"height", "width"} <= set(image) else None
    return from_sam(content["annotations"], size)


def _read_npz(path: Path) -> Masks:
    arrays = read_archive(path)
    for name in ("atom", "masks"):
        if name in arrays and arrays[name].ndim in (2, 3):
            bounds.check_pixels(arrays[name].shape[-2], arrays[name].shape[-1], name)
    for name, most in (("mask_scores", bounds.MASKS), ("ids", bounds.MASKS), ("names", bounds.MASKS)):
        bounds.check(len(np.atleast_1d(arrays.get(name, ()))), most, name)
    bounds.check(arrays.get("pairs", np.empty(0)).size, 2 * bounds.PAIRS, "numbers of pairs")
    if {"atom", "pairs", "mask_scores"} <= set(arrays):
        ids, names = (tuple(arrays[key].tolist()) if key in arrays else () for key in ("ids", "names"))
        tensors = [torch.from_numpy(arrays[key]) for key in ("atom", "pairs", "mask_scores")]
        return Masks(tensors[0], tensors[1], tensors[2], ids, names)
    if "masks" not in arrays:
        raise ValueError(f"{path}: expected masks, and optional scores, got {', '.join(arrays) or 'nothing'}")
    masks, scores = arrays["masks"], arrays.get("scores")
    if masks.ndim != 3:
        return from_labels(masks, scores)
    of_masks = as_scores(scores, "scores")
    each = (pixels_of(mask, None, f"masks[{index}]") for index, mask in enumerate(masks))
    of_masks = torch.ones(len(masks)) if of_masks is None else of_masks
    return merged(each, len(masks), (masks.shape[1], masks.shape[2]), of_masks, "masks")


def _read_pngs(path: Path) -> Masks:
    files = sorted(path.glob("*.png"), key=lambda file: (len(file.name), file.name))
    if not files:
        raise ValueError(f"{path}: expected PNGs, one for each mask, got none")
    stems = [file.stem for file in files]
    scores = torch.tensor(_scores(path / METADATA, stems) or [1.0] * len(files))
    return replace(merged(map(_read_png, files), len(files), None, scores, path.name), names=tuple(stems))


def _read_png(file: Path) -> Pixels:
    image = read_raster(file)
    if image.mode not in ("1", "L"):
        raise ValueError(f"{file}: expected a mask with values 0 and 255, got an image of mode {image.mode}")
    return pixels_of(as_binary(np.array(image), str(file)), None, str(file))


def _scores(path: Path, ids: list[str]) -> list[float] | None:
    if not has_file(path):
        return None
    try:
        rows = {row.get("id"): row for row in csv.DictReader(io.StringIO(read_text(path, "scores of masks")))}
    except csv.Error as error:
        raise ValueError(f"{path}: expected a table: {error}") from error
    scores = []
    for name in ids:
        if name not in rows:
            raise ValueError(f"{path}: expected a line with id {name}")
        values = [rows[name].get(column) or "1" for column in ("predicted_iou", "stability_score")]
        try:
            scores.append(float(values[0]) * float(values[1]))
        except ValueError as error:
            raise ValueError(f"{path}: expected numbers in the line with id {name}, got {', '.join(values)}") from error
    return [score if score != score else min(max(score, 0.0), 1.0) for score in scores]  # Masks checks for NaN
