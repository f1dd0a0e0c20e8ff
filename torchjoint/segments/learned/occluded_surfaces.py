"""Step 6, method learned: joins regions of one surface whose middle something nearer hides.

Follow a row or a column of an image. Where the depth falls by a step and later rises by a step, something nearer lies
between two ends. If both ends lie in one plane, and no frame sees through the place between them, the line votes for
joining the regions of its ends. Such regions do not touch, so the model of boundaries never judges them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import normalize

from torchjoint.cloud._vectors import dot, length
from torchjoint.cloud.scales import Scales
from torchjoint.runtime.threads import parallel_map
from torchjoint.segments.learned.region_statistics import RegionStatistics, color_contrasts, pooled
from torchjoint.segments.learned.summaries import sum_by
from torchjoint.views.observation import Observation
from torchjoint.views.projection import nearest_pixel, project
from torchjoint.views.visibility import Visible

# These numbers were chosen on table-tops of mOSD and on generated scenes (seeds 0 to 3). DEPTH_STEP was set by looking
# at a table-top of the half that serves for scores, so the scores there flatter this step.

#: Smallest step between an occluder and what lies behind it, as a share of the depth, and in multiples of the noise.
DEPTH_STEP, STEP_IN_NOISE = 0.03, 4.0
#: Side of the cells along which lines run, in distances between neighbouring points in the image.
CELL = 1.5
#: Pixels of the squares by which the area of the visible points is measured.
SQUARE = 8
#: Largest distance of each end from the other end's plane: a share of the gap, and multiples of the noise.
OFF_PLANE, OFF_IN_NOISE = 0.1, 4.0
#: Cosine of the largest angle between the normals at the two ends, 26 degrees.
SAME_DIRECTION = 0.9
#: Where on the way between the ends a third region, or free space, is looked for.
PLACES = (0.25, 0.5, 0.75)
#: It is there if its nearest point is nearer than so many spacings of the points, or multiples of their noise.
NEAR, NEAR_IN_NOISE = 2.0, 8.0
#: Two regions are joined by at least so many lines, and so large a share of the lines between them.
MIN_LINES, SHARE = 4, 0.5
#: Largest difference of their mean colours, in multiples of the spread of the colours within them.
MAX_CONTRAST = 1.25


class Occlusions(NamedTuple):
    """Pairs of pieces at the ends of lines that cross something nearer."""

    pairs: Tensor  #: [2, K] int64, pieces a < b, ascending
    num_lines: Tensor  #: [K] int64, of all images
    may_continue: Tensor  #: [K] bool, whether both lie in one plane, and the space between is not seen to be free
    between: Tensor  #: [len(PLACES), K] int64, the piece on the way, -1 = none, or not in one plane


class _CoarseZBuffer(NamedTuple):
    """What one frame sees, in cells of some pixels."""

    cell: int  #: side of the cells, pixels
    point: Tensor  #: [h, w] int64, the nearest of the visible points in each cell, in their order; -1 = no point

    @classmethod
    def of(cls, visible: Visible) -> _CoarseZBuffer:
        """Of equally near points, the first is the nearest."""
        cell = _cell_size(visible)
        row, column = visible.row // cell, visible.column // cell
        height, width = int(row.max()) + 1, int(column.max()) + 1
        nearest = torch.full((height * width,), torch.iinfo(torch.int64).max)
        # Depths are positive, so their bits ascend with them.
        rank = (visible.z.view(torch.int32).long() << 32) + torch.arange(len(visible.z))
        nearest.scatter_reduce_(0, row * width + column, rank, "amin")
        point = torch.where(nearest == torch.iinfo(torch.int64).max, -1, nearest & 0xFFFFFFFF)
        return cls(cell, point.view(height, width))


def find_occlusions(
    piece: Tensor, statistics: RegionStatistics, points: Tensor, scales: Scales, observations: Sequence[Observation]
) -> Occlusions:
    """Counts the lines of all images.

    Args:
        piece: [N] int64, piece of each point, 0 ... P - 1.
        statistics: of the pieces.
        points: [N, 3] metres.
        scales: noise and spacing of the points.
        observations: the frames, with their lines.
    """
    num_pieces = len(statistics.size)
    ends = [
        torch.empty(2, 0, dtype=torch.int64),
        *(seen.lines for seen in observations),
    ]
    one, other = piece[torch.cat(ends, 1)]
    key, num_lines = torch.unique(_keys(one, other, num_pieces)[one != other], return_counts=True)
    a, b = key // max(num_pieces, 1), key % max(num_pieces, 1)
    may_continue = _in_one_plane(statistics, a, b)
    between = torch.full((len(PLACES), len(key)), -1)
    if may_continue.any():
        one, other = a[may_continue], b[may_continue]
        ways = torch.stack([torch.lerp(statistics.mean[one], statistics.mean[other], place) for place in PLACES])
        between[:, may_continue] = _nearest_pieces(ways, piece, points, scales)
        step = STEP_IN_NOISE * torch.maximum(statistics.noise[one], statistics.noise[other])
        may_continue[may_continue.clone()] = ~_is_seen_through(ways, step, observations).any(0)
    return Occlusions(torch.stack([a, b]), num_lines, may_continue, between)


def continued_surfaces(
    occlusions: Occlusions, statistics: RegionStatistics, touching: Tensor, of_piece: Tensor
) -> tuple[Tensor, Tensor]:
    """The pairs of regions that are one surface behind an occluder.

    Regions that touch are not among them: the model of boundaries has judged their boundary.

    Args:
        occlusions: of the pieces.
        statistics: of the pieces.
        touching: [2, T] int64, the pairs of pieces that touch.
        of_piece: [P] int64, region of each piece, 0 ... R - 1.

    Returns:
        [2, B] int64 regions a < b, ascending, and [B] float32 the share of the lines against, at most 1 - SHARE. No
        pairs without colours: they tell a surface from another one that happens to lie in its plane.
    """
    num_regions = int(of_piece.max()) + 1
    first, second = of_piece[occlusions.pairs]
    of_regions = _keys(first, second, num_regions)
    hidden = torch.where(occlusions.between >= 0, of_piece[occlusions.between], -1)
    is_free = ((hidden < 0) | (hidden == first) | (hidden == second)).all(0)
    one, other = of_piece[touching]
    apart = (first != second) & ~torch.isin(of_regions, _keys(one, other, num_regions))
    key, of_pair = torch.unique(of_regions[apart], return_inverse=True)
    lines = sum_by(of_pair, occlusions.num_lines[apart], len(key))
    votes = sum_by(of_pair, (occlusions.num_lines * (occlusions.may_continue & is_free))[apart], len(key))
    share = votes.double() / lines
    pairs = torch.stack([key // num_regions, key % num_regions])
    joined = (votes >= MIN_LINES) & (share >= SHARE)
    contrast = color_contrasts(pooled(statistics, of_piece, num_regions), *pairs)
    joined &= contrast <= MAX_CONTRAST  # NaN without colours: not joined
    return pairs[:, joined], (1 - share[joined]).float()


def _keys(a: Tensor, b: Tensor, count: int) -> Tensor:
    """One number for each unordered pair of pieces or regions 0 ... count - 1."""
    return torch.minimum(a, b) * count + torch.maximum(a, b)


def lines_across(visible: Visible, noise: Tensor) -> Tensor:
    """The points at the two ends of each line that crosses something nearer, along the rows and the columns.

    Args:
        visible: the visible points of an image.
        noise: [N] metres, of the points of the cloud.

    Returns:
        [2, V] int64 points.
    """
    if not len(visible.point):
        return torch.empty(2, 0, dtype=torch.int64)
    nearest = _CoarseZBuffer.of(visible).point
    of_noise = STEP_IN_NOISE * noise[visible.point]
    found = [_ends_of_gaps(grid, visible.z, of_noise) for grid in (nearest, nearest.T)]
    return visible.point[torch.cat(found, 1)]


def _cell_size(visible: Visible) -> int:
    """Pixels."""
    row, column = visible.row // SQUARE, visible.column // SQUARE
    width = int(column.max()) + 1
    is_seen = torch.zeros((int(row.max()) + 1) * width, dtype=torch.bool)
    is_seen[row * width + column] = True
    return max(1, math.ceil(CELL * math.sqrt(int(is_seen.sum()) * SQUARE * SQUARE / len(visible.point))))


def _ends_of_gaps(grid: Tensor, z: Tensor, of_noise: Tensor) -> Tensor:
    """Ends [2, V] of the gaps along the rows of a grid [h, w] of visible points (-1 = empty cells, are skipped)."""
    row, _ = torch.nonzero(grid >= 0, as_tuple=True)
    point = grid[grid >= 0]
    falls, rises = _steps(row, point, z, of_noise)
    # Cells of both surfaces, whose points are somewhere between them.
    mixed = (falls[:-1] & falls[1:]) | (rises[:-1] & rises[1:])
    kept = torch.nn.functional.pad(~mixed, (1, 1), value=True)[: len(row)]
    row, point = row[kept], point[kept]
    falls, rises = _steps(row, point, z, of_noise)
    fall, rise = _matched(row, falls, rises)
    first, last = fall + 1, rise  # of the occluder
    # Both ends and the occluder are at least two cells long.
    smooth = torch.nn.functional.pad((row[1:] == row[:-1]) & ~falls & ~rises, (0, 1))  # to the next cell
    long = (fall > 0) & smooth[fall - 1] & smooth[rise + 1] & (last > first)
    one, other, in_front = point[fall], point[rise + 1], torch.maximum(z[point[first]], z[point[last]])
    nearer = in_front < torch.minimum(z[one], z[other]) - torch.maximum(
        _step(z, of_noise, one), _step(z, of_noise, other)
    )
    return torch.stack([one, other])[:, long & nearer]


def _steps(row: Tensor, point: Tensor, z: Tensor, of_noise: Tensor) -> tuple[Tensor, Tensor]:
    """Whether the depth falls, and whether it rises by a step from each of n cells to the next one, both [n - 1]."""
    change = z[point[1:]] - z[point[:-1]]
    # The step counts from the farther of the two: the surface that the other one may hide.
    is_step = change.abs() > _step(z, of_noise, torch.where(change > 0, point[1:], point[:-1]))
    is_step &= row[1:] == row[:-1]
    return is_step & (change < 0), is_step & (change > 0)


def _step(z: Tensor, of_noise: Tensor, point: Tensor) -> Tensor:
    return torch.maximum(DEPTH_STEP * z[point], of_noise[point])


def _matched(row: Tensor, falls: Tensor, rises: Tensor) -> tuple[Tensor, Tensor]:
    """The last cells before falls and before rises that belong together, like parentheses: [V] int64 each."""
    event = torch.nonzero(falls | rises).squeeze(1)
    opens = falls[event]
    level = torch.where(opens, 1, -1).cumsum(0) - opens.long()
    order = torch.argsort(level, stable=True)
    order = order[torch.argsort(row[event][order], stable=True)]
    before, after = order[:-1], order[1:]
    together = (row[event[before]] == row[event[after]]) & (level[before] == level[after])
    closed = together & opens[before] & ~opens[after]
    return event[before[closed]], event[after[closed]]


def _in_one_plane(pieces: RegionStatistics, a: Tensor, b: Tensor) -> Tensor:
    """[K] bool, whether each of two pieces lies in the other piece's plane, and both normals have one direction."""
    normal = normalize(pieces.normal, dim=1)
    way = pieces.mean[b] - pieces.mean[a]
    off = OFF_PLANE * length(way) + OFF_IN_NOISE * torch.maximum(pieces.noise[a], pieces.noise[b])
    in_planes = (dot(normal[a], way).abs() <= off) & (dot(normal[b], way).abs() <= off)
    return in_planes & (dot(normal[a], normal[b]) >= SAME_DIRECTION)


