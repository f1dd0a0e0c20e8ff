"""A posed image: its pixels, camera and pose; and the warning if poses look wrong."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.scene.checks import as_float, as_image, as_intrinsics, as_labels, as_pose, as_tensor, check_shape
from torchjoint.scene.masks import Masks, as_masks

#: A tensor or an array.
Given = Tensor | npt.NDArray[Any]


def camera_center(world_to_camera: Tensor) -> Tensor:
    """The camera's position in the world frame, -R^T t: [4, 4] rigid -> [3] metres, of the same dtype."""
    return -(world_to_camera[:3, :3].T @ world_to_camera[:3, 3])


def to_8_bits(values: Tensor) -> Tensor:
    """Colours, or strengths of boundaries, in [0, 1] as uint8."""
    return values.mul(255).round_().clamp_(0, 255).to(torch.uint8)


#: In words, after "the poses look". Frames have world_to_camera in OpenCV axes, but files may have the others.
CONVENTIONS = {
    "inverted": "inverted: camera-to-world where world-to-camera is expected, or the reverse?",
    "axes": "turned in y and z: OpenGL axes where OpenCV axes are expected, or the reverse?",
    "inverted axes": "inverted, and turned in y and z: also OpenGL axes where OpenCV's are expected, or the reverse?",
}


class PoseWarning(UserWarning):
    """The poses or intrinsics look wrong."""


class PoseDoubt(PoseWarning):
    """The same, of something that right poses or intrinsics can have, too: a cropped image, or few edges."""


@dataclass(frozen=True)
class Frame:
    """One posed image. Arguments may be tensors or NumPy arrays; the attributes are tensors.

    Args:
        image: [3, H, W] RGB in [0, 1]; uint8 images are divided by 255; a grey image ([H, W] or [1, H, W]) is
            repeated three times. A NumPy array may be [H, W, 3], as Pillow and imageio give it; OpenCV's are BGR:
            ``image[..., ::-1]``.
        intrinsics: [3, 3] camera matrix in pixels of *this* image, no skew; pixel centres have integer coordinates.
        world_to_camera: [4, 4] rigid transform, metres, OpenCV axes. If your poses are camera-to-world, invert them.
        depth: optional [H, W], metres along the camera's z; 0 = unknown. It is used to check poses, and to fuse a cloud
            if there is none; the method itself does not use it.
        labels: optional [H, W] integers, an initial segmentation of the image that replaces the one of step 2, such as
            superpixels; -1 = none. Or one mask [H, W] bool, with no label outside. Like the segments of step 2, the
            labels may split objects.
        masks: optional objects that a network found in the image. A label map [H, W] (-1 = none); a stack [M, H, W] of
            booleans that may overlap and nest; or :class:`~torchjoint.scene.Masks`, see :mod:`torchjoint.masks`. They
            are scaled to the image's size. For this frame they replace `labels` and the results of steps 1 and 2.
        mask_scores: optional [M] in [0, 1], how far each mask can be trusted; default 1.
        name: used in file names and messages.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """

    image: Tensor
    intrinsics: Tensor
    world_to_camera: Tensor
    depth: Tensor | None = None
    labels: Tensor | None = None
    name: str = ""
    masks: Tensor | Masks | None = None
    mask_scores: Tensor | None = None

    if TYPE_CHECKING:  # what comes in may be of NumPy, too

        def __init__(
            self,
            image: Given,
            intrinsics: Given,
            world_to_camera: Given,
            depth: Given | None = None,
            labels: Given | None = None,
            name: str = "",
            masks: Given | Masks | None = None,
            mask_scores: Given | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        set_ = lambda key, value: object.__setattr__(self, key, value)  # noqa: E731 (frozen: set once, here)
        for spec in fields(self):
            value: object = getattr(self, spec.name)
            if isinstance(value, np.ndarray):
                value = np.moveaxis(value, 2, 0) if spec.name == "image" and value.shape[2:] in ((1,), (3,)) else value
                set_(spec.name, as_tensor(value, self._called(spec.name)))
        if not isinstance(self.name, str):
            raise TypeError(f"name: expected a text, got {self.name!r}")
        set_("image", as_image(self.image, self._called("image")))
        set_("intrinsics", as_intrinsics(self.intrinsics, self._called("intrinsics")))
        set_("world_to_camera", as_pose(self.world_to_camera, self._called("world_to_camera")))
        if self.depth is not None:
            if isinstance(self.depth, Tensor) and not self.depth.dtype.is_floating_point:
                told = f"expected metres as float32, got {self.depth.dtype}; is it in millimetres?"
                raise TypeError(f"{self._called('depth')}: {told}")
            depth = as_float(self.depth, f"{self._called('depth')} (metres, 0 = unknown)", torch.float32).clone()
            check_shape(depth, self.size, self._called("depth"))
            if depth.min() < 0 and depth.max() <= 0:  # of a camera that looks along -z
                raise ValueError(f"{self._called('depth')}: expected metres above 0 (0 = unknown), got none")
            set_("depth", depth)
        if self.labels is not None:
            set_("labels", as_labels(self.labels, self.size, self._called("labels")).clone())
        if self.masks is None and self.mask_scores is not None:
            raise ValueError(f"{self._called('mask_scores')}: expected none, because there are no masks")
        if self.masks is not None:
            set_("masks", as_masks(self.masks, self.size, self.mask_scores, self._called("masks")))
            set_("mask_scores", None)  # now in masks

    def __repr__(self) -> str:
        has = "".join(f", {name}" for name in ("depth", "labels", "masks") if getattr(self, name) is not None)
        return f"Frame({self.name!r}: {self.size[1]} x {self.size[0]} pixels{has})"

    def _called(self, argument: str) -> str:
        return f"{argument} of frame {self.name!r}" if self.name else argument

    @property
    def size(self) -> tuple[int, int]:
        """(H, W) of the image, pixels."""
        return self.image.shape[1], self.image.shape[2]
