"""Step 6, method regions: occlusion bridging, joins segments of one surface that an occluder separates in the images.

Follow a row or a column of an image. If a nearer segment lies between two segments, and both lie in one plane, then
this line votes for joining the two segments.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.normals import dot, length, rows_of
from torchjoint.runtime.groups import best_of_groups, starts_group
from torchjoint.runtime.threads import parallel_map
from torchjoint.segments.planes import Planes
from torchjoint.views.observations import Observation
from torchjoint.views.visibility import Visible
from torchjoint_lab.regions.config import OcclusionBridgingConfig

#: Cosine of the largest angle between the normals on the two sides, 26 degrees.
SAME_DIRECTION = 0.9
#: Smallest length of a run that counts, in grid cells.
MIN_RUN = 2
#: Smallest share of the lines across an occluder on which the plane continues: the majority decides.
AGREEING_SHARE = 0.5
#: Side of the grid cells along which lines run, pixels: about the distance between neighbouring points in the image.
#: Smaller cells stay empty, larger ones miss thin occluders.
CELL = 4
#: Smallest difference in depth between an occluder and the surface behind it, metres: above a depth camera's noise.
DEPTH_STEP = 0.03
#: Largest distance of each side from the other side's plane, metres, to which a twentieth of the gap is added: a plane
#: of few points is off by so much.
FLATNESS = 0.015
#: Widest gap that is bridged, metres: the size of furniture. Across wider gaps, planes coincide by accident.
MAX_GAP = 1.0


class Runs(NamedTuple):
    """Runs: consecutive cells of one segment along the rows of an image's grid."""

    row: Tensor  #: [R] int64
    segment: Tensor  #: [R] int64
    first: Tensor  #: [R] int64, the visible point at the run's beginning
    last: Tensor  #: [R] int64, the visible point at the run's end
    length: Tensor  #: [R] int64, cells


def bridge(
    point_labels: Tensor, planes: Planes, observations: Sequence[Observation], config: OcclusionBridgingConfig
) -> Tensor:
    """Joins two segments if enough image lines show one plane on both sides of an occluder.

    Args:
        point_labels: [N] int64, 0 ... S - 1.
        planes: the one-sided plane of each point.
        observations: the frames.
        config: the smallest number of lines.

    Returns:
        [N] int64 segments 0, 1, ..., numbered by the lowest of the segments that were joined.
    """
    if config.min_votes is None or not observations:
        return point_labels
    num_segments = int(point_labels.max()) + 1
    votes = parallel_map(lambda seen: _votes(point_labels, planes, seen.visible, num_segments), observations)
    pairs, of_pair = torch.unique(torch.cat([pair for pair, _ in votes]), return_inverse=True)
    goes_on = torch.cat([votes_for for _, votes_for in votes])
    num_lines = torch.bincount(of_pair, minlength=len(pairs))
    num_votes = torch.bincount(of_pair[goes_on], minlength=len(pairs))
    joined = pairs[(num_votes >= config.min_votes) & (num_votes >= AGREEING_SHARE * num_lines.double())]
    ends = torch.stack([joined // num_segments, joined % num_segments])
    return ops.connected_components(ends, num_segments)[point_labels]


def _votes(point_labels: Tensor, planes: Planes, visible: Visible, num_segments: int) -> tuple[Tensor, Tensor]:
    """For each line across an occluder: its two segments as low x S + high, [V] int64, and its vote, [V] bool."""
    pairs, goes_on = [], []
    for across, along in ((visible.row, visible.column), (visible.column, visible.row)):
        run = _runs(across // CELL, along // CELL, visible.z, point_labels[visible.point])
        left, front, right = (slice(None, -2), slice(1, -1), slice(2, None))
        z_first, z_last = visible.z[run.first], visible.z[run.last]
        long_enough = run.length >= MIN_RUN
        found = (
            (run.row[left] == run.row[right])
            & (run.segment[left] != run.segment[right])
            & (z_first[front] < z_last[left] - DEPTH_STEP)
            & (z_last[front] < z_first[right] - DEPTH_STEP)
            & (long_enough[left] & long_enough[front] & long_enough[right])
        )
        low = torch.minimum(run.segment[left], run.segment[right])[found]
        high = torch.maximum(run.segment[left], run.segment[right])[found]
        pairs.append(low * num_segments + high)
        ends = visible.point[run.last[left][found]], visible.point[run.first[right][found]]
        goes_on.append(_is_one_plane(planes, *ends))
    return torch.cat(pairs), torch.cat(goes_on)


def _runs(row: Tensor, column: Tensor, z: Tensor, segment: Tensor) -> Runs:
    """Runs along the rows of a grid of square cells; the nearest point of a cell counts, empty cells are skipped."""
    square = row * (int(column.max()) + 1 if column.numel() else 1) + column
    filled, of_point = torch.unique(square, return_inverse=True)
    nearest, _ = best_of_groups(of_point, torch.arange(len(z)), -z, len(filled))
    row, segment = row[nearest], segment[nearest]
    start = torch.nonzero(starts_group(row) | starts_group(segment)).squeeze(1)
    end = torch.cat([start[1:], torch.tensor([len(nearest)])])[: len(start)]
    return Runs(row[start], segment[start], nearest[start], nearest[end - 1], end - start)


def _is_one_plane(planes: Planes, first: Tensor, second: Tensor) -> Tensor:
    """[V] bool: whether each of two points lies in the other point's plane, and both normals have one direction."""
    step = rows_of(planes.mean, second) - rows_of(planes.mean, first)
    distance = length(step)
    off = FLATNESS + distance / 20
    one, other = rows_of(planes.normal, first), rows_of(planes.normal, second)
    in_plane = (dot(one, step).abs() <= off) & (dot(other, step).abs() <= off)
    return in_plane & (dot(one, other) >= SAME_DIRECTION) & (distance <= MAX_GAP)
