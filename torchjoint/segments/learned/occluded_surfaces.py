"""Step 6, method learned: joins regions of one surface that an occluder divides.

Lines along the rows and columns of images cross occluders (:mod:`~torchjoint.views.occluders`). If both ends of a
line lie in one plane, and the frames do not see free space between them, the line votes for joining the regions of its
ends. Such regions do not touch, so the boundary model never judges them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import normalize

from torchjoint.cloud.normals import dot, length
from torchjoint.cloud.scales import Scales
from torchjoint.runtime.threads import parallel_map
from torchjoint.segments.learned.region_statistics import RegionStatistics, color_contrasts, sum_by
from torchjoint.views.observations import Observation
from torchjoint.views.occluders import DEPTH_STEP, STEP_IN_NOISE, CoarseZBuffer
from torchjoint.views.visibility import nearest_pixel, project

# These numbers were chosen on table-tops of mOSD and on generated scenes (seeds 0 to 3). DEPTH_STEP was chosen on one
# table-top of the half that is used for scores, so these scores are too good for this step.

#: Largest distance of each end from the other end's plane: share of the gap plus multiples of the noise.
OFF_PLANE, OFF_IN_NOISE = 0.1, 4.0
#: Cosine of the largest angle between the normals at the two ends, 26 degrees.
SAME_DIRECTION = 0.9
#: Places between the two ends, as shares of the way, at which a third region or free space is searched.
PLACES = (0.25, 0.5, 0.75)
#: A region is at a place if its nearest point is nearer than this many spacings, or this many multiples of the noise.
NEAR_IN_SPACINGS, NEAR_IN_NOISE = 2.0, 8.0
#: Two regions are joined if at least this many lines, and this share of the lines between them, vote for it.
MIN_LINES, AGREEING_SHARE = 4, 0.5
#: Largest difference of the mean colours of two joined regions, in multiples of the spread of colours within them.
MAX_CONTRAST = 1.25


class Occlusions(NamedTuple):
    """Pairs of superpoints at the two ends of lines across an occluder."""

    pairs: Tensor  #: [2, K] int64, superpoints a < b, ascending
    num_lines: Tensor  #: [K] int64, number of lines in all images
    may_continue: Tensor  #: [K] bool: both lie in one plane, and the frames do not see free space between them
    between: Tensor  #: [len(PLACES), K] int64, the superpoint at each place; -1 = none, or not in one plane

    def grouped(self, of_superpoint: Tensor) -> Occlusions:
        """The same for groups of superpoints; `of_superpoint` [P] int64 is the group of each. Pairs may occur twice."""
        between = torch.where(self.between >= 0, of_superpoint[self.between], -1)
        return self._replace(pairs=of_superpoint[self.pairs], between=between)

    @classmethod
    def union(cls, occlusions: Sequence[Occlusions], starts: Sequence[int]) -> Occlusions:
        """Occlusions of several graphs as one; the superpoints of number k are numbered from `starts[k]` on."""
        moved = [
            one._replace(pairs=one.pairs + start, between=torch.where(one.between >= 0, one.between + start, -1))
            for one, start in zip(occlusions, starts, strict=True)
        ]
        return cls(*(torch.cat(values, -1) for values in zip(*moved, strict=True)))


def find_occlusions(
    superpoint: Tensor,
    statistics: RegionStatistics,
    points: Tensor,
    scales: Scales,
    observations: Sequence[Observation],
) -> Occlusions:
    """Counts the lines of all images.

    Args:
        superpoint: [N] int64, superpoint of each point, 0 ... P - 1.
        statistics: statistics of the superpoints.
        points: [N, 3] metres.
        scales: noise and spacing of the points.
        observations: the frames, with their lines.
    """
    num_superpoints = len(statistics.size)
    ends = [torch.empty(2, 0, dtype=torch.int64), *(seen.lines for seen in observations)]
    one, other = superpoint[torch.cat(ends, 1)]
    key, num_lines = torch.unique(_keys(one, other, num_superpoints)[one != other], return_counts=True)
    a, b = key // max(num_superpoints, 1), key % max(num_superpoints, 1)
    may_continue = _in_one_plane(statistics, a, b)
    between = torch.full((len(PLACES), len(key)), -1)
    if may_continue.any():
        one, other = a[may_continue], b[may_continue]
        ways = torch.stack([torch.lerp(statistics.mean[one], statistics.mean[other], place) for place in PLACES])
        between[:, may_continue] = _nearest_superpoints(ways, superpoint, points, scales)
        step = STEP_IN_NOISE * torch.maximum(statistics.noise[one], statistics.noise[other])
        may_continue[may_continue.clone()] = ~_is_seen_through(ways, step, observations).any(0)
    return Occlusions(torch.stack([a, b]), num_lines, may_continue, between)


def continued_surfaces(occlusions: Occlusions, statistics: RegionStatistics, touching: Tensor) -> tuple[Tensor, Tensor]:
    """The pairs of regions that are one surface behind an occluder.

    Regions that touch are not included, because the boundary model has judged them.

    Args:
        occlusions: occlusions of the regions.
        statistics: statistics of R regions.
        touching: [2, T] int64, the pairs of regions that touch.

    Returns:
        [2, B] int64 regions a < b, ascending; and [B] float32, the share of the lines against joining them, at most
        1 - AGREEING_SHARE. Without colours there are no pairs, because two surfaces may lie in one plane by chance.
    """
    num_regions, (first, second), hidden = len(statistics.size), occlusions.pairs, occlusions.between
    of_regions = _keys(first, second, num_regions)
    is_free = ((hidden < 0) | (hidden == first) | (hidden == second)).all(0)
    apart = (first != second) & ~torch.isin(of_regions, _keys(touching[0], touching[1], num_regions))
    key, of_pair = torch.unique(of_regions[apart], return_inverse=True)
    lines = sum_by(of_pair, occlusions.num_lines[apart], len(key))
    votes = sum_by(of_pair, (occlusions.num_lines * (occlusions.may_continue & is_free))[apart], len(key))
    share = votes.double() / lines
    pairs = torch.stack([key // num_regions, key % num_regions])
    joined = (votes >= MIN_LINES) & (share >= AGREEING_SHARE)
    joined &= color_contrasts(statistics, *pairs) <= MAX_CONTRAST  # NaN without colours: not joined
    return pairs[:, joined], (1 - share[joined]).float()


def _keys(a: Tensor, b: Tensor, count: int) -> Tensor:
    """One number for each unordered pair of superpoints or regions 0 ... count - 1."""
    return torch.minimum(a, b) * count + torch.maximum(a, b)


def _in_one_plane(superpoints: RegionStatistics, a: Tensor, b: Tensor) -> Tensor:
    """[K] bool: each of two superpoints lies in the other's plane, and both normals have about the same direction."""
    normal = normalize(superpoints.normal, dim=1)
    way = superpoints.mean[b] - superpoints.mean[a]
    off = OFF_PLANE * length(way) + OFF_IN_NOISE * torch.maximum(superpoints.noise[a], superpoints.noise[b])
    in_planes = (dot(normal[a], way).abs() <= off) & (dot(normal[b], way).abs() <= off)
    return in_planes & (dot(normal[a], normal[b]) >= SAME_DIRECTION)


