"""What is known to be right about a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from torch import Tensor

from torchjoint.scene.subset import subset


@dataclass(frozen=True)
class Truth:
    """What is known to be right about a scene: only ever compared with results, never used to make them.

    Args:
        points: optional [N] integers, the instance of each point, -1 = not known (void).
        images: label images [H, W], -1 = void, one for each frame (may be lazy); empty where there are none. Their
            number is checked where they are used.
        kinds: of those instances whose scores are wanted by kind: instance -> kind, such as "flat".
    """

    points: Tensor | None = None
    images: Sequence[Tensor] = ()
    kinds: Mapping[int, str] = field(default_factory=dict)

    @property
    def has_points(self) -> bool:
        """Whether the instance of any point is known."""
        return self.points is not None and bool((self.points >= 0).any())

    def select_points(self, keep: Tensor) -> Truth:
        """That of some of the points, in the order of `keep` (a mask, or places)."""
        return self if self.points is None else replace(self, points=self.points[keep])

    def select_frames(self, indices: Sequence[int]) -> Truth:
        """That of some of the frames."""
        return replace(self, images=subset(self.images, indices)) if len(self.images) else self