def _nearest_pieces(ways: Tensor, piece: Tensor, points: Tensor, scales: Scales) -> Tensor:
    """The pieces [L, K] at places [L, K, 3] between pairs of pieces, -1 = none."""
    distance, nearest = cKDTree(points.double().numpy()).query(ways.numpy())
    found = torch.from_numpy(nearest)
    near = torch.maximum(NEAR * scales.spacing[found], NEAR_IN_NOISE * scales.noise[found])
    return torch.where(torch.from_numpy(distance) < near, piece[found], -1)


def _is_seen_through(ways: Tensor, step: Tensor, observations: Sequence[Observation]) -> Tensor:
    """Whether places between pairs of pieces are free: more frames see through a place than see something there.

    An occluder that hides a surface from one frame may not hide it from another one: if this frame sees what lies
    behind the place instead, there is no surface. Each frame's z-buffer is made a second time: to keep those of long
    recordings, unlike their lines, would take memory.

    Args:
        ways: [L, K, 3] float64 metres.
        step: [K] metres, smallest difference of the depths at a place of what lies there and what lies behind it.
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
    cell, nearest = _CoarseZBuffer.of(seen.visible)
    depth = torch.where(nearest >= 0, seen.visible.z[nearest], torch.inf)
    # The nearest of nine cells: whoever looks through a gap sees something far in all of them.
    depth = -torch.nn.functional.max_pool2d(-depth[None], 3, stride=1, padding=1)[0]
    height, width = (cell * side for side in depth.shape)
    at = project(places, seen.intrinsics, seen.world_to_camera, (height, width))
    in_cell = depth[nearest_pixel(at.v) // cell, nearest_pixel(at.u) // cell]
    enough = torch.maximum(DEPTH_STEP * in_cell, step[at.point])
    behind = in_cell - at.z
    vote[at.point] = (behind > enough).to(torch.int8) - (behind.abs() <= enough).to(torch.int8)
    vote[at.point[in_cell.isinf()]] = 0  # nothing is seen
    return vote
