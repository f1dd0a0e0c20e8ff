"""The levels of a segmentation: a tree of merges, from small superpoints to connected parts of the cloud.

The votes of the members tell how sure a segment is.
"""

from __future__ import annotations

import numbers
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.runtime.groups import best_of_groups, check_dense, counted_pairs, numbers_by_first_place, with_none
from torchjoint.runtime.threads import one_thread_per_operation

#: Log odds that a segment is an object: an offset; a factor of the mean IoU with the members' segments; and a factor of
#: the logarithm of its number of points. ``lab/studies/confidence.py`` fits them, and tests them on kinds left out.
OFFSET, PER_IOU, PER_LOG_POINTS = -4.775, 2.504, 0.5272


class Confidence(NamedTuple):
    """The confidence in S segments, which consist of P superpoints."""

    of_segment: Tensor  #: [S] float64, the probability that the segment has an IoU of at least .5 with an object
    of_superpoint: Tensor  #: [P] float64, the probability of this, and that the superpoint is part of this object


class Agreement(NamedTuple):
    """How far the members agree with S segments, which consist of P superpoints."""

    iou: Tensor  #: [S] float64, mean over the members
    points: Tensor  #: [S] float64, number of distinct points
    share: Tensor  #: [P] float64, share of the members whose segment has the superpoint, too


class Votes(NamedTuple):
    """The segments of each of T members, who segmented the same P superpoints."""

    segments: Tensor  #: [T, P] int64, for each member the segment of each superpoint, 0, 1, ...
    size: Tensor  #: [P] int64, distinct points of each superpoint

    def renumbered(self, number: Tensor) -> Votes:
        """The same, where the superpoints have other numbers [P] int64."""
        segments, size = torch.empty_like(self.segments), torch.empty_like(self.size)
        segments[:, number], size[number] = self.segments, self.size
        return Votes(segments, size)

    def confidence(self, of_superpoint: Tensor) -> Confidence:
        """The confidence in any segments of the superpoints, [P] int64 with numbers 0 ... S - 1."""
        iou, points, share = self.agreement(of_superpoint)
        of_segment = torch.sigmoid(OFFSET + PER_IOU * iou + PER_LOG_POINTS * points.clamp(min=1).log())
        return Confidence(of_segment, of_segment[of_superpoint] * share)

    def agreement(self, of_superpoint: Tensor) -> Agreement:
        """How far the members agree with any segments of the superpoints, [P] int64 with numbers 0 ... S - 1.

        For each member, a segment is compared with that segment of the member which has the highest IoU with it.
        """
        count = int(of_superpoint.max()) + 1
        points = _sums(of_superpoint, self.size, count)
        iou, share = torch.zeros(count, dtype=torch.float64), torch.zeros(len(of_superpoint), dtype=torch.float64)
        for member in self.segments:
            partner, best = _best_partners(of_superpoint, member, self.size, points)
            iou += best / len(self.segments)
            share += (member == partner[of_superpoint]).double() / len(self.segments)
        return Agreement(iou, points, share)


