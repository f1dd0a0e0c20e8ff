"""The columns of an element of a PLY file, in memory or read from the file block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

#: The values of some rows by name of the column: [n], [n, length] for lists of one length, or Lists.
Block = tuple[slice, Any]


class Lists(NamedTuple):
    """A column of lists of several lengths, one after the other."""

    values: Array  #: of all lists
    lengths: Array  #: [rows] int64

    @classmethod
    def of(cls, values: Array, lengths: Array) -> Lists | Array:
        """Makes it, or a column [rows, length] if all lists have one length."""
        if len(lengths) and (lengths == lengths[0]).all():
            return values.reshape(len(lengths), -1)
        return cls(values, lengths)


class Columns(NamedTuple):
    """Rows of numbers with names."""

    rows: int
    kinds: Mapping[str, np.dtype[Any]]  #: of the numbers; object for lists
    blocks: Callable[[], Iterator[Block]]  #: yields all rows, block by block; a block is valid until the next one

    @classmethod
    def of(cls, columns: Mapping[str, Array | Lists], rows: int) -> Columns:
        """Makes it from columns in memory."""
        kinds = {
            name: np.dtype(object) if isinstance(column, Lists) or column.ndim > 1 else column.dtype
            for name, column in columns.items()
        }
        return cls(rows, kinds, lambda: iter([(slice(0, rows), columns)]))

    def has_numbers(self, names: str | tuple[str, ...]) -> bool:
        """Whether these columns exist and have one number per row."""
        return all(name in self.kinds and self.kinds[name].kind != "O" for name in names)

    def stacked(self, wanted: Mapping[str, tuple[tuple[str, ...], npt.DTypeLike, float]]) -> dict[str, Array]:
        """Makes several arrays [rows, k] in one pass over the rows.

        Args:
            wanted: for each array the names of its columns, its type, and a number by which it is divided.
        """
        made = {name: np.empty((self.rows, len(columns)), kind) for name, (columns, kind, _) in wanted.items()}
        for rows, block in self.blocks():
            for name, (columns, _, divisor) in wanted.items():
                for place, column in enumerate(columns):
                    made[name][rows, place] = block[column] if divisor == 1 else block[column].astype(float) / divisor
        return made
