"""What steps 6-8 need of one frame: its initial segments and the points that it sees (results of steps 1, 2 and 4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from torchjoint.runtime.packing import Packed, pack
from torchjoint.scene import Masks
from torchjoint.views.visibility import Visible

_OF_POINTS = ("row", "column", "u", "v", "z")
_WHOLE = ("labels", "image", "boundary", "intrinsics", "world_to_camera", "lines")


@dataclass(frozen=True)
class Observation:
    """What is stored of one frame. Images have 8 bits per channel: enough for step 7, and small for long sequences."""

    name: str
    labels: Tensor  #: [H, W] int32, the initial segmentation, labels 0, 1, ... without gaps, -1 = none; or masks' atoms
    visible: Visible
    intrinsics: Tensor  #: [3, 3] float32 pixels
    world_to_camera: Tensor  #: [4, 4] float32, of the prepared cloud's own frame
    image: Tensor  #: [3, H, W] uint8
    boundary: Tensor  #: [H, W] uint8, boundary strength x 255
    masks: Masks | None = None
    #: [2, V] int64, points at the two ends of lines across something nearer; only method learned, without masks
    lines: Tensor = field(default_factory=lambda: torch.empty(2, 0, dtype=torch.int64))

    def labelled_points(self) -> tuple[Tensor, Tensor]:
        """The visible points in pixels with a label, and these labels, both [L] int64."""
        label = self.labels[self.visible.row, self.visible.column].long()
        has_label = label >= 0
        return self.visible.point[has_label], label[has_label]

    def initial_labels(self) -> Tensor:
        """The initial segmentation as it is shown, [H, W] integers, -1 = none; of masks that overlap the smallest."""
        return self.labels if self.masks is None else self.masks.labels()

    @property
    def num_bytes(self) -> int:
        """Memory that the tensors take; masks share their atoms with the labels."""
        tensors = [*(getattr(self, name) for name in _WHOLE), *self.visible]
        if self.masks is not None:
            tensors += [self.masks.pairs, self.masks.scores]
        return sum(tensor.numel() * tensor.element_size() for tensor in tensors)

    @property
    def num_points(self) -> int:
        """Number of visible points."""
        return len(self.visible.point)

    @property
    def has_masks(self) -> bool:
        """Whether the frame came with masks."""
        return self.masks is not None

    def pack(self) -> PackedObservation:
        """The same, much smaller."""
        steps = torch.diff(self.visible.point, prepend=torch.zeros(1, dtype=torch.int64))  # ascending: small numbers
        tensors = {name: getattr(self, name) for name in _WHOLE} | {"point_steps": steps}
        tensors |= {name: getattr(self.visible, name) for name in _OF_POINTS}
        if self.masks is not None:
            tensors |= {"mask_pairs": self.masks.pairs, "mask_scores": self.masks.scores}
        return PackedObservation(self.name, {name: pack(tensor) for name, tensor in tensors.items()})

    def open(self) -> Observation:
        """Itself, because nothing is packed."""
        return self


@dataclass(frozen=True)
class PackedObservation:
    """An :class:`Observation` with its tensors packed."""

    name: str
    parts: Mapping[str, Packed]

    @property
    def num_bytes(self) -> int:
        """Memory that the tensors take when all are unpacked."""
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
        """Whether its bytes are in a file."""
        return not any(isinstance(part.content, bytes) for part in self.parts.values())

    def open(self) -> Observation:
        """The observation; each of its fields is unpacked when it is first used: the image, for one, not in step 6."""
        return _Opened(self)

    def unpack(self) -> Observation:
        """The observation with all fields."""
        opened = self.open()
        return Observation(**{field.name: getattr(opened, field.name) for field in fields(Observation)})

    def to_dict(self) -> dict[str, Any]:
        """A dict of tensors, numbers and strings, for torch.save and loading with ``weights_only=True``."""
        parts = {
            name: vars(part) | {"content": torch.frombuffer(bytearray(part.data()), dtype=torch.uint8)}
            for name, part in self.parts.items()
        }
        return {"name": self.name, "parts": parts}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> PackedObservation:
        """The inverse of :meth:`to_dict`."""
        parts = {
            name: Packed(**part | {"content": part["content"].numpy().tobytes()})
            for name, part in values["parts"].items()
        }
        return cls(values["name"], parts)


class _Opened(Observation):
    """An observation that unpacks each field when it is first used, for one thread."""

    def __init__(self, packed: PackedObservation) -> None:
        vars(self).update(name=packed.name, _parts=packed.parts)

    def _part(self, name: str) -> Tensor:
        part: Packed = vars(self)["_parts"][name]
        return part.unpack()

    @cached_property
    def labels(self) -> Tensor:
        return self._part("labels")

    @cached_property
    def visible(self) -> Visible:
        row, column, u, v, z = (self._part(name) for name in _OF_POINTS)
        return Visible(self._part("point_steps").cumsum(0), row, column, u, v, z)

    @cached_property
    def intrinsics(self) -> Tensor:
        return self._part("intrinsics")

    @cached_property
    def world_to_camera(self) -> Tensor:
        return self._part("world_to_camera")

    @cached_property
    def image(self) -> Tensor:
        return self._part("image")

    @cached_property
    def boundary(self) -> Tensor:
        return self._part("boundary")

    @cached_property
    def lines(self) -> Tensor:
        return self._part("lines")

    @cached_property
    def masks(self) -> Masks | None:
        if "mask_pairs" not in vars(self)["_parts"]:
            return None
        return Masks(self.labels, self._part("mask_pairs"), self._part("mask_scores"))