def _nearest_superpoints(ways: Tensor, superpoint: Tensor, points: Tensor, scales: Scales) -> Tensor:
    """The superpoint at each place [L, K, 3] between two superpoints: [L, K] int64, -1 = none."""
    distance, nearest = cKDTree(points.double().numpy()).query(ways.numpy())
    found = torch.from_numpy(nearest)
    near = torch.maximum(NEAR_IN_SPACINGS * scales.spacing[found], NEAR_IN_NOISE * scales.noise[found])
    return torch.where(torch.from_numpy(distance) < near, superpoint[found], -1)


def _is_seen_through(ways: Tensor, step: Tensor, observations: Sequence[Observation]) -> Tensor:
    """Whether places between pairs of superpoints are free: more frames see through a place than see something there.

    An occluder hides a place from one frame, but maybe not from another one. If this other frame sees something behind
    the place, no surface is there. The z-buffer of each frame is computed again here, because the z-buffers of a long
    recording would take much memory.

    Args:
        ways: [L, K, 3] float64 metres.
        step: [K] metres, smallest difference in depth between a place and something behind it.
        observations: the frames.

    Returns:
        [L, K] bool.
    """
    places, steps = ways.reshape(-1, 3).float(), step.repeat(len(ways))
    votes = torch.zeros(len(places), dtype=torch.int64)
    for vote in parallel_map(lambda seen: _votes_for_free_space(places, steps, seen), observations):
        votes += vote
    return (votes > 0).view(ways.shape[:2])


def _votes_for_free_space(places: Tensor, step: Tensor, seen: Observation) -> Tensor:
    """[M] int8: 1 where the frame sees something behind a place [M, 3], -1 where it sees something there, else 0."""
    vote = torch.zeros(len(places), dtype=torch.int8)
    if not seen.num_points:
        return vote
    cell, nearest = CoarseZBuffer.of(seen.visible)
    depth = torch.where(nearest >= 0, seen.visible.z[nearest], torch.inf)
    # The nearest depth of nine cells: where a frame sees through a gap, all nine are far.
    depth = -torch.nn.functional.max_pool2d(-depth[None], 3, stride=1, padding=1)[0]
    height, width = (cell * side for side in depth.shape)
    at = project(places, seen.intrinsics, seen.world_to_camera, (height, width))
    in_cell = depth[nearest_pixel(at.v) // cell, nearest_pixel(at.u) // cell]
    enough = torch.maximum(DEPTH_STEP * in_cell, step[at.point])
    behind = in_cell - at.z
    vote[at.point] = (behind > enough).to(torch.int8) - (behind.abs() <= enough).to(torch.int8)
    vote[at.point[in_cell.isinf()]] = 0  # nothing is seen
    return vote
