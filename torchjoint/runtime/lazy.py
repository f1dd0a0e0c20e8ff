"""A sequence of frames or label images that are read from disk on access."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar, overload

from torchjoint.runtime.threads import on_cpu

T = TypeVar("T")


class LazySequence(Sequence[T]):
    """A sequence whose item `i` is `read(i)`, called at each access. `read` gets 0 <= i < count and must be pure.

    `names` are the names of the items, if they are known without reading the items; else empty.
    """

    def __init__(self, count: int, read: Callable[[int], T], names: Sequence[str] = ()) -> None:
        self._indices = range(count)
        self._read = read
        self.names = names

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> list[T]: ...
    def __getitem__(self, index: int | slice) -> T | list[T]:
        with on_cpu():
            if isinstance(index, slice):
                return [self._read(i) for i in self._indices[index]]
            return self._read(self._indices[index])
