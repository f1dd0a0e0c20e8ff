"""Label images of another level of a hierarchy."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchjoint.runtime.lazy import LazySequence
from torchjoint.runtime.threads import one_thread_per_operation


def level_images(
    images: Sequence[Tensor],
    num_before: int,
    table: Tensor,
    num_after: int,
    pieces: Sequence[Tensor] | None = None,
) -> LazySequence[Tensor]:
    """Label images with the labels of another level, or with other numbers: [H, W] int64, computed at each access.

    Args:
        images: [H, W] int64 per frame, -1 = none. Segments with ids from `num_before` on have no points; they stay.
        num_before: number of 3D segments in `images`.
        table: [K] int64, the new label of each 3D segment, or of each piece.
        num_after: number of 3D segments after the change; the ids of segments without points follow.
        pieces: for a table of pieces: [H, W] int64 per frame, the piece of each pixel in a 3D segment, else -1.
    """
    known = torch.cat([table.new_full((1,), -1), table])  # -1 stays -1

    @one_thread_per_operation()
    def level(index: int) -> Tensor:
        labels = images[index]
        private = labels >= num_before
        of_table = labels.masked_fill(private, -1) if pieces is None else pieces[index]
        if of_table.shape != labels.shape:
            raise ValueError(f"pieces of image {index}: expected {list(labels.shape)}, got {list(of_table.shape)}")
        found = known.index_select(0, of_table.reshape(-1) + 1).view(labels.shape)
        return torch.where(private, labels + (num_after - num_before), found)

    return LazySequence(len(images), level)
