"""What is kept of each frame for steps 6 to 8; in memory up to a budget, the rest packed in a temporary file."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple, overload

import torch
from torch import Tensor

from torchjoint.runtime.memory import give_back
from torchjoint.runtime.store import OffloadFile, Packed, pack
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Masks
from torchjoint.views.visibility import Visible

_OF_POINTS = ("row", "column", "u", "v", "z")


@dataclass(frozen=True)
class Observation:
    """The stored data of one frame. Images have 8 bits per channel: enough for step 7, and small for long sequences.

    Packing, files and the memory budget read the list of fields, so a new tensor field needs no other change. A field
    of another type needs an entry in `_SPLIT`.
    """

    name: str
    labels: Tensor  #: [H, W] int32, initial labels 0, 1, ... without gaps, -1 = none; with masks: their atoms
    visible: Visible
    intrinsics: Tensor  #: [3, 3] float32 pixels
    world_to_camera: Tensor  #: [4, 4] float32, from the coordinates of the prepared cloud
    image: Tensor  #: [3, H, W] uint8
    boundary: Tensor  #: [H, W] uint8, boundary strength x 255
    masks: Masks | None = field(default_factory=lambda: None)
    #: [2, V] int64, points at the two ends of lines across an occluder; only method learned, frames without masks
    lines: Tensor = field(default_factory=lambda: torch.empty(2, 0, dtype=torch.int64))

    @property
    def size(self) -> tuple[int, int]:
        """(H, W) pixels."""
        return self.labels.shape[0], self.labels.shape[1]

    def labelled_points(self) -> tuple[Tensor, Tensor]:
        """The visible points in pixels with a label, and these labels, both [L] int64."""
        label = self.labels[self.visible.row, self.visible.column].long()
        has_label = label >= 0
        return self.visible.point[has_label], label[has_label]

    def initial_labels(self) -> Tensor:
        """The initial labels [H, W], -1 = none; where masks overlap, the smallest mask counts."""
        return self.labels if self.masks is None else self.masks.labels()

    def tensors(self) -> dict[str, Tensor]:
        """All tensors by name; fields of other types are split into tensors."""
        found: dict[str, Tensor] = {}
        for spec in fields(Observation):
            value = getattr(self, spec.name)
            if isinstance(value, Tensor):
                found[spec.name] = value
            elif spec.name in _SPLIT:
                found |= _SPLIT[spec.name].split(value)
        return found

    @property
    def num_bytes(self) -> int:
        """Memory of the tensors, bytes; masks share their atoms with the labels."""
        return sum(tensor.numel() * tensor.element_size() for tensor in self.tensors().values())

    @property
    def num_points(self) -> int:
        """Number of visible points."""
        return len(self.visible.point)

    def check(self, num_points: int) -> None:
        """Checks an observation that was read from a file, of a cloud of `num_points` points.

        Raises:
            TypeError, ValueError: a tensor has another shape, or a number that is no place in another one.
        """
        height, width = self.labels.shape
        point, seen = self.visible.point, self.num_points
        ranges = {
            "labels": (self.labels, -1, height * width, (height, width)),
            "point": (point, 0, num_points, (seen,)),
            "row": (self.visible.row, 0, height, (seen,)),
            "column": (self.visible.column, 0, width, (seen,)),
            "image": (self.image, 0, 256, (3, height, width)),
            "boundary": (self.boundary, 0, 256, (height, width)),
            "lines": (self.lines, 0, num_points, (2, self.lines.shape[-1])),
        }
        if not isinstance(self.name, str):
            raise TypeError(f"name: expected a text, got {self.name!r}")
        for name, (values, low, end, shape) in ranges.items():
            if (values.dtype == torch.uint8) != (name in ("image", "boundary")):  # as an index, 8 bits are a mask
                raise TypeError(f"{name} of {self.name!r}: got values of {values.dtype}")
            if values.shape != shape or (values.numel() and not low <= int(values.min()) <= int(values.max()) < end):
                raise ValueError(f"{name} of {self.name!r}: expected {list(shape)} in [{low}, {end}), got other values")

    def pack(self) -> PackedObservation:
        """The same data, packed, which is much smaller."""
        return PackedObservation(self.name, {name: pack(tensor) for name, tensor in self.tensors().items()})

    def open(self) -> Observation:
        """Returns itself; nothing is packed."""
        return self


@dataclass(frozen=True)
class PackedObservation:
    """An :class:`Observation` with its tensors packed."""

    name: str
    parts: Mapping[str, Packed]

    @property
    def num_bytes(self) -> int:
        """Memory of the tensors when all are unpacked, bytes."""
        return sum(part.num_bytes for part in self.parts.values())

    @property
    def num_points(self) -> int:
        """Number of visible points."""
        return self.parts["row"].shape[0]

    @property
    def is_offloaded(self) -> bool:
        """Whether the packed tensors are in a file."""
        return not any(isinstance(part.content, bytes) for part in self.parts.values())

    def open(self) -> Observation:
        """The observation. Each field is unpacked when it is first used; step 6, for example, never uses the image."""
        return _Opened(self)

    def unpack(self) -> Observation:
        """The observation with all fields."""
        opened = self.open()
        return Observation(**{field.name: getattr(opened, field.name) for field in fields(Observation)})

    def to_dict(self) -> dict[str, Any]:
        """A dict of tensors, numbers and strings, for torch.save and loading with ``weights_only=True``."""
        return {"name": self.name, "parts": {name: part.to_dict() for name, part in self.parts.items()}}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> PackedObservation:
        """The inverse of :meth:`to_dict`."""
        return cls(values["name"], {name: Packed.from_dict(part) for name, part in values["parts"].items()})


class _Opened(Observation):
    """An observation that unpacks each field when it is first used. Only one thread may use it."""

    def __init__(self, packed: PackedObservation) -> None:
        vars(self).update(name=packed.name, _parts=packed.parts)

    def __getattr__(self, name: str) -> Any:
        """Python calls this for a field that is not unpacked yet."""
        parts = vars(self).get("_parts", {})
        if name in _SPLIT:
            value = _SPLIT[name].join(self, parts)
        elif name in parts:
            value = parts[name].unpack()
        else:
            raise AttributeError(name)
        vars(self)[name] = value
        return value


class _Split(NamedTuple):
    """Converts a field that is not a tensor to tensors, and back."""

    split: Callable[[Any], dict[str, Tensor]]
    join: Callable[[Observation, Mapping[str, Packed]], Any]


def _split_visible(visible: Visible) -> dict[str, Tensor]:
    steps = torch.diff(visible.point, prepend=torch.zeros(1, dtype=torch.int64))  # ascending: small numbers
    return {"point_steps": steps, **{name: getattr(visible, name) for name in _OF_POINTS}}


def _join_visible(_: Observation, parts: Mapping[str, Packed]) -> Visible:
    return Visible(parts["point_steps"].unpack().cumsum(0), *(parts[name].unpack() for name in _OF_POINTS))


def _split_masks(masks: Masks | None) -> dict[str, Tensor]:
    return {} if masks is None else {"mask_pairs": masks.pairs, "mask_scores": masks.scores}


def _join_masks(seen: Observation, parts: Mapping[str, Packed]) -> Masks | None:
    if "mask_pairs" not in parts:
        return None
    return Masks(seen.labels, parts["mask_pairs"].unpack(), parts["mask_scores"].unpack())


_SPLIT = {"visible": _Split(_split_visible, _join_visible), "masks": _Split(_split_masks, _join_masks)}


class Observations(Sequence[Observation]):
    """A sequence of observations. Those beyond the memory budget are packed in a file, and read when they are used.

    The first observations stay in memory, and later ones go to the file. Step 6 reads all of them in order, so the
    choice does not matter.

    Args:
        observations: observations to start with.
        budget: bytes that the observations may take in memory; None: no limit.
        folder: folder of the file, see :class:`~torchjoint.runtime.store.OffloadFile`.
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
        self._file: OffloadFile | None = None
        self.extend(observations)

    def extend(self, observations: Iterable[Observation | PackedObservation]) -> None:
        """Adds observations, all or none."""
        records, in_memory, beyond = list(observations), self._in_memory, []
        for index, record in enumerate(records):
            if isinstance(record, PackedObservation) and record.is_offloaded:
                continue
            size = record.num_bytes
            if self._budget is None or in_memory + size <= self._budget:
                in_memory += size
                records[index] = record.unpack() if isinstance(record, PackedObservation) else record
            else:
                beyond.append(index)
        packed = parallel_map(_packed, [records[index] for index in beyond])
        for index, offloaded in zip(beyond, self._offload(packed), strict=True):
            records[index] = offloaded
        self._records += records
        self._in_memory = in_memory

    def _offload(self, packed: Sequence[PackedObservation]) -> list[PackedObservation]:
        """The same observations, with their bytes in the file."""
        if not packed:
            return []
        if self._file is None or self._file.process != os.getpid():
            self._file = OffloadFile(self._folder)
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


def _packed(record: Observation | PackedObservation) -> PackedObservation:
    return record if isinstance(record, PackedObservation) else record.pack()
