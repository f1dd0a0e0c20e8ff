"""Which things touch, stand on, hang on and contain which: a scene graph from the labels alone (output after step 8).

Points of two segments are in contact if they are nearest neighbours and near each other. Gravity and the direction of
the surfaces there say what the contact means. Everything is geometry: no class of a thing is known.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint import ops
from torchjoint.results.objects import FILE, add_to_segments, level_axes, oriented_box, read_segments, stored_labels
from torchjoint.results.upright import Array, up_direction
from torchjoint.runtime.foreign_files import damage_is
from torchjoint.scene import Scene, Segmentation

Kind = Literal["stands on", "hangs on", "contains", "touches"]

#: Neighbours of a point among which contacts are sought; their largest distance, in local spacings of the cloud.
NEIGHBORS, REACH = 16, 3.0
#: Two segments touch if each has at least so many points there.
LEAST = 3
#: A surface is level if the cosine between its normal and the upward direction is above the first number, and a wall if
#: it is below the second.
LEVEL, WALL = 0.75, 0.35
#: A contact is at the bottom (top) of a thing if at most this share of the thing's points are below (above) it.
END = 0.15
#: What reaches down to this share of the points does not hang: it is the floor, or stands there.
LOWEST = 0.05
#: A thing that seems to float stands on the level surface below it, if the gap is at most this share of its height: its
#: feet are hidden. The surface is sought at most BESIDE metres beside the thing. Nor is a contact higher than this.
GAP, BESIDE = 0.3, 0.3
#: Of the lowest points of such a thing, at most so many are used.
FEET = 20
#: One thing contains another if its box holds this share of the other's points, and is so many times as large.
CONTAINED_SHARE, LARGER = 0.95, 3.0


@dataclass(frozen=True)
class Relation:
    """One relation of two segments.

    Attributes:
        kind: "stands on", "hangs on", "contains" or "touches". A pair that stands or hangs also touches; this is not
            listed again, but if a gap hides the feet (area 0) and something else of them touches.
        first, second: the segments: `first` stands on `second`. Of "touches" the first is the smaller number.
        area: of the contact, square metres, from the points there; 0 for "contains", and where a gap hides the contact.
        share: the evidence: of the carrier's points in the contact, the share on a level surface or a wall; of the
            contained points, those in the box; 1 for "touches"; 0 where a gap hides the contact.
    """

    kind: Kind
    first: int
    second: int
    area: float
    share: float


@dataclass(frozen=True)
class Relations:
    """The relations of the segments of a cloud, by kind and then by segments."""

    relations: tuple[Relation, ...]
    labels: Tensor = field(compare=False, repr=False)  #: [N] int64, the segment of each point

    def of(self, segment: int) -> list[Relation]:
        """All relations of a segment."""
        return [one for one in self.relations if segment in (one.first, one.second)]

    def save(self, folder: str | Path) -> None:
        """Writes the list "relations" into segments.json of a result's folder, beside what is there."""
        if not torch.equal(stored_labels(Path(folder)), self.labels):
            raise ValueError(f"{folder}: expected the segments of the graph; load_result(folder, edits=False) has them")
        add_to_segments(Path(folder), {"relations": [asdict(one) for one in self.relations]})

    @classmethod
    def load(cls, folder: str | Path) -> Relations:
        """Reads what :meth:`save` wrote."""
        content, labels = read_segments(Path(folder))
        told = f"expected relations, as `torchjoint export {folder} --format graph` adds them"
        with damage_is(f"{Path(folder) / FILE}: {told}"):
            found = tuple(Relation(**one) for one in content["relations"])
            for one in found:
                _check(one, int(labels.max()))
        return cls(found, labels)


def _check(one: Relation, last: int) -> None:
    """Raises ValueError if a relation that was read cannot be one of the segments 0 ... `last`."""
    segments, numbers = {one.first, one.second}, (one.area, one.share)
    is_right = one.kind in get_args(Kind) and len(segments) == 2 and all(type(value) is float for value in numbers)
    is_right = is_right and all(type(segment) is int and 0 <= segment <= last for segment in segments)
    if not is_right or not (0 <= one.area < math.inf and 0 <= one.share <= 1):
        raise ValueError(f"expected a known kind, two segments of the cloud, an area and a share, got {one}")


