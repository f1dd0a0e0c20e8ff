"""Masks from the forms in the records of SAM and COCO: arrays, run lengths, polygons.

A mask is given as the indices of its pixels, so that a small mask of a large image is small. The masks of an image are
made one after the other.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from torch import Tensor

from torchjoint.masks.arrays import as_binary
from torchjoint.masks.rle import Window, declared_pixels, polygon_pixels, rle_pixels, work_of
from torchjoint.runtime import bounds
from torchjoint.scene.masks import Masks

Size = tuple[int, int]
#: A mask: the size (H, W) of its image, and its pixels as indices row x W + column.
Pixels = tuple[Size, npt.NDArray[np.int64]]
#: Corners of polygons farther away are no places in an image.
_FAR = 1e9


def pixels_of(segmentation: Any, size: Size | None, name: str) -> Pixels:
    """The pixels of a mask.

    Args:
        segmentation: an array [H, W], run lengths (a dict), or polygons (a list of lists x, y, x, y, ...).
        size: (H, W) that the mask must have; None: any size. Polygons need it.
        name: name of the mask in messages.

    Raises:
        ValueError, TypeError: naming the segmentation, what was expected and what came.
    """
    if isinstance(segmentation, Mapping):
        own, pixels = rle_pixels(segmentation, name)
    elif isinstance(segmentation, (list, tuple)):
        if size is None:
            raise ValueError(f"{name}: polygons need the size (H, W) of the image")
        bounds.check_pixels(*size, "size")
        own, pixels = size, _filled(segmentation, size, name)
    else:
        mask = as_binary(segmentation, name)
        if mask.ndim != 2:
            raise ValueError(f"{name}: expected shape [H, W], got {list(mask.shape)}")
        own, pixels = (mask.shape[0], mask.shape[1]), np.flatnonzero(mask.numpy())
    if size is not None and own != tuple(size):
        raise ValueError(f"{name}: expected {size[0]} x {size[1]} pixels, got {own[0]} x {own[1]}")
    return own, pixels


def pixels_in_box(record: Mapping[str, Any], size: Size | None, name: str) -> Pixels:
    """The pixels of a record; most must lie in the box x, y, width, height that it gives: else axes are exchanged."""
    own, pixels = pixels_of(record["segmentation"], size, name)
    try:
        low, side = np.asarray(record.get("bbox"), np.float64).reshape(2, 2)
    except (TypeError, ValueError):  # there is none
        return own, pixels
    if len(pixels) and np.isfinite(low).all() and 1 < side.min() <= side.max() < np.inf:  # else no box of pixels
        place = np.stack([pixels % own[1], pixels // own[1]], 1)
        if (np.abs(place - low - side / 2) < 2 + 0.6 * side).all(1).mean() < 0.5:
            told = f"x y {low.tolist()}, width height {side.tolist()}"
            raise ValueError(f"{name}: expected a mask in its bbox, {told}, got most pixels beside it")
    return own, pixels


def _filled(polygons: Sequence[Any], size: Size, name: str) -> npt.NDArray[np.int64]:
    """The pixels whose centres lie in one of the polygons; COCO's pixel centres have coordinates that end with .5."""
    corners, inside = [*_corners(polygons, name)], np.zeros(size[0] * size[1], bool)
    if 8 * sum(np.prod(Window(one, size).size) for one in corners) < len(inside):  # fewer bytes, and less time
        return np.unique(np.concatenate([np.empty(0, np.int64), *(polygon_pixels(one, size) for one in corners)]))
    for one in corners:  # not all at once: each may be the whole image
        inside[polygon_pixels(one, size)] = True
    return np.flatnonzero(inside)


def _corners(polygons: Sequence[Any], name: str) -> Iterator[npt.NDArray[np.float64]]:
    """The corners [C, 2] of each polygon; integers are the centres of pixels."""
    for polygon in polygons:
        try:
            corners = np.array(polygon, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise TypeError(f"{name}: expected polygons x, y, x, y, ... of numbers, got {str(polygon)[:60]}") from error
        if corners.ndim != 1 or len(corners) < 6 or len(corners) % 2 or not (np.abs(corners) < _FAR).all():
            told = f"{name}: expected polygons x, y, x, y, ... of at least 3 finite corners"
            raise ValueError(f"{told}, got {corners.shape} numbers")
        yield corners.reshape(-1, 2) - 0.5


def check_declared(segmentations: Iterable[Any], size: Size | None, name: str) -> None:
    """Checks how much work all run lengths and polygons of an image declare, before any of them is unpacked."""
    inside = around = rows = 0
    for index, one in enumerate(segmentations):
        if isinstance(one, Mapping):
            inside += declared_pixels(one, name)
        elif isinstance(one, (list, tuple)) and size is not None:
            bounds.check_pixels(*size, "size")
            for corners in _corners(one, f"{name}[{index}]'s segmentation"):
                of_window, of_edges = work_of(corners, size)
                around, rows = around + of_window, rows + of_edges
                bounds.check(around, bounds.INSIDE, "pixels around polygons", name)
                bounds.check(rows, bounds.EDGE_ROWS, "rows of all edges", name)
    bounds.check(max(0, inside), bounds.INSIDE, "pixels in all masks", name)


def merged(masks: Iterable[Pixels], count: int, size: Size | None, scores: Tensor, name: str) -> Masks:
    """The masks of one image.

    Args:
        masks: of one size; they are taken one after the other.
        count: their number.
        size: (H, W) of the image; required if there are no masks.
        scores: [count].
        name: name of the masks in messages.
    """
    bounds.check(count, bounds.MASKS, "masks", name)
    rest = iter(masks)
    first = next(rest, None)
    if first is None:
        if size is None:
            raise ValueError(f"size: expected (H, W), because {name} has no masks")
        bounds.check_pixels(*size, "size")
        return Masks.from_pixels((), size, scores, name)

    def checked() -> Iterator[npt.NDArray[np.int64]]:
        inside = len(first[1])
        yield first[1]
        for index, (own, pixels) in enumerate(rest, 1):
            if own != first[0]:
                raise ValueError(f"{name}[{index}]: expected the size {list(first[0])}, got {list(own)}")
            inside += len(pixels)
            bounds.check(inside, bounds.INSIDE, "pixels in all masks", name)
            yield pixels

    bounds.check_pixels(*first[0], name)
    return Masks.from_pixels(checked(), first[0], scores, name)
