"""The data of one frame that steps 6-8 need: results of steps 1, 2 and 4, the image, and the camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.packing import Packed, pack
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

    @property
    def has_masks(self) -> bool:
        """Whether the frame came with masks."""
        return self.masks is not None

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
        for name, (values, low, end, shape) in ranges.items():
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
    def has_masks(self) -> bool:
        """Whether the frame came with masks."""
        return "mask_pairs" in self.parts

    @property
    def is_spilled(self) -> bool:
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
