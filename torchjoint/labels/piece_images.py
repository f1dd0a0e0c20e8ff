"""Steps 7 and 8 for the levels of a hierarchy: the piece in each pixel. It gives the labels of every level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import Config
from torchjoint.labels.geodesic import PieceNumbers, path_costs, piece_markers
from torchjoint.labels.joint_ids import look_up
from torchjoint.runtime.groups import first_places
from torchjoint.runtime.store import Packed, pack
from torchjoint.runtime.threads import LazySequence, one_thread_per_operation
from torchjoint.scene import Hierarchy
from torchjoint.views.observations import Observation, Observations


def piece_images(
    images: Sequence[Tensor],
    observations: Observations,
    hierarchy: Hierarchy,
    config: Config,
    known: Mapping[int, Packed],
) -> LazySequence[Tensor]:
    """The pieces of a hierarchy in images: [H, W] int64 per frame, computed when first used, then kept packed.

    Args:
        images: final labels [H, W] int64 per frame, of the default level.
        observations: the frames; no more may be added.
        hierarchy: all levels of the graph's points.
        config: the refinement, and the smoothing of the image graph.
        known: pieces of images that are known already, by index.
    """
    kept = dict(known)
    numbers = PieceNumbers.of(hierarchy.piece, hierarchy.segments_of_pieces(hierarchy.default))

    def pieces(index: int) -> Tensor:
        if index not in kept:
            with torch.no_grad(), one_thread_per_operation():
                kept[index] = pack(piece_image(observations[index], images[index], numbers, config))
        return kept[index].unpack()

    return LazySequence(len(images), pieces)


def piece_image(seen: Observation, labels: Tensor, numbers: PieceNumbers, config: Config) -> Tensor:
    """The piece in each pixel of a frame with masks. It is always a piece of the pixel's segment.

    Frames without masks get their pieces with their labels (:func:`~torchjoint.labels.geodesic.propagate_pieces`).

    It is the piece of the point with the cheapest path to the pixel, as in geodesic label propagation. So pieces also
    meet at edges of the image. If this point is not in the segment of the pixel's final label, the nearest visible
    point of that segment counts.

    Args:
        seen: the frame.
        labels: [H, W] int64, final labels; -1 = none, labels from S on have no points.
        numbers: the pieces, and the 3D segment 0 ... S - 1 of each.
        config: the refinement, and the smoothing of the image graph.

    Returns:
        [H, W] int64, -1 for pixels without a 3D segment.
    """
    costs = path_costs(seen, config)
    found = ops.propagate_labels(piece_markers(seen, numbers, costs), *costs)
    has_segment = (labels >= 0) & (labels <= numbers.segment[-1])
    row, column = torch.nonzero(has_segment & (look_up(numbers.segment, found, -1) != labels), as_tuple=True)
    found[row, column] = _nearest_of_segment(seen, numbers, row, column, labels[row, column])
    return torch.where(has_segment, look_up(numbers.piece, found, -1), -1)


def _nearest_of_segment(
    seen: Observation, numbers: PieceNumbers, row: Tensor, column: Tensor, segment: Tensor
) -> Tensor:
    """The number of the piece of the nearest visible point of a given segment, [K] int32, for K pixels.

    A segment without a visible point gets its first piece.
    """
    first = first_places(numbers.segment.long()).to(torch.int32)[segment]
    there = numbers.of_point[seen.visible.point]
    if not len(row) or not len(there):
        return first
    from scipy.spatial import cKDTree

    # The segment is a third coordinate, with steps larger than any distance in the image. So the nearest point is in
    # the same segment, if that has one.
    layer = 2 * sum(seen.size)
    points = torch.stack([seen.visible.row, seen.visible.column, numbers.segment[there].long() * layer], dim=1)
    pixels = torch.stack([row, column, segment * layer], dim=1)
    distance, nearest = cKDTree(points.double().numpy()).query(pixels.double().numpy())
    return torch.where(torch.from_numpy(distance) < layer, there[torch.from_numpy(nearest)].to(torch.int32), first)