def _best_partners(of_superpoint: Tensor, member: Tensor, size: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    """For each segment that one of the member's segments with the highest IoU, [S] int64, and the IoU, float64."""
    segment, other, common = counted_pairs(of_superpoint, member, size)
    theirs = _sums(member, size, int(member.max()) + 1)
    iou = common / (points[segment] + theirs[other] - common).clamp(min=1)
    return best_of_groups(segment, other, iou, len(points))


def _sums(group: Tensor, size: Tensor, count: int) -> Tensor:
    return torch.zeros(count, dtype=torch.float64).index_add_(0, group, size.double())  # whole numbers: exact


@dataclass(frozen=True)
class Hierarchy:
    """All levels of a segmentation of N points: P superpoints, and the M merges that join them step by step.

    A level consists of the segments after all merges up to some height. Levels are nested: every segment of a level
    lies inside one segment of each coarser level.

    Attributes:
        superpoint: [N] int64, superpoint of each point, 0 ... P - 1, numbered by first appearance; -1 = none, as of
            beams without return.
        merges: [M, 2] int64, M < P: two superpoints; a merge joins the two segments that contain them.
        heights: [M] float64 in [0, 1]: up to what probability of a boundary regions must merge, until most members have
            the two segments together; of a LiDAR scan, how large a gap joins them. It is at least the height of each
            merge inside them.
        default: height of the default level.
        votes: the segments of each member at the default level; None: there was no ensemble.

    Raises:
        TypeError, ValueError: naming the attribute, what was expected and what came.

    Example:
        >>> superpoint, merges = torch.tensor([0, 0, 1, 2]), torch.tensor([[0, 1], [0, 2]])
        >>> hierarchy = Hierarchy(superpoint, merges, torch.tensor([0.3, 0.7], dtype=torch.float64))
        >>> hierarchy.at(1.0), hierarchy.at(0.5), hierarchy.at(0.0)
        (tensor([0, 0, 1, 2]), tensor([0, 0, 0, 1]), tensor([0, 0, 0, 0]))
    """

    superpoint: Tensor
    merges: Tensor
    heights: Tensor
    default: float = 0.5
    votes: Votes | None = None

    def __post_init__(self) -> None:
        shapes = {"superpoint": (torch.int64, 1), "merges": (torch.int64, 2), "heights": (torch.float64, 1)}
        for name, (dtype, dimensions) in shapes.items():
            tensor = check_dense(getattr(self, name), name)
            if tensor.dtype != dtype or tensor.dim() != dimensions:
                got = f"{tensor.dtype} {list(tensor.shape)}"
                raise TypeError(f"{name}: expected a {dtype} tensor of {dimensions} dimensions, got {got}")
        known = self.superpoint[self.superpoint != -1]
        if not len(known) or int(known[0]) != 0 or int(known.min()) < 0:
            raise ValueError("superpoint: expected numbers >= 0, or -1 = none, of which the first is 0")
        if (known[1:] > known.cummax(0).values[:-1] + 1).any():
            raise ValueError("superpoint: expected numbers by first appearance, 0, 1, ... without gaps")
        if self.merges.shape != (len(self.heights), 2) or len(self.heights) >= self.num_superpoints:
            told = f"with M = {len(self.heights)} heights below {self.num_superpoints} superpoints"
            raise ValueError(f"merges: expected shape [M, 2] {told}, got {list(self.merges.shape)}")
        if self.merges.numel() and not 0 <= int(self.merges.min()) <= int(self.merges.max()) < self.num_superpoints:
            came = f"got {int(self.merges.min())} to {int(self.merges.max())}"
            raise ValueError(f"merges: expected superpoints in [0, {self.num_superpoints}), {came}")
        if not ((self.heights >= 0) & (self.heights <= 1)).all():
            raise ValueError("heights: expected numbers in [0, 1]")
        if int(self.segments_of_superpoints(1.0).max()) + 1 != self.num_superpoints - len(self.merges):
            raise ValueError("merges: expected each to join two segments, got one inside a segment")
        if not 0 <= self.default <= 1:
            raise ValueError(f"default: expected a height in [0, 1], got {self.default}")
        if self.votes is not None:
            self._check_votes(*self.votes)

    def _check_votes(self, segments: Tensor, size: Tensor) -> None:
        count = self.num_superpoints
        if segments.dtype != torch.int64 or segments.dim() != 2 or not len(segments) or segments.shape[1] != count:
            raise ValueError(f"votes: expected segments [T, {count}] int64, got {segments.dtype} {[*segments.shape]}")
        if not 0 <= int(segments.min()) <= int(segments.max()) < count:
            raise ValueError(f"votes: expected segments in [0, {count})")
        if size.dtype != torch.int64 or size.shape != (count,) or int(size.min()) < 1:
            raise ValueError(f"votes: expected sizes [{count}] int64 of at least 1 point")

    def __repr__(self) -> str:
        parts = f"{self.num_superpoints} superpoints, {len(self.merges)} merges"
        return f"Hierarchy({len(self.superpoint)} points, {parts})"

    @cached_property
    def num_superpoints(self) -> int:
        """P, the number of superpoints."""
        return int(self.superpoint.max()) + 1

    def height_of(self, granularity: float) -> float:
        """The height of a level. Granularity 0 (coarsest) has height 1, 0.5 has the default height, 1 (finest) has 0.

        Raises:
            TypeError: `granularity` is not a number.
            ValueError: it is outside [0, 1].
        """
        check_granularity(granularity)
        granularity = float(granularity)  # NumPy's float32 would round the height
        return 2 * self.default * (1 - granularity) if granularity >= 0.5 else 1 - 2 * (1 - self.default) * granularity

    @one_thread_per_operation()
    def segments_of_superpoints(self, height: float) -> Tensor:
        """The segment of each superpoint, [P] int64, after all merges up to a height."""
        return ops.connected_components(self.merges[self.heights <= height].t(), self.num_superpoints)

    @one_thread_per_operation()
    def cut(self, height: float) -> Tensor:
        """Labels [N] int64 after all merges up to a height, numbered by first appearance."""
        return with_none(self.segments_of_superpoints(height))[self.superpoint]

    def at(self, granularity: float = 0.5) -> Tensor:
        """Labels [N] int64 of a level, numbered by first appearance.

        Args:
            granularity: from 0 (coarse: each connected part is one segment) to 1 (fine: each superpoint is one). 0.5 is
                the default level.

        Raises:
            TypeError: `granularity` is not a number.
            ValueError: it is outside [0, 1].
        """
        return self.cut(self.height_of(granularity))

    def transferred(self, of_point: Tensor) -> tuple[Hierarchy, Tensor]:
        """The same hierarchy for K other points; each takes the superpoint of one of the N points.

        Args:
            of_point: [K] int64, for each new point, one of the N points; -1 = none. Every superpoint must occur.

        Returns:
            the hierarchy of the K points, with its superpoints numbered by first appearance among them; and [P] int64,
            the new number of each superpoint.

        Raises:
            ValueError: a superpoint does not occur.
        """
        superpoint = with_none(self.superpoint)[of_point]
        known = superpoint[superpoint >= 0]
        if (torch.bincount(known, minlength=self.num_superpoints) == 0).any():
            raise ValueError(f"of_point: expected points of all {self.num_superpoints} superpoints")
        number = numbers_by_first_place(known, self.num_superpoints)
        votes = None if self.votes is None else self.votes.renumbered(number)
        return replace(self, superpoint=with_none(number)[superpoint], merges=number[self.merges], votes=votes), number


def check_granularity(granularity: float, name: str = "granularity") -> None:
    """Raises TypeError if it is not a number, ValueError if it is outside [0, 1]; the message calls it `name`."""
    given: object = granularity
    if isinstance(given, bool) or not isinstance(given, numbers.Real):
        raise TypeError(f"{name}: expected a number from 0 (coarse) to 1 (fine), got {type(granularity).__name__}")
    if not 0 <= granularity <= 1:
        raise ValueError(f"{name}: expected a number from 0 (coarse) to 1 (fine), got {granularity}")
