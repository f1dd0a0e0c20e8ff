"""Steps 7 and 8 for the levels of a hierarchy: the piece in each pixel. It gives the labels of every level."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.config import Config
from torchjoint.labels.geodesic import nearest_labels, path_costs, without_outvoted
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
    kept, of_piece = dict(known), hierarchy.segments_of_pieces(hierarchy.default)

    def pieces(index: int) -> Tensor:
        if index not in kept:
            with torch.no_grad(), one_thread_per_operation():
                kept[index] = pack(piece_image(observations[index], images[index], hierarchy.piece, of_piece, config))
        return kept[index].unpack()

    return LazySequence(len(images), pieces)


def piece_image(seen: Observation, labels: Tensor, piece: Tensor, of_piece: Tensor, config: Config) -> Tensor:
    """The piece in each pixel of a frame with masks. It is always a piece of the pixel's segment.

    Frames without masks get their pieces with their labels (:func:`~torchjoint.labels.geodesic.propagate_pieces`).

    It is the piece of the point with the cheapest path to the pixel, as in geodesic label propagation. So pieces also
    meet at edges of the image. If this point is not in the segment of the pixel's final label, the nearest visible
    point of that segment counts.

    Args:
        seen: the frame.
        labels: [H, W] int64, final labels; -1 = none, labels from S on have no points.
        piece: [N] int64, piece of each point.
        of_piece: [P] int64, 3D segment 0 ... S - 1 of each piece.
        config: the refinement, and the smoothing of the image graph.

    Returns:
        [H, W] int64, -1 for pixels without a 3D segment.
    """
    height, width = labels.shape
    pieces_there = piece[seen.visible.point]
    # Of equally cheap paths the lowest number counts. So number the pieces in the order of their segments: then the
    # lowest segment counts, as for the labels.
    by_segment = torch.argsort(of_piece, stable=True)
    place = torch.empty_like(by_segment)
    place[by_segment] = torch.arange(len(by_segment))
    colors, boundary, color_weight, boundary_weight = path_costs(seen, config)
    markers = nearest_labels(seen.visible, place[pieces_there], (height, width))
    of_segments = nearest_labels(seen.visible, of_piece[pieces_there], (height, width))
    markers[without_outvoted(of_segments, colors, color_weight) < 0] = -1
    places = ops.propagate_labels(markers, colors, boundary, color_weight, boundary_weight).to(torch.int64)
    pieces = by_segment[places.clamp(min=0)]
    num_segments = int(of_piece.max()) + 1
    has_segment = (labels >= 0) & (labels < num_segments)
    wrong = has_segment & ((places < 0) | (of_piece[pieces] != labels))
    row, column = torch.nonzero(wrong, as_tuple=True)
    pieces[row, column] = _nearest_of_segment(seen, pieces_there, of_piece, row, column, labels[row, column])
    return pieces.masked_fill_(~has_segment, -1)


def _nearest_of_segment(
    seen: Observation, pieces_there: Tensor, of_piece: Tensor, row: Tensor, column: Tensor, segment: Tensor
) -> Tensor:
    """The piece of the nearest visible point of a given segment, [K], for K pixels.

    A segment without a visible point gets its first piece. `pieces_there`: [M], of the visible points.
    """
    first_piece = first_places(of_piece)
    if not len(row) or not len(pieces_there):
        return first_piece[segment]
    from scipy.spatial import cKDTree

    # The segment is a third coordinate, with steps larger than any distance in the image. So the nearest point is in
    # the same segment, if that has one.
    layer = 2 * (seen.labels.shape[0] + seen.labels.shape[1])
    points = torch.stack([seen.visible.row, seen.visible.column, of_piece[pieces_there] * layer], dim=1)
    pixels = torch.stack([row, column, segment * layer], dim=1)
    distance, nearest = cKDTree(points.double().numpy()).query(pixels.double().numpy())
    found = pieces_there[torch.from_numpy(nearest)]
    return torch.where(torch.from_numpy(distance) < layer, found, first_piece[segment])
