"""Step 6, method learned: counts the visible points of each piece in each image segment.

All sums over frames are of whole numbers. So the order of the frames does not change a single bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.threads import parallel_map
from torchjoint.segments.learned.summaries import sum_by
from torchjoint.views.observation import Observation


class ImageCounts(NamedTuple):
    """How many points of each piece lie in each segment of each image: I pairs (piece, image segment) with points.

    All L segments of all images are numbered together, 0 ... L - 1, image by image.
    """

    piece: Tensor  #: [I] int32
    segment: Tensor  #: [I] int32
    num_points: Tensor  #: [I] int32, visible points of the piece in the segment
    segment_size: Tensor  #: [L] int64, visible points in the segment
    frame_of_segment: Tensor  #: [L] int64, ascending

    def grouped(self, of_piece: Tensor) -> ImageCounts:
        """The counts of groups of pieces; `of_piece` [P] int64 is the group of each piece."""
        num_groups = int(of_piece.max()) + 1
        of_row = of_piece.index_select(0, self.piece)
        key, row = torch.unique(self.segment.long() * num_groups + of_row, return_inverse=True)
        num_points = sum_by(row, self.num_points, len(key))
        return self._replace(piece=(key % num_groups).int(), segment=(key // num_groups).int(), num_points=num_points)

    @classmethod
    def union(cls, counts: Sequence[ImageCounts], starts: Sequence[int]) -> ImageCounts:
        """Counts of the same images as one; the pieces of number k are numbered from `starts[k]` on."""
        return counts[0]._replace(
            piece=torch.cat([one.piece + start for one, start in zip(counts, starts, strict=True)]),
            segment=torch.cat([one.segment for one in counts]),
            num_points=torch.cat([one.num_points for one in counts]),
        )


def segments_of_pieces(piece: Tensor, observations: Sequence[Observation]) -> ImageCounts:
    """Counts the visible points of each piece in each image segment.

    Args:
        piece: [N] int64, piece of each point, 0 ... P - 1.
        observations: the frames, at least one.
    """

    def count_points(seen: Observation) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        point, label = seen.labelled_points()
        num_labels = int(label.max()) + 1 if label.numel() else 0
        pair, count = torch.unique(piece[point] * num_labels + label, return_counts=True)
        of_pair = (pair // max(num_labels, 1), pair % max(num_labels, 1), count)
        return *(values.int() for values in of_pair), torch.bincount(label, minlength=num_labels)

    pieces, labels, counts, sizes = zip(*parallel_map(count_points, observations), strict=True)
    num_labels = torch.tensor([len(size) for size in sizes])
    first = num_labels.cumsum(0) - num_labels
    return ImageCounts(
        torch.cat(pieces),
        torch.cat([label + start for label, start in zip(labels, first.tolist(), strict=True)]),
        torch.cat(counts),
        torch.cat(sizes),
        torch.repeat_interleave(torch.arange(len(sizes)), num_labels),
    )
