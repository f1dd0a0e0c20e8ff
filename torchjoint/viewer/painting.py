"""The colours of the points and images in the viewer, by the state of its model."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.results.edits import Table
from torchjoint.results.label_colors import label_colors
from torchjoint.results.overlays import borders
from torchjoint.results.result import Result
from torchjoint.viewer.model import Bytes, Model

#: Share of its own colour that an unselected segment keeps; the rest is the light grey of the background.
FADED, PALE = 0.15, 235.0


def piece_colors(model: Model) -> npt.NDArray[np.float64]:
    """[P, 3] RGB in 0 to 255 of each piece, in a mode that colours pieces."""
    number = torch.arange(model.parts.count)
    if model.mode == "initial":
        colors = label_colors(number)
    elif model.mode == "confidence":
        colors = _confidence_colors(model)
    else:
        colors = label_colors(torch.from_numpy(model.parts.keys[model.table]))
    return np.asarray(colors.numpy() * 255, dtype=np.float64)


def point_colors(model: Model) -> Bytes:
    """[N, 3] RGB of each point, unselected points faded. All but the cloud's own colours are shaded."""
    scene, labels = model.result.scene, model.table[model.parts.of_point]
    if model.mode == "truth" and scene.truth is not None and scene.truth.points is not None:
        labels = scene.truth.points.numpy()
        colors = label_colors(scene.truth.points).numpy() * 255.0
    else:
        colors = piece_colors(model)[model.parts.of_point]
    if model.mode == "colours" and scene.colors is not None:
        colors = scene.colors.numpy() * 255.0
    elif model.shading is not None:
        colors = colors * model.shading.of(labels)[:, None]
    if model.selected:
        lit = np.isin(model.table, model.selected)[model.parts.of_point]
        colors = np.where(lit[:, None], colors, FADED * colors + (1 - FADED) * PALE)
    return colors.round().astype(np.uint8)


def painted(model: Model, index: int, opacity: float) -> Bytes:
    """[H, W, 3] a frame under its labels; if segments are selected, only under these, with their outlines."""
    image = model.result.scene.frames[index].image.permute(1, 2, 0).numpy() * 255.0
    pieces = model.parts.image(index)
    if model.mode == "truth":
        truth = _truth_image(model.result, index)
        return _blend(image, truth, label_colors(torch.from_numpy(truth)).numpy() * 255.0, truth >= 0, opacity)
    segments = np.where(pieces < 0, -1, model.table[pieces])
    shown = np.isin(segments, model.selected) if model.selected else pieces >= 0
    if model.mode == "colours" and not model.selected:
        return image.round().astype(np.uint8)
    outlined = segments if model.mode != "initial" else pieces
    if model.selected:
        outlined, image = np.where(shown, segments, -1), np.where(shown[..., None], image, 0.5 * image + 64)
    colors = piece_colors(model)[pieces]
    return _blend(image, outlined, colors, shown, opacity if model.mode != "colours" else 0.0)


def _blend(image: Any, labels: Table, colors: Any, shown: Any, opacity: float) -> Bytes:
    blended = np.where(shown[..., None], image + (colors - image) * opacity, image)
    border = borders(torch.from_numpy(labels)).numpy()
    return np.where(border[..., None], 255.0, blended).round().astype(np.uint8)


def _truth_image(result: Result, index: int) -> Table:
    truth = result.scene.truth
    if truth is None or not len(truth.images):
        return np.full(result.scene.frames[index].size, -1, dtype=np.int64)
    return truth.images[index].numpy()


def _confidence_colors(model: Model) -> torch.Tensor:
    hierarchy = model.result.hierarchy
    if hierarchy is None or hierarchy.votes is None:
        raise ValueError("confidence: expected a result with the votes of judges, got none")
    from matplotlib import colormaps

    sure = hierarchy.votes.confidence(torch.from_numpy(np.unique(model.table, return_inverse=True)[1])).of_piece
    return torch.from_numpy(colormaps["viridis"](sure.numpy())[:, :3])
