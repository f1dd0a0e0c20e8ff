"""A segment from points or pixels that somebody chose, at the level of the hierarchy that fits them (after step 8)."""

from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

import torch
from scipy.cluster.hierarchy import DisjointSet
from torch import Tensor

from torchjoint.runtime.groups import check_dense
from torchjoint.scene import Hierarchy, Segmentation

#: Pixels as (frame, column, row).
Pixels = Sequence[tuple[int, int, int]]


class Pick(NamedTuple):
    """What was picked.

    Attributes:
        points: [N] bool, the points of the cloud.
        superpoints: [K] int64, ascending, the superpoints of the hierarchy; without a hierarchy, the segments. The mask
            of frame ``i`` is ``torch.isin(result.superpoint_images[i], pick.superpoints)``.
    """

    points: Tensor
    superpoints: Tensor


class Prompts(NamedTuple):
    """Points and pixels that somebody chose."""

    points: Tensor | None = None  #: [K] int64 indices, or [K, 3] float positions
    pixels: Pixels = ()


def pick(result: Segmentation, cloud: Tensor, chosen: Prompts, negative: Prompts) -> Pick:
    """Picks a segment; see :meth:`torchjoint.results.result.Result.pick`. `cloud`: [N, 3] the positions of the points.

    Without a hierarchy, only whole segments can be picked.
    """
    wanted = _superpoints(result, cloud, chosen, "points", "pixels")
    unwanted = _superpoints(result, cloud, negative, "negative", "negative_pixels")
    if not wanted or -1 in wanted:  # without a hierarchy, points may have no label
        raise ValueError(f"points, pixels: expected at least one point, each of a segment, got {sorted(wanted)}")
    if both := wanted & unwanted:
        told = f"negative: expected points apart from the chosen ones, but both are in superpoint {min(both)}"
        raise ValueError(f"{told}, the smallest part that the segmentation knows")
    hierarchy = result.hierarchy
    of_point = result.points if hierarchy is None else hierarchy.superpoint
    segments = result.points[torch.isin(of_point, torch.tensor(sorted(wanted)))].unique()
    if not unwanted and len(segments) == 1:  # as the labels have it, with corrections
        superpoints = of_point[result.points == segments].unique()
    else:
        superpoints = torch.tensor(sorted(wanted if hierarchy is None else _grown(hierarchy, wanted, unwanted)))
    return Pick(torch.isin(of_point, superpoints), superpoints)


def _grown(hierarchy: Hierarchy, wanted: set[int], unwanted: set[int]) -> set[int]:
    """The superpoints of the largest segments that contain a wanted superpoint and no unwanted one."""
    order = torch.argsort(hierarchy.heights, stable=True)
    merges, heights = hierarchy.merges[order].tolist(), hierarchy.heights[order].tolist()
    limit = max(hierarchy.default, _height_of_all(hierarchy, wanted))
    groups = DisjointSet(range(hierarchy.num_superpoints))
    # Groups that cannot grow: one above has an unwanted one.
    ended = [superpoint in unwanted for superpoint in range(hierarchy.num_superpoints)]
    for (a, b), height in zip(merges, heights, strict=True):
        if height > limit:
            break
        one, other = groups[a], groups[b]
        if ended[one] or ended[other]:
            ended[one] = ended[other] = True
        else:
            groups.merge(a, b)
    return set().union(*(groups.subset(superpoint) for superpoint in wanted))


def _height_of_all(hierarchy: Hierarchy, wanted: set[int]) -> float:
    """The height at which several wanted superpoints are in one segment; 0 if they never are, or there is only one."""
    heights = hierarchy.heights.unique().tolist()

    def are_together(height: float) -> bool:
        return len(hierarchy.segments_of_superpoints(height)[list(wanted)].unique()) == 1

    place = bisect_left(heights, True, key=are_together) if len(wanted) > 1 else len(heights)
    return heights[place] if place < len(heights) else 0.0


def _superpoints(result: Segmentation, cloud: Tensor, prompts: Prompts, name: str, pixel_name: str) -> set[int]:
    """The superpoints of some points and pixels; the names are those of the arguments."""
    of_point = result.points if result.hierarchy is None else result.hierarchy.superpoint
    found = set() if prompts.points is None else set(of_point[_indices(cloud, prompts.points, name)].tolist())
    count = int(of_point.max()) + 1
    return found | {_superpoint_of_pixel(result, pixel, count, pixel_name) for pixel in prompts.pixels}


def _superpoint_of_pixel(result: Segmentation, pixel: tuple[int, int, int], count: int, name: str) -> int:
    if len(pixel) != 3 or not all(isinstance(value, int) for value in pixel):
        raise TypeError(f"{name}: expected (frame, column, row), got {pixel!r}")
    frame, column, row = pixel
    if not 0 <= frame < len(result.images):
        raise ValueError(f"{name}: expected a frame from 0 to {len(result.images) - 1}, got {frame}")
    image = result.images[frame] if result.hierarchy is None else result.superpoint_images[frame]
    if not (0 <= row < image.shape[0] and 0 <= column < image.shape[1]):
        raise ValueError(f"{name}: expected a pixel of {image.shape[1]} x {image.shape[0]}, got {column}, {row}")
    superpoint = int(image[row, column])
    if not 0 <= superpoint < count:
        raise ValueError(f"{name}: expected a pixel of a segment of the cloud; {column}, {row} is of none")
    return superpoint


def _indices(cloud: Tensor, points: Tensor, name: str) -> Tensor:
    check_dense(points, name)
    count = len(cloud)
    if points.is_floating_point():
        if points.dim() != 2 or points.shape[1] != 3 or not bool(points.isfinite().all()):
            raise ValueError(f"{name}: expected finite positions of shape [K, 3], got {list(points.shape)}")
        nearest = [int((cloud - one).square().sum(1).argmin()) for one in points.to(cloud.dtype)]
        return torch.tensor(nearest, dtype=torch.int64)
    if points.dim() != 1 or points.dtype not in (torch.int64, torch.int32):
        raise TypeError(f"{name}: expected indices of shape [K], int64, got {points.dtype} {list(points.shape)}")
    if len(points) and not 0 <= int(points.min()) <= int(points.max()) < count:
        raise ValueError(f"{name}: expected indices in [0, {count}), got {int(points.min())} to {int(points.max())}")
    return points.long()
