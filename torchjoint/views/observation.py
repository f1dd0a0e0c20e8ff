"""What steps 6-8 need of one frame: its initial segments and the points that it sees (results of steps 1, 2 and 4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from torchjoint.scene import Masks
from torchjoint.views.visibility import Visible


@dataclass(frozen=True)
class Observation:
    """What is stored of one frame. Images have 8 bits per channel: enough for step 7, and small for long sequences."""

    name: str
    labels: Tensor  #: [H, W] int32, the initial segmentation, labels 0, 1, ... without gaps, -1 = none; or masks' atoms
    visible: Visible
    image: Tensor  #: [3, H, W] uint8
    boundary: Tensor  #: [H, W] uint8, boundary strength x 255
    masks: Masks | None = None

    def labelled_points(self) -> tuple[Tensor, Tensor]:
        """The visible points in pixels with a label, and these labels, both [L] int64."""
        label = self.labels[self.visible.row, self.visible.column].long()
        has_label = label >= 0
        return self.visible.point[has_label], label[has_label]

    def initial_labels(self) -> Tensor:
        """The initial segmentation as it is shown, [H, W] integers, -1 = none; of masks that overlap the smallest."""
        return self.labels if self.masks is None else self.masks.labels()

    def to_dict(self) -> dict[str, Any]:
        """A dict of tensors and strings, for torch.save and loading with ``weights_only=True``."""
        masks = None if self.masks is None else vars(self.masks)
        return vars(self) | {"visible": tuple(self.visible), "masks": masks}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Observation:
        """The inverse of :meth:`to_dict`."""
        masks = None if values["masks"] is None else Masks(**values["masks"])
        return cls(**values | {"visible": Visible(*values["visible"]), "masks": masks})
