"""Selects items of a sequence, such as frames, without reading them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar, cast

import torch
from torch.utils.data import Dataset, Subset

T = TypeVar("T")


def subset(items: Sequence[T], indices: Sequence[int]) -> Sequence[T]:
    """The items at `indices`, in this order; lazy items stay lazy."""
    return cast(Sequence[T], Subset(cast(Dataset[T], items), indices))


def evenly_spaced_indices(count: int, most: int) -> list[int]:
    """At most `most` of the numbers 0 ... count - 1, evenly spread from the first to the last.

    >>> evenly_spaced_indices(10, 4)
    [0, 3, 6, 9]
    """
    places = torch.linspace(0, max(count - 1, 0), min(most, count), dtype=torch.float32, device="cpu")
    return [int(place) for place in places.round().tolist()]
