"""Cuts the best views of a segment out of their images, for example for CLIP (output after step 8)."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.results.objects import image_views
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Frame, Scene, Segmentation
from torchjoint.views.projection import project


@dataclass(frozen=True)
class Crop:
    """A segment as one frame sees it.

    Attributes:
        image: [3, h, w] RGB in [0, 1], the part of the frame around the segment.
        mask: [h, w] bool, the segment's pixels in it.
        box: x, y, width w and height h of the part, pixels of the frame.
        frame: index of the frame.
        name: of the frame.
        pixels: number of the segment's pixels.
        whole: share of the segment's points that lie inside the image, 0 to 1.
    """

    image: Tensor
    mask: Tensor
    box: tuple[int, int, int, int]
    frame: int
    name: str
    pixels: int
    whole: float

    def __repr__(self) -> str:
        _, _, width, height = self.box
        return f"Crop({self.name!r}: {width} x {height} pixels, {self.pixels} of the segment, {self.whole:.0%} whole)"


class Camera(NamedTuple):
    """The camera of a frame, without its image."""

    intrinsics: Tensor
    world_to_camera: Tensor
    size: tuple[int, int]

    @classmethod
    def of(cls, frame: Frame) -> Camera:
        """The camera of a frame."""
        return cls(frame.intrinsics, frame.world_to_camera, frame.size)


def best_crops(scene: Scene, result: Segmentation, segment: int, k: int = 1, margin: float = 0.1) -> list[Crop]:
    """Crops the frames that show a segment best, best first.

    The score of a frame is the number of the segment's pixels, times the square of the share of its points that lie
    inside the image: half an object at the border scores less than the whole object from farther away. Of frames with
    equal scores, the first comes first.

    Args:
        scene: the frames and the cloud.
        result: the labels.
        segment: id of a segment of the cloud.
        k: largest number of crops.
        margin: added around the segment's box, as a share of the box's longer side.

    Returns:
        at most `k` crops; fewer if fewer frames see the segment.

    Raises:
        TypeError: the id is no integer.
        ValueError: an unknown id, k < 1, a negative margin, or a scene without the frames of the result.
    """
    segment = check_segment(segment, result.num_point_segments)
    if k < 1 or not margin >= 0:
        raise ValueError(f"k and margin: expected k >= 1 and margin >= 0, got {k} and {margin}")
    if len(result.images) != len(scene.frames):
        raise ValueError(f"scene: expected the {len(result.images)} frames of the result, got {len(scene.frames)}")
    counts = parallel_map(lambda index: int((result.images[index] == segment).sum()), range(len(result.images)))
    seen = {index: count for index, count in enumerate(counts) if count}
    return crops_of(scene, result, segment, seen, {index: Camera.of(scene.frames[index]) for index in seen}, k, margin)


def crops_of(
    scene: Scene,
    result: Segmentation,
    segment: int,
    pixels: Mapping[int, int],
    cameras: Mapping[int, Camera],
    k: int,
    margin: float,
) -> list[Crop]:
    """As :func:`best_crops`, for the frames in `pixels`, which has the number of the segment's pixels in each."""
    points = scene.points[result.points == segment]
    share = {index: len(project(points, *cameras[index]).point) / max(len(points), 1) for index in pixels}
    best = sorted(pixels, key=lambda index: (-pixels[index] * share[index] ** 2, index))
    return [_crop(scene, result, segment, index, share[index], margin) for index in best[:k]]


def check_segment(segment: int, count: int) -> int:
    """Returns the id of a segment as int, if it is one of 0, ..., `count` - 1.

    Raises:
        TypeError: not an integer.
        ValueError: out of range.
    """
    try:
        number = operator.index(segment)
    except TypeError:
        raise TypeError(f"segment: expected an id, an integer, got {segment!r}") from None
    if not 0 <= number < count:
        raise ValueError(f"segment: expected an id from 0 to {count - 1}, got {number}")
    return number


def _crop(scene: Scene, result: Segmentation, segment: int, index: int, whole: float, margin: float) -> Crop:
    frame, mask = scene.frames[index], result.images[index] == segment
    ((_, pixels, (x, y, width, height)),) = image_views(torch.where(mask, 0, -1), 1)
    around = round(margin * max(width, height))
    left, top = max(0, x - around), max(0, y - around)
    right, bottom = min(frame.size[1], x + width + around), min(frame.size[0], y + height + around)
    name = result.names[index] or f"{index:06d}"
    return Crop(
        frame.image[:, top:bottom, left:right],
        mask[top:bottom, left:right],
        (left, top, right - left, bottom - top),
        index,
        name,
        pixels,
        whole,
    )
