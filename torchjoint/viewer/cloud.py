"""The cloud in the browser: a sample of all points, and all points of the blocks near the camera."""

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


#: Largest numbers of points: in the sample, which is always drawn; in a block; drawn at the same time; lit by hovering.
SAMPLE, BLOCK, BUDGET, LIT = 400_000, 60_000, 1_600_000, 30_000
SIGNS = ("\N{MINUS SIGN}", "+")  #: At a click beside the thing, and on it.
#: How points are drawn.
LOOKS = {"point_shape": "circle", "point_shading": "flat", "precision": "float32"}


def middle_of(points: Floats) -> Floats:
    """The middle of points, in whole kilometres: the page has float32, which is too coarse for places in surveys."""
    return points.astype(np.float64).reshape(-1, 3).mean(0).round(-3)


def point_radius(points: Floats) -> float:
    """The radius, metres, with which points cover their surface: by the distance of the eighth neighbour.

    The first ones of a LiDAR's point are all on its own line, and there would be stripes.
    """
    if len(points) < 2:
        return 0.01
    distances = cKDTree(points).query(points[:: max(1, len(points) // 500)], k=min(9, len(points)))[0][:, -1]
    return max(0.75 * float(np.quantile(distances, 0.75)), 1e-6)


def block_radii(points: Floats, blocks: Sequence[npt.NDArray[np.int64]]) -> Floats:
    """The radius of the points of each block; at most three times the usual one, which few far points would have."""
    radii = np.array([point_radius(points[block]) for block in blocks])
    return np.minimum(radii, 3 * np.median(radii))


def blocks_of(points: Floats, most: int = BLOCK) -> list[npt.NDArray[np.int64]]:
    """Cuts a cloud at medians until each block has at most `most` points; returns the indices of each block."""
    todo, blocks, columns = [np.arange(len(points))], [], np.ascontiguousarray(points.T)
    while todo:
        block = todo.pop()
        if len(block) <= most:
            blocks.append(block)
            continue
        own, half = columns[:, block], len(block) // 2
        order = np.argpartition(own[int(np.argmax(np.ptp(own, axis=1)))], half)
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
        self._origin, self._factor = middle_of(points), 1.0
        of_sample, generator = min(1.0, SAMPLE / max(len(points), 1)), np.random.default_rng(0)
        blocks = blocks_of(points, min(BLOCK, max(len(points) // 16, 1000)))
        self._parts: list[npt.NDArray[np.int64]] = []  # of each block its part of the sample, and the rest
        for block in map(generator.permutation, blocks):
            self._parts += np.split(block, [int(np.ceil(of_sample * len(block)))])
        # Large clouds are surveys, whose points are spread at random, as those of a sample are: larger, against gaps.
        self._sparse = block_radii(points, self._parts[::2]) * (1.3 if of_sample < 1 else 1)
        self._whole = self._sparse * of_sample**0.5  # the distances of points of a surface
        self.size = float(np.median(self._whole))
        self._centers = np.array([points[block].mean(0) for block in blocks]).reshape(-1, 3)
        # Parts whose colours are up to date; blocks of which all points are shown.
        self._current, self._near = set[int](), set[int]()
        self._handles: dict[int, Any] = {}
        self._drawn: npt.NDArray[np.bool_] | None = None  # [N]; None: all points
        self._marks, self._lit = list[Any](), list[Any]()
        self._draw()

    def remove(self) -> None:
        """Removes the points from the page."""
        for handle in (*self._handles.values(), *self._marks, *self._lit):
            handle.remove()

    def mark(self, clicks: Sequence[tuple[int, bool]]) -> None:
        """Writes a sign at each clicked point: + on the thing, - beside it."""
        for handle in self._marks:
            handle.remove()
        add, points = self._server.scene.add_label, self._points
        self._marks = [add(f"/click/{one}", SIGNS[on], position=points[at]) for one, (at, on) in enumerate(clicks)]

    def light(self, client: Any, name: str, point: int, members: npt.NDArray[np.int64]) -> None:
        """Lights a thing up on the page of one client, and writes its name at one of its points."""
        shown = members[:: (step := -(-len(members) // LIT) or 1)]
        colors = (255 - 0.5 * (255.0 - self._colors[shown])).astype(np.uint8)
        at = self._points[shown] + 0.005 * (client.camera.position - self._points[shown])  # before their own colours
        self._lit = [client.scene.add_label("/name", name, position=self._points[point], anchor="bottom-center")]
        if len(shown):  # the page fails on a cloud without points, as of a selected thing
            self._lit.append(self._add(client.scene, "/lit", at, colors, 1.1 * step**0.5 * self._factor * self.size))

    def unlight(self) -> None:
        """Takes back what :meth:`light` drew."""
        while self._lit:
            self._lit.pop().remove()

    def recolor(self, colors: Bytes, drawn: npt.NDArray[np.bool_] | None = None) -> None:
        """Changes the colours; those of hidden blocks change when the blocks are shown. `drawn`: [N]; None: all."""
        for handle in () if drawn is self._drawn else self._handles.values():
            handle.remove()
        self._handles = self._handles if drawn is self._drawn else {}
        self._colors, self._current, self._drawn = colors, set(), drawn
        self._draw()

    def resize(self, factor: float) -> None:
        """Sets the drawn size of points, as a multiple of the default."""
        self._factor = factor
        self._draw()

    def look_from(self, position: npt.NDArray[np.float64]) -> None:
        """Shows all points of the blocks nearest to a position, up to the largest number of drawn points."""
        order = np.argsort(((self._centers - position) ** 2).sum(1), kind="stable")
        rest = np.cumsum([len(self._parts[2 * index + 1]) for index in order.tolist()])
        near = {*order[rest <= BUDGET - SAMPLE].tolist()}
        if near != self._near:
            self._near = near
            self._draw()

    def _add(self, scene: Any, name: str, at: Floats, colors: Bytes, size: float) -> Any:
        return scene.add_point_cloud(name, at - self._origin, colors, position=self._origin, point_size=size, **LOOKS)

    def _draw(self) -> None:
        for index, part in enumerate(self._parts):
            part = part if self._drawn is None else part[self._drawn[part]]
            block, handle = index // 2, self._handles.get(index)
            visible = index % 2 == 0 or block in self._near
            size = self._factor * float((self._whole if block in self._near else self._sparse)[block])
            if handle is not None and (handle.visible, handle.point_size) != (visible, size):
                handle.visible, handle.point_size = visible, size
            if not visible or index in self._current or not len(part):
                continue
            if handle is None:
                name = f"/cloud/{index}"
                self._handles[index] = self._add(self._server.scene, name, self._points[part], self._colors[part], size)
            else:
                handle.colors = self._colors[part]
            self._current.add(index)
