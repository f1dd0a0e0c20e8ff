"""The colours of the points and images in the viewer, by the state of its model."""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.results.edits import Table
from torchjoint.results.figures import borders
from torchjoint.results.relations import Relation, relations
from torchjoint.results.render import label_colors
from torchjoint.results.result import Result
from torchjoint.scene import Scene, Segmentation
from torchjoint.viewer.cloud import Floats, middle_of
from torchjoint.viewer.model import Bytes, Model

#: Share of its own colour that an unselected segment keeps; the rest is nearly the background.
FADED = 0.15


def superpoint_colors(model: Model) -> npt.NDArray[np.float64]:
    """[P, 3] RGB in 0 to 255 of each superpoint, in a mode that colours superpoints."""
    if model.mode == "initial":
        colors = label_colors(torch.arange(model.parts.count))
    elif model.mode == "confidence":
        colors = _confidence_colors(model)
    else:
        colors = label_colors(torch.from_numpy(model.measures.hues[model.table]))
    return np.asarray(colors.numpy() * 255, dtype=np.float64)


def point_colors(model: Model) -> Bytes:
    """[N, 3] RGB of each point, unselected points faded. All but the cloud's own colours are shaded."""
    scene, labels = model.result.scene, model.table[model.parts.of_point]
    if model.mode == "truth" and scene.truth is not None and scene.truth.points is not None:
        labels = scene.truth.points.numpy()
        colors = label_colors(scene.truth.points).numpy() * 255.0
    else:
        colors = superpoint_colors(model)[model.parts.of_point]
    if model.mode == "colours" and scene.colors is not None:
        colors = scene.colors.numpy() * 255.0
    elif model.shading is not None:
        colors = colors * model.shading.of(labels)[:, None]
    if model.selected:
        lit = np.isin(model.table, model.selected)[model.parts.of_point]
        colors = np.where(lit[:, None], colors, FADED * colors + (1 - FADED) * model.pale)
    return colors.round().astype(np.uint8)


def painted(model: Model, index: int, opacity: float) -> Bytes:
    """[H, W, 3] a frame under its labels; if segments are selected, only under these, with their outlines."""
    image = model.result.scene.frames[index].image.permute(1, 2, 0).numpy() * 255.0
    superpoints = model.parts.image(index)
    if model.mode == "truth":
        truth = _truth_image(model.result, index)
        return _blend(image, truth, label_colors(torch.from_numpy(truth)).numpy() * 255.0, truth >= 0, opacity)
    segments = np.where(superpoints < 0, -1, model.table[superpoints])
    shown = np.isin(segments, model.selected) if model.selected else superpoints >= 0
    if model.mode == "colours" and not model.selected:
        return image.round().astype(np.uint8)
    outlined = segments if model.mode != "initial" else superpoints
    if model.selected:
        outlined, image = np.where(shown, segments, -1), np.where(shown[..., None], image, 0.5 * image + 64)
    colors = superpoint_colors(model)[superpoints]
    return _blend(image, outlined, colors, shown, opacity if model.mode != "colours" else 0.0)


def _blend(image: Any, labels: Table, colors: Any, shown: Any, opacity: float) -> Bytes:
    blended = np.where(shown[..., None], image + (colors - image) * opacity, image)
    return np.where(borders(torch.from_numpy(labels)).numpy()[..., None], 255.0, blended).round().astype(np.uint8)


def _truth_image(result: Result, index: int) -> Table:
    truth = result.scene.truth
    if truth is None or not len(truth.images):
        return np.full(result.scene.frames[index].size, -1, dtype=np.int64)
    return truth.images[index].numpy()


def _confidence_colors(model: Model) -> torch.Tensor:
    if (sure := model.measures.confidence) is None:
        raise ValueError("confidence: expected a result with the votes of an ensemble, got none")
    from matplotlib import colormaps

    return torch.from_numpy(colormaps["viridis"](sure.of_superpoint.numpy())[:, :3])


COLORS = {"stands on": (20, 140, 50), "hangs on": (230, 130, 0), "contains": (40, 90, 230), "touches": (120, 120, 120)}


class RelationLines:
    """The lines between the middles of things; computed when they are first shown, and anew for other segments.

    Args:
        server: viser.ViserServer.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._handle: Any = None
        self._labels: npt.NDArray[np.int64] | None = None  # whose relations were found
        self._found: tuple[Relation, ...] = ()

    def show(self, model: Model | None) -> None:
        """Draws the relations of the selected segments; without a selection, all but "touches". None hides them."""
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
        if model is None:
            return
        labels = model.table[model.parts.of_point]
        if self._labels is None or not np.array_equal(labels, self._labels):
            scene = Scene(model.result.scene.points, up=torch.from_numpy(model.up))
            self._labels, self._found = labels, relations(scene, Segmentation(torch.from_numpy(labels), ())).relations
        ends, colors = lines(self._found, model.result.scene.points.numpy(), labels, model.selected)
        if len(ends):
            origin = middle_of(ends)
            self._handle = self._server.scene.add_line_segments(
                "/relations", ends - origin, colors, position=origin, thickness=4.0, thickness_units="screen"
            )


def lines(
    found: tuple[Relation, ...], points: Floats, labels: Table, selected: tuple[int, ...]
) -> tuple[Floats, Bytes]:
    """The ends [L, 2, 3] of the lines, and their colours [L, 2, 3]; the middle of a segment is the mean of its points.

    Args:
        found: all relations.
        points: [N, 3].
        labels: [N] the segment of each point.
        selected: segments; empty: all relations but "touches".
    """
    shown = [one for one in found if ({one.first, one.second} & {*selected} if selected else one.kind != "touches")]
    middle = {segment: points[labels == segment].mean(0) for one in shown for segment in (one.first, one.second)}
    ends = np.array([[middle[one.first], middle[one.second]] for one in shown], dtype=np.float64).reshape(-1, 2, 3)
    return ends, np.array([[COLORS[one.kind]] * 2 for one in shown], dtype=np.uint8).reshape(-1, 2, 3)
