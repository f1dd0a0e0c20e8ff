"""Label images of another level of a hierarchy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

import torch
from torch import Tensor

from torchjoint.runtime.threads import one_thread_per_operation


class LevelImages(Sequence[Tensor]):
    """Label images with the labels of another level: a sequence of [H, W] int64, computed at each access.

    Args:
        images: [H, W] int64 per frame, -1 = none. Segments with ids from `num_before` on have no points; they stay.
        num_before: number of 3D segments in `images`.
        table: [K] int64, the new label of each 3D segment, or of each piece.
        num_after: number of 3D segments after the change; the ids of segments without points follow.
        pieces: for a table of pieces: [H, W] int64 per frame, the piece of each pixel in a 3D segment, else -1.
    """

    def __init__(
        self,
        images: Sequence[Tensor],
        num_before: int,
        table: Tensor,
        num_after: int,
        pieces: Sequence[Tensor] | None = None,
    ) -> None:
        self._images = images
        self._num_before = num_before
        self._num_after = num_after
        self._table = torch.cat([table.new_full((1,), -1), table])  # -1 stays -1
        self._pieces = pieces

    def __len__(self) -> int:
        return len(self._images)

    @overload
    def __getitem__(self, index: int) -> Tensor: ...
    @overload
    def __getitem__(self, index: slice) -> list[Tensor]: ...
    def __getitem__(self, index: int | slice) -> Tensor | list[Tensor]:
        if isinstance(index, slice):
            return [self._level(i) for i in range(len(self))[index]]
        return self._level(range(len(self))[index])

    @one_thread_per_operation()
    def _level(self, index: int) -> Tensor:
        labels = self._images[index]
        private = labels >= self._num_before
        of_table = labels.masked_fill(private, -1) if self._pieces is None else self._pieces[index]
        if of_table.shape != labels.shape:
            raise ValueError(f"pieces of image {index}: expected {list(labels.shape)}, got {list(of_table.shape)}")
        found = self._table.index_select(0, of_table.reshape(-1) + 1).view(labels.shape)
        return torch.where(private, labels + (self._num_after - self._num_before), found)
