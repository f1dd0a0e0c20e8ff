"""The cloud in the browser: a sample of all points, and all points of the blocks near the camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from torchjoint.viewer.model import Bytes

Floats = npt.NDArray[np.floating]
#: A point can be hit within this angle from the ray (tangent): about three pixels.
ANGLE = 0.005


def pick_point(points: Floats, origin: Floats, direction: Floats, radius: float) -> int | None:
    """Returns the index of the first point along a ray; None if there is none.

    Args:
        points: [N, 3].
        origin, direction: [3] of the ray.
        radius: a point at most this far from the ray is hit at any depth: half the spacing of the points.
    """
    direction = direction / np.linalg.norm(direction)
    offset = points - origin
    along = offset @ direction
    across = np.sqrt(np.maximum((offset * offset).sum(1) - along * along, 0))
    near = np.nonzero((along > 0) & (across < np.maximum(ANGLE * along, radius)))[0]
    if not len(near):
        return None
    front = along[near].min()
    first = near[along[near] <= front + 4 * radius]  # of the surface in front, the point closest to the ray
    return int(first[np.argmin(across[first])])


#: Largest numbers of points: in the sample, which is always drawn; in a block; drawn at the same time.
SAMPLE, BLOCK, BUDGET = 400_000, 60_000, 1_600_000

#: Radius of the ball at a click, in sizes of a point.
MARK = 4.0


def middle_of(points: Floats) -> Floats:
    """The middle of points, in whole kilometres: the page has float32, which is too coarse for places in surveys."""
    return points.astype(np.float64).reshape(-1, 3).mean(0).round(-3)


def point_spacing(points: Floats) -> float:
    """The third quartile of the points' distances to their nearest neighbours, metres."""
    if len(points) < 2:
        return 0.01
    distances = cKDTree(points).query(points[:: max(1, len(points) // 2000)], k=2)[0][:, 1]
    return max(float(np.quantile(distances, 0.75)), 1e-6)


def blocks_of(points: Floats, most: int = BLOCK) -> list[npt.NDArray[np.int64]]:
    """Cuts a cloud at medians until each block has at most `most` points; returns the indices of each block."""
    todo, blocks = [np.arange(len(points))], []
    while todo:
        block = todo.pop()
        if len(block) <= most:
            blocks.append(block)
            continue
        own = points[block]
        order = np.argsort(own[:, int(np.argmax(np.ptp(own, axis=0)))], kind="stable")
        half = len(order) // 2
        todo += [block[order[half:]], block[order[:half]]]
    return blocks


class CloudView:
    """The points on a viser server, and their colours.

    Args:
        server: viser.ViserServer.
        points: [N, 3] metres.
        colors: [N, 3].
    """

    def __init__(self, server: Any, points: Floats, colors: Bytes) -> None:
        self._server, self._points, self._colors = server, points, colors
        self._origin = middle_of(points)
        self.size = 1.2 * point_spacing(points)
        everything = np.random.default_rng(0).permutation(len(points))
        self._parts = [everything[:SAMPLE]]
        rest = everything[SAMPLE:]
        self._parts += [rest[block] for block in blocks_of(points[rest])] if len(rest) else []
        self._centers = np.array([points[part].mean(0) for part in self._parts[1:]]).reshape(-1, 3)
        self._current: set[int] = set()  # parts whose colours are up to date
        self._shown = {0}
        self._handles: dict[int, Any] = {}
        self._marks: list[Any] = []
        self._draw()

    def remove(self) -> None:
        """Removes the points from the page."""
        for handle in (*self._handles.values(), *self._marks):
            handle.remove()

    def mark(self, clicks: Sequence[tuple[int, bool]]) -> None:
        """Draws a ball at each clicked point: green on the thing, red beside it."""
        for handle in self._marks:
            handle.remove()
        self._marks = [
            self._server.scene.add_icosphere(
                f"/click/{index}",
                MARK * self.size,
                (0, 150, 60) if belongs else (210, 30, 30),
                position=self._points[point],
            )
            for index, (point, belongs) in enumerate(clicks)
        ]

    def recolor(self, colors: Bytes) -> None:
        """Changes the colours; those of hidden blocks change when the blocks are shown."""
        self._colors, self._current = colors, set()
        self._draw()

    def resize(self, factor: float) -> None:
        """Sets the drawn size of points, as a multiple of the default."""
        for handle in self._handles.values():
            handle.point_size = factor * self.size

    def look_from(self, position: npt.NDArray[np.float64]) -> None:
        """Shows all points of the blocks nearest to a position, up to the largest number of drawn points."""
        order = np.argsort(((self._centers - position) ** 2).sum(1), kind="stable")
        room = max(0, BUDGET - SAMPLE) // BLOCK
        shown = {0, *(int(index) + 1 for index in order[:room])}
        if shown != self._shown:
            self._shown = shown
            self._draw()

    def _draw(self) -> None:
        for index, part in enumerate(self._parts):
            handle, visible = self._handles.get(index), index in self._shown
            if handle is not None and handle.visible != visible:
                handle.visible = visible
            if not visible or index in self._current:
                continue
            if handle is None:
                self._handles[index] = self._server.scene.add_point_cloud(
                    f"/cloud/{index}",
                    self._points[part] - self._origin,
                    self._colors[part],
                    position=self._origin,
                    point_size=self._handles[0].point_size if index else self.size,
                    point_shape="circle",
                    point_shading="flat",
                    precision="float32",
                )
            else:
                handle.colors = self._colors[part]
            self._current.add(index)
