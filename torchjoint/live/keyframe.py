"""What live segmentation keeps of a keyframe: the results of steps 1 and 2, packed, and its camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchjoint.images.segmenter import ImageSegments
from torchjoint.runtime.packing import Packed, pack
from torchjoint.runtime.spill import SpillFile
from torchjoint.scene import Frame, Masks

#: Metres: kept depth is rounded to this, less than any sensor's noise.
DEPTH_STEP = 1e-4
_PACKED = ("image", "boundary", "labels", "taken", "depth")


class Keyframe(NamedTuple):
    """A frame that gives evidence."""

    name: str
    intrinsics: Tensor
    world_to_camera: Tensor
    image: Packed  #: as steps 1 and 2 saw it
    boundary: Packed
    labels: Packed
    masks: Masks | None
    taken: Packed | None = None  #: the image as it was taken, if depth is kept and the image is another one
    depth: Packed | None = None  #: in steps of DEPTH_STEP, if it is kept

    @classmethod
    def packed(cls, frame: Frame, developed: Frame, segments: ImageSegments, far: float | None) -> Keyframe:
        """A keyframe.

        Args:
            frame: as it was taken.
            developed: the same, as steps 1 and 2 saw it.
            segments: their results.
            far: metres, keeps depth up to here; None: keeps no depth.
        """
        # 8 bits are what steps 5-8 see of images.
        keyframe = cls(
            frame.name,
            frame.intrinsics,
            frame.world_to_camera,
            pack(_bytes(developed.image)),
            pack(_bytes(segments.boundary)),
            pack(segments.labels.to(torch.int32)),
            segments.masks,
        )
        if far is None or frame.depth is None:
            return keyframe
        known = (frame.depth > 0) & (frame.depth <= far)
        depth = torch.where(known, (frame.depth / DEPTH_STEP).round(), 0.0).to(torch.int32)
        taken = None if developed is frame else pack(_bytes(frame.image))
        return keyframe._replace(taken=taken, depth=pack(depth))

    def to_dict(self) -> dict[str, Any]:
        """A dict of tensors, numbers and strings, for torch.save and loading with ``weights_only=True``."""
        values = {
            name: value.to_dict() if isinstance(value, Packed) else value for name, value in self._asdict().items()
        }
        return values | {"masks": None if self.masks is None else vars(self.masks)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Keyframe:
        """The inverse of :meth:`to_dict`, for values of a file.

        Raises:
            TypeError, ValueError, LookupError: they are no keyframe; the message names what is wrong.
        """
        packed = {name: Packed.from_dict(values[name]) for name in _PACKED if values[name] is not None}
        masks = None if values["masks"] is None else Masks(**values["masks"])
        keyframe = cls(**{**values, **packed, "masks": masks})
        frame, segments = keyframe.opened()
        keyframe.measured()
        for name, shape in (("boundary", segments.boundary.shape), ("labels", segments.labels.shape)):
            check_size(shape, frame.size, f"{name} of keyframe {frame.name!r}")
        check_size(frame.size if masks is None else masks.size, frame.size, f"masks of keyframe {frame.name!r}")
        low, high = int(segments.labels.min()), int(segments.labels.max())
        if not -1 <= low <= high < segments.labels.numel():
            raise ValueError(f"labels of keyframe {frame.name!r}: expected -1 or more, got {low} to {high}")
        return keyframe._replace(intrinsics=frame.intrinsics, world_to_camera=frame.world_to_camera)

    @property
    def num_bytes(self) -> int:
        """Of the packed data."""
        return sum(len(part.data()) for part in self._parts().values())

    def spilled(self, file: SpillFile) -> Keyframe:
        """The same, with its packed data in a file."""
        parts = self._parts()
        spans = file.write([part.data() for part in parts.values()])
        values: dict[str, Any] = {name: parts[name].at(span) for name, span in zip(parts, spans, strict=True)}
        return self._replace(**values)

    def _parts(self) -> dict[str, Packed]:
        return {name: part for name in _PACKED if (part := getattr(self, name)) is not None}

    def opened(self) -> tuple[Frame, ImageSegments]:
        """The frame as steps 1 and 2 saw it, and their results."""
        frame = Frame(_image(self.image), self.intrinsics, self.world_to_camera, name=self.name)
        segments = ImageSegments(_image(self.boundary), self.labels.unpack().long(), self.masks)
        return frame, segments

    def measured(self) -> Frame | None:
        """The frame as it was taken, with its depth; None: no depth was kept."""
        if self.depth is None:
            return None
        frame = Frame(_image(self.taken or self.image), self.intrinsics, self.world_to_camera, name=self.name)
        return replace(frame, depth=self.depth.unpack().float() * DEPTH_STEP)


def check_size(got: Sequence[int], expected: tuple[int, int], name: str) -> None:
    """Raises ValueError unless the sizes (H, W) are equal."""
    if tuple(got) != expected:
        raise ValueError(f"{name}: expected {list(expected)}, got {list(got)}")


def _bytes(values: Tensor) -> Tensor:
    return values.mul(255).round().to(torch.uint8)


def _image(packed: Packed) -> Tensor:
    return packed.unpack().float() / 255
