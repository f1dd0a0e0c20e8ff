"""Steps 7 and 8 by geodesic label propagation: the labels of the points are propagated over the image."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import Config
from torchjoint.images.contours import smooth
from torchjoint.labels.joint_ids import by_first_appearance, look_up
from torchjoint.ops.internal import outvoted_markers
from torchjoint.runtime.groups import best_of_groups, with_none
from torchjoint.views.observations import Observation
from torchjoint.views.visibility import Visible

#: Number of nearest markers that vote on a marker.
VOTERS = 12

#: A marker is tested only if another label is near: in its cell or in one of the 8 around it. This is the side of a
#: cell, in mean distances between markers.
CELL_SIDE = 3.0


def nearest_labels(visible: Visible, point_labels: Tensor, size: tuple[int, int]) -> Tensor:
    """Labels each pixel that contains points with the label of its point nearest to the camera.

    Of equally near points the first counts.

    Args:
        visible: M visible points.
        point_labels: [M] int64, 3D label of each visible point.
        size: (H, W) of the image, pixels.

    Returns:
        [H, W] int32, -1 for pixels without a point.
    """
    pixel = visible.row * size[1] + visible.column
    nearest, _ = best_of_groups(pixel, torch.arange(len(pixel)), -visible.z, size[0] * size[1])
    return with_none(point_labels.to(torch.int32))[nearest].view(size)


def without_outvoted(markers: Tensor, colors: Tensor, color_weight: float) -> Tensor:
    """Removes markers whose neighbours mostly have other labels.

    Visibility has a depth tolerance, because the points of a slanted surface lie behind one another. So hidden points a
    few centimetres behind a surface count as visible, such as points of a table behind a plate. Their pixels have the
    colour of the plate, and there the plate has more markers.

    The nearest markers, by place and colour, vote (:func:`torchjoint.ops.internal.outvoted_markers`). A marker
    stays if at least half of its voters have its label. It also stays if these are at least half of all other markers
    of its label, so that small objects stay, or if no other label is near.

    Args:
        markers: [H, W] int32, -1 = none.
        colors: [3, H, W] in [0, 1].
        color_weight: pixels per RGB distance.

    Returns:
        [H, W] int32.
    """
    return markers.masked_fill(outvoted_markers(markers, colors, color_weight, VOTERS, CELL_SIDE), -1)


#: Path cost of a boundary of strength 1, in units of the cost of an RGB distance of 1. Boundaries add little to
#: colours: without them, F of images of rooms falls by .002, and that of table-tops does not change.
BOUNDARY_SHARE = 0.5

#: A connected part of one label with fewer points is given to its neighbours. A single point mostly belongs to the
#: background and is seen through a gap. Points in the same pixel count as one.
MIN_POINTS = 2

#: An initial segment without points keeps its own id if its area would hold this many points at the image's mean point
#: density. Much lower values split objects with few points; much higher ones give sky and glass labels of neighbours.
UNSEEN = 30.0

#: A segment with few points also keeps its own id: it has at most this share of the points that its area would hold,
#: and more than half of it is far from all points. Such a segment is sky with some points of poles and trees. Without
#: this rule their labels flood the sky; with it they keep only pixels within the points' mean spacing. Tree tops above
#: the highest beam of a LiDAR have more points in their lower part, so they keep the label of the tree.
SPARSE = 0.1


class SuperpointNumbers(NamedTuple):
    """The superpoints of a hierarchy, numbered in the order of their segments.

    So of equally cheap paths the one from the lowest superpoint is one from the lowest segment.
    """

    of_point: Tensor  #: [N] int64, number of each point's superpoint
    segment: Tensor  #: [P] int32, segment of each number, ascending
    superpoint: Tensor  #: [P] int64, superpoint of each number

    @classmethod
    def of(cls, superpoint: Tensor, segment: Tensor) -> SuperpointNumbers:
        """The numbers of P superpoints; `superpoint` [N] int64 is that of each point, `segment` [P] int64 their own."""
        by_segment = torch.argsort(segment, stable=True)
        return cls(torch.argsort(by_segment)[superpoint], segment[by_segment].to(torch.int32), by_segment)


def propagate(seen: Observation, point_labels: Tensor, num_segments: int, config: Config) -> tuple[Tensor, int]:
    """Geodesic label propagation, steps 7 and 8 in one: each pixel gets the label of the point with the cheapest path.

    Paths are cheap within a region and expensive across image edges (:func:`torchjoint.ops.propagate_labels`), so
    labels meet at edges. A large initial segment with no or very few points gets an id of its own; these ids start at
    `num_segments`.

    Args:
        seen: the frame.
        point_labels: [M] int64, 3D label of each visible point.
        num_segments: number of 3D segments.
        config: the refinement, and the smoothing of the image graph.

    Returns:
        ([H, W] int32, the next free id); pixels that are -1 in the initial labels stay -1.
    """
    costs = colors, _, color_weight, _ = path_costs(seen, config)
    markers = without_outvoted(nearest_labels(seen.visible, point_labels, seen.size), colors, color_weight)
    labels = ops.propagate_labels(markers, *costs, MIN_POINTS)
    return _keep_unseen(labels, markers >= 0, seen.labels, num_segments)


def propagate_superpoints(
    seen: Observation, num_segments: int, superpoints: SuperpointNumbers, config: Config
) -> tuple[Tensor, int, Tensor]:
    """As :func:`propagate`, of the superpoints of a hierarchy: the same labels, and the superpoint in each pixel.

    Returns:
        ([H, W] int32 labels, the next free id, [H, W] int64 superpoints). A pixel's superpoint is a superpoint of its
        segment; -1 in pixels without a 3D segment.
    """
    costs = path_costs(seen, config)
    markers = superpoint_markers(seen, superpoints, costs)
    found = ops.propagate_labels(markers, *costs, MIN_POINTS, superpoints.segment)
    labels, next_free = _keep_unseen(look_up(superpoints.segment, found, -1), markers >= 0, seen.labels, num_segments)
    has_segment = (labels >= 0) & (labels < num_segments)
    return labels, next_free, torch.where(has_segment, look_up(superpoints.superpoint, found, -1), -1)


def superpoint_markers(
    seen: Observation, superpoints: SuperpointNumbers, costs: tuple[Tensor, Tensor, float, float]
) -> Tensor:
    """The superpoint [H, W] int32 in each pixel with points; -1 where the segments around it outvote its own.

    `costs`: of :func:`path_costs`.
    """
    colors, _, color_weight, _ = costs
    markers = nearest_labels(seen.visible, superpoints.of_point[seen.visible.point], seen.size)
    segments = without_outvoted(look_up(superpoints.segment, markers, -1), colors, color_weight)
    return markers.masked_fill_(segments < 0, -1)


def path_costs(seen: Observation, config: Config) -> tuple[Tensor, Tensor, float, float]:
    """What paths cost in a frame: colours [3, H, W] and boundaries [H, W], both in [0, 1], and their weights."""
    colors = smooth(seen.image[None].float() / 255, config.image_graph.smoothing)[0].clamp_(0, 1)
    weight = config.refinement.color_weight
    return colors, seen.boundary.float() / 255, weight, BOUNDARY_SHARE * weight


def _keep_unseen(labels: Tensor, hit: Tensor, initial: Tensor, first_free: int) -> tuple[Tensor, int]:
    """Gives each initial segment that is not in the cloud an id of its own.

    Such a segment has no points, although its area would hold UNSEEN points at the mean density. Or it has few points
    (see SPARSE) and more than half of it is far from all points: a square around a far pixel would hold UNSEEN points
    but has none. In this second case pixels within the mean spacing of points keep their labels. In an image without
    points every initial segment gets an id of its own. `hit`: [H, W] bool, pixels with points. Returns the labels
    [H, W] int32, and the next free id.
    """
    num_initial = int(initial.max()) + 1 if initial.numel() else 0
    segment = initial.reshape(-1).long() + 1
    area = torch.bincount(segment, minlength=num_initial + 1)[1:]
    num_hit = torch.bincount(segment[hit.view(-1)], minlength=num_initial + 1)[1:]
    num_points = int(hit.sum())  # points in the same pixel count as one
    expected = area.float() * (num_points / hit.numel())
    unseen = (num_hit == 0) & ((expected >= UNSEEN) | (num_points == 0))
    sparse = (num_hit > 0) & (expected >= UNSEEN) & (num_hit <= SPARSE * expected)
    own_place = torch.ones_like(hit)
    if sparse.any():
        spacing = math.sqrt(hit.numel() / num_points)
        far = _no_hit_within(hit, math.floor(math.sqrt(UNSEEN) * spacing / 2))
        unseen |= sparse & (2 * torch.bincount(segment[far.view(-1)], minlength=num_initial + 1)[1:] > area)
        own_place = _no_hit_within(hit, math.floor(spacing)) | look_up(num_hit == 0, initial, False)
    if not unseen.any():
        return torch.where(initial < 0, initial.to(torch.int32), labels), first_free
    kept = by_first_appearance(initial, unseen)
    names = torch.full((num_initial,), -1, dtype=torch.int32)
    names[kept] = first_free + torch.arange(len(kept), dtype=torch.int32)
    own = torch.where(own_place, look_up(names, initial, -1), -1)
    return torch.where((own >= 0) | (initial < 0), own, labels), first_free + len(kept)


def _no_hit_within(hit: Tensor, reach: int) -> Tensor:
    """Whether the square of 2 `reach` + 1 pixels a side around each pixel, clipped to the image, has no hit; [H, W]."""
    total = torch.nn.functional.pad(hit.int(), (reach + 1, reach, reach + 1, reach)).cumsum(0).cumsum(1)
    rows = total[2 * reach + 1 :] - total[: -2 * reach - 1]
    return rows[:, 2 * reach + 1 :] == rows[:, : -2 * reach - 1]
