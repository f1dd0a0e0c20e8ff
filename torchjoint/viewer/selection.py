"""Writes the selected segments: a cloud, masks, or COCO's JSON."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from torchjoint.datasets.files.ply import write_cloud
from torchjoint.results.exports.coco import export_coco
from torchjoint.runtime.files import frame_files, no_link
from torchjoint.runtime.lazy import LazySequence
from torchjoint.viewer.model import Model


def export_selected(model: Model, folder: Path, kind: str) -> Path:
    """Writes the selected segments into a folder; returns the written file or folder, which replaces an earlier one.

    * PLY: one cloud of the selected points in their own colours; its property `label` is the displayed id;
    * PNG: a mask for each frame that sees a selected segment, 255 = selected;
    * COCO: COCO's JSON of the selected segments in all frames, with the displayed ids.

    Raises:
        ValueError: nothing is selected, or an unknown kind.
        FileExistsError: the folder is a link.
        ModuleNotFoundError: COCO needs pycocotools.
    """
    if not model.selected:
        raise ValueError("export: select a segment first")
    no_link(folder).mkdir(exist_ok=True)
    name = "-".join(str(model.key(segment)) for segment in model.selected[:5])
    name += f"-and-{len(model.selected) - 5}-more" if len(model.selected) > 5 else ""
    result, keys = model.result, _keys_of_pieces(model)
    labels = torch.from_numpy(keys[model.parts.of_point])
    if kind == "PLY":
        chosen = result.scene.select_points(labels >= 0)
        write_cloud(folder / f"{name}.ply", chosen.points, chosen.colors, labels[labels >= 0])
        return folder / f"{name}.ply"
    if kind not in ("PNG", "COCO"):
        raise ValueError(f"export: expected PLY, PNG or COCO, got {kind!r}")
    images = LazySequence(len(result.images), lambda index: _labels(model, keys, index))
    if kind == "PNG":
        return _write_masks(folder / f"{name}-masks", images, result.names)

    selection = replace(result, points=labels, images=images, hierarchy=None, piece_images=())
    export_coco(folder / f"{name}.json", selection)
    return folder / f"{name}.json"


def _keys_of_pieces(model: Model) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """[P] the displayed id of the segment of each piece; -1 = not selected."""
    return np.where(np.isin(model.table, model.selected), model.parts.keys[model.table], -1)


def _labels(model: Model, keys: np.ndarray[tuple[int], np.dtype[np.int64]], index: int) -> Tensor:
    pieces = model.parts.image(index)
    return torch.from_numpy(np.where(pieces < 0, -1, keys[pieces]))


def _write_masks(folder: Path, images: Sequence[Tensor], names: Sequence[str]) -> Path:
    partial = folder.with_name(f".{folder.name}.partial")
    for old in (partial, folder):  # also masks of frames that see no selected segment any more
        shutil.rmtree(old, ignore_errors=True)
    partial.mkdir()
    for name, labels in zip(frame_files(names), images, strict=True):
        if bool((labels >= 0).any()):
            Image.fromarray(((labels >= 0) * 255).numpy().astype(np.uint8)).save(partial / f"{name}.png")
    return partial.rename(folder)
