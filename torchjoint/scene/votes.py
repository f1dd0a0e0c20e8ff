"""How far the judges of a segmentation agree: from it follows how sure a segment is."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

#: Log odds that a segment is an object: an offset; a factor of the mean IoU with the judges' segments; and a factor of
#: the logarithm of its number of points. ``lab/studies/confidence.py`` fits them, and tests them on kinds left out.
OFFSET, PER_IOU, PER_LOG_POINTS = -6.438, 4.129, 0.5573


class Confidence(NamedTuple):
    """The confidence in S segments, which consist of P pieces."""

    of_segment: Tensor  #: [S] float64, the probability that the segment has an IoU of at least .5 with an object
    of_piece: Tensor  #: [P] float64, the probability of this, and that the piece is part of this object


class Agreement(NamedTuple):
    """How far the judges agree with S segments, which consist of P pieces."""

    iou: Tensor  #: [S] float64, mean over the judges
    points: Tensor  #: [S] float64, number of distinct points
    share: Tensor  #: [P] float64, share of the judges whose segment has the piece, too


class Votes(NamedTuple):
    """The segments of each of T judges, who segmented the same P pieces."""

    segments: Tensor  #: [T, P] int64, for each judge the segment of each piece, 0, 1, ...
    size: Tensor  #: [P] int64, distinct points of each piece

    def renumbered(self, number: Tensor) -> Votes:
        """The same, where the pieces have other numbers [P] int64."""
        segments, size = torch.empty_like(self.segments), torch.empty_like(self.size)
        segments[:, number], size[number] = self.segments, self.size
        return Votes(segments, size)

    def confidence(self, of_piece: Tensor) -> Confidence:
        """The confidence in any segments of the pieces, [P] int64 with numbers 0 ... S - 1."""
        iou, points, share = self.agreement(of_piece)
        of_segment = torch.sigmoid(OFFSET + PER_IOU * iou + PER_LOG_POINTS * points.clamp(min=1).log())
        return Confidence(of_segment, of_segment[of_piece] * share)

    def agreement(self, of_piece: Tensor) -> Agreement:
        """How far the judges agree with any segments of the pieces, [P] int64 with numbers 0 ... S - 1.

        For each judge, a segment is compared with that segment of the judge which has the highest IoU with it.
        """
        count = int(of_piece.max()) + 1
        points = _sums(of_piece, self.size, count)
        iou, share = torch.zeros(count, dtype=torch.float64), torch.zeros(len(of_piece), dtype=torch.float64)
        for judge in self.segments:
            best, partner = _best_partners(of_piece, judge, self.size, points)
            iou += best / len(self.segments)
            share += (judge == partner[of_piece]).double() / len(self.segments)
        return Agreement(iou, points, share)


def _best_partners(of_piece: Tensor, judge: Tensor, size: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """For each segment the highest IoU with one of the judge's segments, [S] float64, and the number of that one."""
    num_judged = int(judge.max()) + 1
    pair, of_pair = torch.unique(of_piece * num_judged + judge, return_inverse=True)
    common = _sums(of_pair, size, len(pair))
    segment, other = pair // num_judged, pair % num_judged
    iou = common / (points[segment] + _sums(judge, size, num_judged)[other] - common).clamp(min=1)
    best = torch.zeros_like(points).scatter_reduce_(0, segment, iou, "amax")
    wins = iou == best[segment]  # of equally good ones the lowest
    none = torch.full((len(points),), num_judged)
    return best, none.scatter_reduce_(0, segment[wins], other[wins], "amin")


def _sums(group: Tensor, size: Tensor, count: int) -> Tensor:
    return torch.zeros(count, dtype=torch.float64).index_add_(0, group, size.double())  # whole numbers: exact
