"""What a segmenter has seen so far: sums over frames, and of each frame what steps 7 and 8 will need.

States of the same cloud can be added: that is all it takes to spread frames over processes or machines.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from torchjoint.views.observation import Observation


@dataclass
class JointState:
    """Sums over the frames seen so far, exact in any order of the frames.

    Attributes:
        views: [E] int64, v of eq. 6: images that see both ends of an edge.
        overlap_sum: [E] float64, sum of overlaps of eq. 5.
        facing: [N] int64: images whose camera is on the side the point's normal shows to, less the others.
        observations: one a frame, in the order in which they came.
    """

    views: Tensor
    overlap_sum: Tensor
    facing: Tensor
    observations: list[Observation] = field(default_factory=list)

    @classmethod
    def empty(cls, num_edges: int, num_points: int) -> JointState:
        """The state before any frame."""
        return cls(
            torch.zeros(num_edges, dtype=torch.int64),
            torch.zeros(num_edges, dtype=torch.float64),
            torch.zeros(num_points, dtype=torch.int64),
        )

    def __add__(self, other: JointState) -> JointState:
        """The state of a segmenter that saw the frames of both."""
        if self.views.shape != other.views.shape or self.facing.shape != other.facing.shape:
            raise ValueError(
                f"other: expected a state of the same cloud ({self.facing.shape[0]} points, {self.views.shape[0]} "
                f"edges), got {other.facing.shape[0]} points, {other.views.shape[0]} edges"
            )
        return JointState(
            self.views + other.views,
            self.overlap_sum + other.overlap_sum,
            self.facing + other.facing,
            self.observations + other.observations,
        )
