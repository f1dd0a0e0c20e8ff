"""The columns of an element of a PLY file, in memory or read from the file block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

#: The values of some rows by name of the column: [n], or [n, length] for lists of one length.
Block = tuple[slice, Any]


class Columns(NamedTuple):
    """Rows of numbers with names."""

    rows: int
    kinds: Mapping[str, np.dtype[Any]]  #: of the numbers; object for lists
    blocks: Callable[[], Iterator[Block]]  #: yields all rows, block by block; a block is valid until the next one

    @classmethod
    def of(cls, columns: Mapping[str, Array], rows: int) -> Columns:
        """Makes it from columns in memory."""
        kinds = {name: column.dtype if column.ndim == 1 else np.dtype(object) for name, column in columns.items()}
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