@dataclass(frozen=True)
class _Contact:
    """The points of two segments that are near each other."""

    own: dict[int, Array]  #: by segment: the indices of its points in the contact
    area: float  #: square metres


@dataclass(frozen=True)
class _Cloud:
    """The points of a result, with what the rules need of them."""

    labels: npt.NDArray[np.int64]  #: [N]
    heights: Array  #: [N] metres along the upward direction
    level: Array  #: [N, 2] metres across it
    tilt: Array  #: [N] |cosine| between the normal and the upward direction
    local: Array  #: [N] the distance of neighbouring points around each point, metres
    low: float  #: the height below which nothing hangs
    members: dict[int, npt.NDArray[np.int64]]  #: the points of each segment that has any


def relations(scene: Scene, result: Segmentation) -> Relations:
    """Finds the relations; see :meth:`torchjoint.results.result.Result.graph`."""
    vertical = up_direction(scene).numpy()
    points, labels = scene.points.double().numpy(), result.points.numpy()
    indices, distances = ops.nearest_neighbors(scene.points, NEIGHBORS)
    cloud = _Cloud(
        labels,
        heights := points @ vertical,
        points @ level_axes(vertical).T,
        _tilt(scene.points, indices, result.points, vertical),
        distances[:, :4].double().mean(1).numpy(),
        float(np.quantile(heights, LOWEST)),
        {one: np.nonzero(labels == one)[0] for one in np.unique(labels).tolist() if one >= 0},
    )
    found: list[Relation] = []
    for (a, b), contact in _contacts(cloud, indices.numpy(), distances.numpy()).items():
        carried = _carried(cloud, contact, a, b) or _carried(cloud, contact, b, a)
        found.append(carried or Relation("touches", a, b, contact.area, 1.0))
    found += _over_gaps(cloud, sorted(cloud.members.keys() - {one.first for one in found if one.kind == "stands on"}))
    standing = {one.first for one in found if one.kind == "stands on"}
    for place, one in enumerate(found):
        if one.kind == "hangs on" and one.first in standing:
            found[place] = Relation("touches", min(one.first, one.second), max(one.first, one.second), one.area, 1.0)
    found += _contained(points, cloud, vertical)
    found.sort(key=lambda one: (get_args(Kind).index(one.kind), one.first, one.second))
    return Relations(tuple(found), result.points)


def _tilt(points: Tensor, indices: Tensor, labels: Tensor, vertical: Array) -> Array:
    """|cosine| between the normals and the upward direction, [N]; a normal is fitted to points of one segment."""
    own = torch.arange(len(points), dtype=indices.dtype)[:, None]
    same = torch.where(labels[indices.long()] == labels[:, None], indices, own)
    normals = ops.fit_normals(points if points.dtype == torch.float32 else (points - points.mean(0)).float(), same)
    return np.abs(normals.double().numpy() @ vertical)


def _contacts(cloud: _Cloud, indices: npt.NDArray[Any], distances: npt.NDArray[Any]) -> dict[tuple[int, int], _Contact]:
    labels, local = cloud.labels, cloud.local
    near = distances <= REACH * np.maximum(local[:, None], local[indices])
    row, column = np.nonzero(near & (labels[indices] != labels[:, None]))
    other = indices[row, column]
    ends = np.concatenate([np.stack([row, other], 1), np.stack([other, row], 1)])
    ends = ends[(labels[ends] >= 0).all(1)]
    # Of each pair of segments, each point of the contact once.
    pairs = np.unique(np.stack([labels[ends].min(1), labels[ends].max(1), ends[:, 0]], 1), axis=0)
    _, starts = np.unique(pairs[:, :2], axis=0, return_index=True)
    contacts = {}
    for start, end in zip(starts, np.append(starts, len(pairs))[1:], strict=True):
        (a, b), own = pairs[start, :2].tolist(), pairs[start:end, 2]
        parts = {segment: own[labels[own] == segment] for segment in (a, b)}
        if min(map(len, parts.values())) >= LEAST:
            contacts[a, b] = _Contact(parts, float((local[own] ** 2).sum()) / 2)
    return contacts


