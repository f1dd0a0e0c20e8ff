"""Wraps a network so that its output, in any known form, becomes masks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

import torch
from torch import Tensor, nn

from torchjoint.masks.arrays import from_labels, from_stack
from torchjoint.masks.networks import from_instances, from_panoptic, from_sam
from torchjoint.scene.masks import Masks


def from_module(
    network: Callable[[Any], Any], images: Literal["batch", "array"] = "batch", none: int = -1
) -> MasksOfNetwork:
    """Wraps a network, so that its forward returns a list of :class:`~torchjoint.scene.Masks`, one for each image.

    Use it as ``JointSegmenter(image_segmenter=from_module(network))``.

    Args:
        network: a module or a function. Its output for one image may be Masks; a label map [H, W]; a stack [M, H, W] of
            booleans; a pair (stack, scores); SAM's list of dicts; or a dict or an object with ``pred_masks`` or
            ``instances`` (Detectron2) or with ``segmentation`` and ``segments_info`` (Hugging Face).
        images: the network's input. "batch": [B, 3, H, W] float32 RGB in [0, 1]; it returns a sequence of B outputs,
            or a tensor of B label maps. "array": one image at a time, [H, W, 3] uint8 RGB, as for SAM's `generate`.
        none: the value of pixels without a mask in label maps, -1 or 0.

    Raises:
        ValueError: `images` is neither "batch" nor "array".
    """
    if images not in ("batch", "array"):
        raise ValueError(f"images: expected 'batch' or 'array', got {images!r}")
    return MasksOfNetwork(network, images == "array", none)


class MasksOfNetwork(nn.Module):
    """The result of :func:`from_module`: a module [B, 3, H, W] float32 RGB in [0, 1] -> a list of B Masks."""

    def __init__(self, network: Callable[[Any], Any], takes_arrays: bool, none: int) -> None:
        super().__init__()
        self.network = network
        self._takes_arrays = takes_arrays
        self._none = none

    def forward(self, images: Tensor) -> list[Masks]:
        """The masks of each image.

        Raises:
            ValueError, TypeError: the numbers of outputs and images differ, or an output has no known form.
        """
        size = images.shape[2], images.shape[3]
        if self._takes_arrays:
            arrays = images.mul(255).round().clamp(0, 255).to(torch.uint8).permute(0, 2, 3, 1).cpu().numpy()
            outputs = [self.network(array.copy()) for array in arrays]
        else:
            outputs = self.network(images)
        if not hasattr(outputs, "__len__") or len(outputs) != len(images):
            got = len(outputs) if hasattr(outputs, "__len__") else type(outputs).__name__
            raise ValueError(f"network's output: expected one for each of {len(images)} images, got {got}")
        return [self._converted(outputs[index], size, index) for index in range(len(images))]

    def _converted(self, output: Any, size: tuple[int, int], index: int) -> Masks:
        try:
            masks = _masks_of(output, size, self._none)
        except (ValueError, TypeError) as error:
            raise type(error)(f"network's output for image {index}: {error}") from error
        if masks.size != size:
            raise ValueError(f"network's output for image {index}: expected the size {size}, got {masks.size}")
        return masks


def _masks_of(output: Any, size: tuple[int, int], none: int) -> Masks:
    if isinstance(output, Masks):
        return output
    if isinstance(output, Mapping) and "segments_info" in output:
        return from_panoptic(output["segmentation"], output["segments_info"])
    if isinstance(output, Mapping) or hasattr(output, "pred_masks"):
        return from_instances(output)
    if isinstance(output, tuple) and len(output) == 2:
        return from_stack(*output)
    if isinstance(output, (list, tuple)):
        return from_sam(output, size)
    if getattr(output, "ndim", None) == 2 and "bool" not in str(output.dtype):
        return from_labels(output, none=none)
    return from_stack(output[None] if getattr(output, "ndim", None) == 2 else output)
