"""The ground truth of a scene. No step of the method uses it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from torch import Tensor

from torchjoint.scene.subset import subset


@dataclass(frozen=True)
class Truth:
    """The ground truth of a scene. It is only compared with results.

    Args:
        points: optional [N] integers, the instance of each point, -1 = unknown (void).
        images: label images [H, W], -1 = void, one per frame (may be lazy); empty if there are none. Their number is
            checked where they are used.
        kinds: instance -> kind, such as "flat", for instances that are also scored per kind.
    """

    points: Tensor | None = None
    images: Sequence[Tensor] = ()
    kinds: Mapping[int, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        points = "none" if self.points is None else f"{len(self.points)}"
        return f"Truth({points} points, {len(self.images)} images)"

    @property
    def has_points(self) -> bool:
        """Whether the instance of any point is known."""
        return self.points is not None and bool((self.points >= 0).any())

    def select_points(self, keep: Tensor) -> Truth:
        """The truth of some of the points, in the order of `keep` ([N] bool, or [M] int64 indices)."""
        return self if self.points is None else replace(self, points=self.points[keep])

    def select_frames(self, indices: Sequence[int]) -> Truth:
        """The truth of some of the frames, in the order of `indices`."""
        return replace(self, images=subset(self.images, indices)) if len(self.images) else self
