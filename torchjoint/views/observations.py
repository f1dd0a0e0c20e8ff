"""The observations of all frames. They are in memory up to a budget; the rest is packed in a temporary file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, overload

from torchjoint.runtime.free_memory import give_back
from torchjoint.runtime.spill import SpillFile
from torchjoint.runtime.threads import parallel_map
from torchjoint.views.observation import Observation, PackedObservation


class Observations(Sequence[Observation]):
    """A sequence of observations. Those beyond the memory budget are packed in a file, and read when they are used.

    The first observations stay in memory, and later ones go to the file. Step 6 reads all of them in order, so the
    choice does not matter.

    Args:
        observations: observations to start with.
        budget: bytes that the observations may take in memory; None: no limit.
        folder: folder of the file, see :class:`~torchjoint.runtime.spill.SpillFile`.
    """

    def __init__(
        self,
        observations: Iterable[Observation | PackedObservation] = (),
        *,
        budget: int | None = None,
        folder: Path | None = None,
    ) -> None:
        self._budget, self._folder = budget, folder
        self._records: list[Observation | PackedObservation] = []
        self._in_memory = 0
        self._file: SpillFile | None = None
        self.extend(observations)

    def extend(self, observations: Iterable[Observation | PackedObservation]) -> None:
        """Adds observations, all or none.

        Raises:
            OSError: the file cannot be written; the message says what the user can do.
        """
        records, in_memory, beyond = list(observations), self._in_memory, []
        for index, record in enumerate(records):
            if isinstance(record, PackedObservation) and record.is_spilled:
                continue
            size = record.num_bytes
            if self._budget is None or in_memory + size <= self._budget:
                in_memory += size
                records[index] = record.unpack() if isinstance(record, PackedObservation) else record
            else:
                beyond.append(index)
        packed = parallel_map(_packed, [records[index] for index in beyond])
        for index, spilled in zip(beyond, self._spill(packed), strict=True):
            records[index] = spilled
        self._records += records
        self._in_memory = in_memory

    def _spill(self, packed: Sequence[PackedObservation]) -> list[PackedObservation]:
        """The same observations, with their bytes in the file."""
        if not packed:
            return []
        if self._file is None:
            self._file = SpillFile(self._folder)
        spans = iter(self._file.write([part.data() for one in packed for part in one.parts.values()]))
        give_back()  # otherwise the peak memory of a long recording is some tenths of a gigabyte higher
        return [
            PackedObservation(one.name, {name: part.at(next(spans)) for name, part in one.parts.items()})
            for one in packed
        ]

    def __len__(self) -> int:
        return len(self._records)

    @overload
    def __getitem__(self, index: int) -> Observation: ...
    @overload
    def __getitem__(self, index: slice) -> Observations: ...
    def __getitem__(self, index: int | slice) -> Observation | Observations:
        if isinstance(index, slice):
            return self._of(self._records[index])
        return self._records[index].open()

    def __add__(self, other: Observations) -> Observations:
        """All observations of both, with the budget of this one."""
        both = self[:]
        both.extend(other._records)
        return both

    def _of(self, records: Sequence[Observation | PackedObservation]) -> Observations:
        chosen = Observations(budget=self._budget, folder=self._folder)
        chosen._records, chosen._file = list(records), self._file
        chosen._in_memory = sum(record.num_bytes for record in records if isinstance(record, Observation))
        return chosen

    def __getstate__(self) -> dict[str, Any]:
        """For pickle, which stores the content of the file as bytes."""
        return vars(self) | {"_file": None}

    def packed(self, index: int) -> PackedObservation:
        """One observation in packed form."""
        return _packed(self._records[index])

    @property
    def names(self) -> list[str]:
        """The frames' names; nothing is unpacked."""
        return [record.name for record in self._records]

    @property
    def see_points(self) -> bool:
        """Whether any frame sees a point; nothing is unpacked."""
        return any(record.num_points for record in self._records)

    def without_masks(self) -> Observations:
        """The frames that came without masks."""
        return self._of([record for record in self._records if not record.has_masks])


def _packed(record: Observation | PackedObservation) -> PackedObservation:
    return record if isinstance(record, PackedObservation) else record.pack()
