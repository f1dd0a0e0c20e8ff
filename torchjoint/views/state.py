"""The evidence that a segmenter has collected in steps 1-5: sums over frames, and an observation per frame.

States of the same cloud can be added. So frames can be distributed over processes or machines.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchjoint.views.observations import Observations


@dataclass
class JointState:
    """Sums over the frames seen so far; the sums are exact, in any order of the frames.

    Attributes:
        views: [E] int64, v of eq. 6: number of images that see both ends of an edge.
        overlap_sum: [E] float64, sum of the overlaps of eq. 5.
        facing: [N] int64: number of cameras on the side to which the point's normal points, minus the number of
            cameras on the other side.
        contour_sum: [E] int32, sum of the boundary strengths x 255 between the two ends of an edge, over frames without
            masks (method learned only).
        contour_views: [E] int32, number of frames in this sum: those without masks that see both ends.
        observations: one per frame, in the order in which the frames were added.
    """

    views: Tensor
    overlap_sum: Tensor
    facing: Tensor
    contour_sum: Tensor
    contour_views: Tensor
    observations: Observations = field(default_factory=Observations)

    @classmethod
    def empty(cls, num_edges: int, num_points: int, observations: Observations | None = None) -> JointState:
        """The state before the first frame, for E = `num_edges` and N = `num_points`; default: no limit of memory."""
        return cls(
            torch.zeros(num_edges, dtype=torch.int64),
            torch.zeros(num_edges, dtype=torch.float64),
            torch.zeros(num_points, dtype=torch.int64),
            torch.zeros(num_edges, dtype=torch.int32),
            torch.zeros(num_edges, dtype=torch.int32),
            Observations() if observations is None else observations,
        )

    def check_types(self) -> None:
        """Checks a state that was read from a file.

        Raises:
            TypeError, ValueError: a tensor has another type or shape than the state of any cloud.
        """
        edges, points = (len(one) if isinstance(one, Tensor) and one.ndim else 0 for one in (self.views, self.facing))
        for name, expected in vars(JointState.empty(edges, points)).items():
            got = getattr(self, name)
            if isinstance(expected, Tensor) and (got.dtype, got.shape) != (expected.dtype, expected.shape):
                raise ValueError(
                    f"{name}: expected {list(expected.shape)} {expected.dtype}, got {got.shape} {got.dtype}"
                )
        for index in range(len(self.observations)):
            self.observations[index].check(points)

    def check_cloud(self, other: JointState, name: str) -> None:
        """Checks that another state has the same numbers of points and edges; the message calls it `name`.

        Raises:
            ValueError: the states belong to different clouds.
        """
        own, came = ((one.facing.shape[0], one.views.shape[0]) for one in (self, other))
        if own != came:
            expected = f"expected a state of the same cloud ({own[0]} points, {own[1]} edges)"
            raise ValueError(f"{name}: {expected}, got {came[0]} points, {came[1]} edges")

    def __add__(self, other: JointState) -> JointState:
        """The state of a segmenter that saw the frames of both states; errors as of :meth:`check_cloud`."""
        self.check_cloud(other, "other")
        return JointState(
            self.views + other.views,
            self.overlap_sum + other.overlap_sum,
            self.facing + other.facing,
            self.contour_sum + other.contour_sum,
            self.contour_views + other.contour_views,
            self.observations + other.observations,
        )