def _carried(cloud: _Cloud, contact: _Contact, upper: int, lower: int) -> Relation | None:
    """How the first of two segments is carried by the second; None if it is not."""
    heights, own, others = cloud.heights[cloud.members[upper]], contact.own[upper], contact.own[lower]
    at, at_other = float(cloud.heights[own].mean()), float(cloud.heights[others].mean())
    tall, reach = float(np.quantile(heights, 0.98) - np.quantile(heights, 0.02)), REACH * float(cloud.local[own].mean())
    is_flat = tall <= 2 * reach
    level, wall = float((cloud.tilt[others] > LEVEL).mean()), float((cloud.tilt[others] < WALL).mean())
    is_low = at <= heights.min() + max(GAP * np.ptp(heights), reach)  # few points may be below: of legs
    if level > 0.5 and at > at_other and is_low and (is_flat or (heights < at).mean() <= END):
        return Relation("stands on", upper, lower, contact.area, level)
    own_area, area = ((cloud.local[cloud.members[one]] ** 2).sum() for one in (upper, lower))
    if is_flat or heights.min() <= cloud.low or own_area >= area:
        return None
    if level > 0.5 and at < at_other and (heights > at).mean() <= END:
        return Relation("hangs on", upper, lower, contact.area, level)
    if wall > 0.5 and np.ptp(cloud.heights[own]) > 0.5 * tall and np.ptp(cloud.heights[cloud.members[lower]]) > tall:
        return Relation("hangs on", upper, lower, contact.area, wall)
    return None


def _over_gaps(cloud: _Cloud, floating: list[int]) -> list[Relation]:
    """What stands on a level surface although nothing of its feet was seen."""
    tree, found = cKDTree(cloud.level), []
    for segment in floating:
        own = cloud.members[segment]
        heights = cloud.heights[own]
        low, tall = float(heights.min()), float(np.ptp(heights))
        feet = own[heights <= low + 0.1 * tall]
        feet = feet[np.linspace(0, len(feet) - 1, min(len(feet), FEET)).astype(int)]
        near = np.unique(np.concatenate(tree.query_ball_point(cloud.level[feet], BESIDE)).astype(np.int64))
        gap = low - cloud.heights[near]
        below = near[(cloud.labels[near] != segment) & (cloud.labels[near] >= 0) & (gap > 0) & (gap <= GAP * tall)]
        carriers = []
        for other in np.unique(cloud.labels[below]).tolist():
            points = below[cloud.labels[below] == other]
            if len(points) >= LEAST and (cloud.tilt[points] > LEVEL).mean() > 0.5:
                carriers.append((float(np.median(cloud.heights[points])), other))
        if carriers:
            found.append(Relation("stands on", segment, max(carriers)[1], 0.0, 0.0))
    return found


def _contained(points: Array, cloud: _Cloud, vertical: Array) -> list[Relation]:
    boxes = {one: oriented_box(points[of], vertical) for one, of in cloud.members.items() if len(of) >= LEAST}
    found = []
    for outer, box in boxes.items():
        # What lies on a side of the box, as a picture on a wall, is not inside.
        half = box.size / 2 - REACH * float(np.median(cloud.local[cloud.members[outer]]))
        for inner, other in boxes.items():
            is_larger = box.size.prod() >= LARGER * other.size.prod()
            if inner == outer or not is_larger or (np.abs((other.center - box.center) @ box.axes.T) > half).any():
                continue
            at = (points[cloud.members[inner]] - box.center) @ box.axes.T
            share = float((np.abs(at) <= box.size / 2).all(1).mean())
            if share >= CONTAINED_SHARE:
                found.append(Relation("contains", outer, inner, 0.0, share))
    return found
