"""What one frame contributes: its initial segments and the points that it sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from torchjoint.views.visibility import Visible


@dataclass(frozen=True)
class Observation:
    """One frame as it was seen; 8 bits a channel are enough for step 7 and keep long sequences small."""

    name: str
    labels: Tensor  #: [H, W] int32, the initial segmentation, dense, -1 = none
    visible: Visible
    image: Tensor  #: [3, H, W] uint8
    boundary: Tensor  #: [H, W] uint8, boundary strength x 255

    def labelled_points(self) -> tuple[Tensor, Tensor]:
        """The visible points whose pixel has a label, and that label, both [L] int64."""
        label = self.labels[self.visible.row, self.visible.column].long()
        has_label = label >= 0
        return self.visible.point[has_label], label[has_label]

    def to_dict(self) -> dict[str, Any]:
        """Plain tensors and strings, for torch.save and safe loading."""
        return vars(self) | {"visible": tuple(self.visible)}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Observation:
        """The inverse of :meth:`to_dict`."""
        return cls(**values | {"visible": Visible(*values["visible"])})
