"""Lines in the cloud that show which things stand on, hang on, contain and touch which."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.results.relations import Kind, Relation, relations
from torchjoint.scene import Scene, Segmentation
from torchjoint.viewer.model import Bytes, Model

COLORS: dict[Kind, tuple[int, int, int]] = {
    "stands on": (20, 140, 50),
    "hangs on": (230, 130, 0),
    "contains": (40, 90, 230),
    "touches": (120, 120, 120),
}
#: Pixels.
THICKNESS = 4.0


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
            scene = Scene(model.result.scene.points)
            found = relations(scene, Segmentation(torch.from_numpy(labels), ()), torch.from_numpy(model.up))
            self._labels, self._found = labels, found.relations
        ends, colors = lines(self._found, model.result.scene.points.numpy(), labels, model.selected)
        if len(ends):
            self._handle = self._server.scene.add_line_segments(
                "/relations", ends, colors, thickness=THICKNESS, thickness_units="screen"
            )


def lines(
    found: tuple[Relation, ...],
    points: npt.NDArray[np.float32],
    labels: npt.NDArray[np.int64],
    selected: tuple[int, ...],
) -> tuple[npt.NDArray[np.float32], Bytes]:
    """The ends [L, 2, 3] of the lines, and their colours [L, 2, 3]; the middle of a segment is the mean of its points.

    Args:
        found: all relations.
        points: [N, 3].
        labels: [N] the segment of each point.
        selected: segments; empty: all relations but "touches".
    """
    shown = [one for one in found if ({one.first, one.second} & {*selected} if selected else one.kind != "touches")]
    middle = {segment: points[labels == segment].mean(0) for one in shown for segment in (one.first, one.second)}
    ends = np.array([[middle[one.first], middle[one.second]] for one in shown], dtype=np.float32).reshape(-1, 2, 3)
    colors = np.array([[COLORS[one.kind]] * 2 for one in shown], dtype=np.uint8).reshape(-1, 2, 3)
    return ends, colors
