"""The result: labels of points and pixels that share one id space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import overload

import torch
from torch import Tensor


class LabelImages(Sequence[Tensor]):
    """Label images of one segmentation: a sequence of [H, W] int64 tensors, kept as int32 until they are asked for."""

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
    """Labels of points and pixels that share one id space: the same id is the same object everywhere.

    Attributes:
        points: [N] int64. Ids 0 ... num_point_segments - 1, numbered by first appearance in the cloud.
        images: a sequence of [H, W] int64, one a frame. Ids >= num_point_segments are image segments that no
            visible point fell in; such an id occurs in one image only.
        initial_images: the image segmentations the method started from (each frame has ids of its own).
        names: the frames' names, in order.
        seconds: wall-clock seconds by stage.
    """

    points: Tensor
    images: Sequence[Tensor]
    initial_images: Sequence[Tensor] = ()
    names: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def num_point_segments(self) -> int:
        """How many segments the cloud has."""
        return int(self.points.max()) + 1 if self.points.numel() else 0
