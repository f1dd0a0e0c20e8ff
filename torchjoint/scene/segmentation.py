"""The result of step 8: labels of points and pixels in one id space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import overload

import torch
from torch import Tensor


class LabelImages(Sequence[Tensor]):
    """Label images of one segmentation: a sequence of [H, W] int64 tensors, stored as int32 and converted at access."""

    def __init__(self, images: Sequence[Tensor]) -> None:
        self._images = [image.to(torch.int32) for image in images]

    def __len__(self) -> int:
        return len(self._images)

    @overload
    def __getitem__(self, index: int) -> Tensor: ...
    @overload
    def __getitem__(self, index: slice) -> LabelImages: ...
    def __getitem__(self, index: int | slice) -> Tensor | LabelImages:
        if isinstance(index, slice):
            return LabelImages(self._images[index])
        return self._images[index].to(torch.int64)


@dataclass(frozen=True)
class Segmentation:
    """Labels of points and pixels in one id space: the same id means the same object everywhere.

    Attributes:
        points: [N] int64. Ids 0 ... num_point_segments - 1, numbered by first appearance in the cloud.
        images: a sequence of [H, W] int64, one per frame; -1 = none. An id >= num_point_segments is an image segment
            without visible points; such an id occurs in one image only.
        initial_images: the initial image segmentations, [H, W] int64 (each frame has its own ids).
        names: the frames' names, in order.
        seconds: wall-clock seconds per stage.
    """

    points: Tensor
    images: Sequence[Tensor]
    initial_images: Sequence[Tensor] = ()
    names: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def num_point_segments(self) -> int:
        """Number of segments of the cloud."""
        return int(self.points.max()) + 1 if self.points.numel() else 0
