"""The cloud that a method works on: without copies of points, and centred in float64 before it becomes float32.

Copies of points (sampling with replacement, padding by repetition, overlapping scans) tell nothing about the surface,
but they fill the lists of nearest neighbours. So copies are merged. Far from the origin float32 has too few digits for
the differences between neighbours. So coordinates are taken relative to an origin in the cloud. If all points are moved
by an offset, and the sums are exact in float64, all numbers after this step stay bitwise the same.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchjoint.runtime.groups import first_places
from torchjoint.runtime.threads import all_threads, parallel_map
from torchjoint.scene import Cloud

#: A larger rounding error of given float32 coordinates gives a warning; in units of the cloud's spacing.
ROUNDING = 0.25

#: Number of points processed at a time by a thread: their columns fit in its cache.
BLOCK = 1 << 15

#: Odd factors that distribute the bits of coordinates, for hash codes.
_ODD = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], dtype=np.uint64)


#: Bits of each coordinate in the order of points; and the steps that put two zeros between the bits of a number.
_CURVE_BITS = 21
_SPREAD = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def distinct_points(points: Tensor) -> Tensor | None:
    """The number of each point's distinct point: [N] int64, by first appearance; None if all points [N, 3] differ.

    0 and -0 are equal.
    """
    rows = points.numpy()
    blocks = range(0, len(rows), BLOCK)
    code = np.concatenate(parallel_map(lambda start: _codes(rows[start : start + BLOCK]), blocks))
    if np.diff(np.sort(code)).all():
        return None
    rows = rows + 0.0  # -0 becomes 0
    order = np.argsort(code, kind="stable")
    same = (rows[order][1:] == rows[order][:-1]).all(1)
    if ((code[order][1:] == code[order][:-1]) & ~same).any():  # two points have one code: sort by coordinates instead
        order = np.lexsort(rows.T)
        same = (rows[order][1:] == rows[order][:-1]).all(1)
    if not same.any():
        return None
    starts = np.concatenate([[True], ~same])
    first, group = order[starts], np.cumsum(starts) - 1  # both sorts are stable: the first of a group is the least
    number = np.empty(len(first), dtype=np.int64)
    number[np.argsort(first)] = np.arange(len(first))
    of_point = np.empty(len(rows), dtype=np.int64)
    of_point[order] = number[group]
    return torch.from_numpy(of_point)


def _codes(rows: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.uint64]:
    """A hash code for each row [N, 3]; equal rows have equal codes. Codes can be sorted faster than rows."""
    columns = np.ascontiguousarray(rows.T) + 0.0  # -0 becomes 0
    bits = columns.view(np.uint32 if rows.dtype == np.float32 else np.uint64).astype(np.uint64)
    x, y, z = (bits ^ (bits >> np.uint64(29))) * _ODD[:, None]
    return x ^ (y >> np.uint64(7)) ^ (z << np.uint64(9)) ^ ((x + y + z) >> np.uint64(31))


def order_of_points(points: Tensor) -> Tensor:
    """The order of distinct points [N, 3] along a curve through space: [N] int64, whatever their given order.

    The curve visits all cells of an octree (Z-order), so that neighbours are close to each other in memory, too.
    """
    rows = points.numpy()
    columns = np.ascontiguousarray(rows.T)  # several times as fast as the extremes of rows
    low, extent = columns.min(1, keepdims=True).astype(np.float64), float(np.ptp(columns, 1).max())
    scale = (2**_CURVE_BITS - 1) / extent if extent > 0 else 0.0

    def codes(start: int) -> npt.NDArray[np.int64]:
        cell = ((columns[:, start : start + BLOCK] - low) * scale).astype(np.int64)
        for shift, mask in _SPREAD:
            cell = (cell | cell << shift) & mask
        return cell[0] << 2 | cell[1] << 1 | cell[2]  # the three coordinates' bits alternate

    code = np.concatenate(parallel_map(codes, range(0, len(rows), BLOCK)))
    with all_threads():
        in_order, order = torch.from_numpy(code).sort()
    if (in_order[1:] == in_order[:-1]).any():  # two points in one cell: their coordinates decide
        return torch.from_numpy(np.lexsort((*rows.T, code)))
    return order


def merged_points(cloud: Cloud, of_point: Tensor, count: int) -> Cloud:
    """The cloud with one point for each group of points: the means of positions, colours and normals.

    Args:
        cloud: N points.
        of_point: [N] int64, the group of each point, 0 ... `count` - 1; no group is empty.
        count: number of groups.
    """
    size = torch.bincount(of_point, minlength=count).double()[:, None]

    def mean(values: Tensor) -> Tensor:
        return torch.zeros(count, 3, dtype=torch.float64).index_add_(0, of_point, values.double()) / size

    colors, normals = None if cloud.colors is None else mean(cloud.colors).float().clamp(0, 1), None
    if cloud.normals is not None:
        normals, own = mean(cloud.normals), cloud.normals[first_places(of_point)].double()
        opposite = normals.square().sum(1, keepdim=True) < 1e-6  # the mean of opposite normals has no direction
        equal = (normals == own).all(1, keepdim=True)  # keep them bit by bit
        normals = torch.where(opposite | equal, own, normalize(normals, dim=1)).float()
    return Cloud(mean(cloud.points).to(cloud.points.dtype), colors, normals)


def points_within(points: Tensor, side: float) -> Tensor:
    """The cube in which each point lies, in a grid of cubes: [N] int64, numbered by first appearance.

    Args:
        points: [N, 3] metres; the grid starts at their smallest coordinates.
        side: side of a cube, metres, > 0.
    """
    cell = distinct_points(((points.double() - points.double().amin(0)) / side).floor())
    return torch.arange(len(points)) if cell is None else cell


def without_copies(cloud: Cloud) -> tuple[Cloud, Tensor | None]:
    """The cloud without copies, and its point for each given point, [N] int64; None: all points differ."""
    found = distinct_points(cloud.points)
    if found is None:
        return cloud, None
    # The mean of equal float64 coordinates may be another number.
    return replace(merged_points(cloud, found, int(found.max()) + 1), points=cloud.points[first_places(found)]), found


def _lower_median(values: Tensor) -> float:
    """The median of values [N]; if two values are in the middle, the lower one."""
    middle = (len(values) - 1) // 2
    return float(np.partition(values.numpy(), middle)[middle])  # several times as fast as torch's


class LocalFrame(NamedTuple):
    """The coordinates that a method works in: those of the world, relative to an origin."""

    origin: Tensor  #: [3] float64 metres, in the world
    step: float  #: metres; translations of poses are multiples of it, 0 = any

    @classmethod
    def of(cls, points: Tensor) -> LocalFrame:
        """The frame of a cloud of distinct points [N, 3].

        For each axis the origin is the lower median of the coordinates. This is a coordinate of the cloud, so it moves
        exactly with the cloud, and few outliers do not change it. The step is about the resolution of float32
        coordinates in the cloud.
        """
        columns = points.unbind(1)
        medians = map(_lower_median, columns) if len(points) <= BLOCK else parallel_map(_lower_median, columns)
        origin = torch.tensor(list(medians), dtype=torch.float64)
        extent = float((points.amax(0).double() - points.amin(0).double()).max())
        return cls(origin, 2.0 ** (math.frexp(extent)[1] - 24) if extent > 0 else 0.0)

    @classmethod
    def of_world(cls) -> LocalFrame:
        """The frame whose coordinates are those of the world."""
        return cls(torch.zeros(3, dtype=torch.float64), 0.0)

    def cloud(self, cloud: Cloud) -> Cloud:
        """The cloud in float32 coordinates of this frame."""
        if cloud.points.dtype == torch.float32 and not self.origin.any():
            return cloud
        blocks = cloud.points.split(BLOCK)
        points = torch.cat(parallel_map(lambda block: (block.double() - self.origin).float(), blocks))
        return replace(cloud, points=points)

    def pose(self, world_to_camera: Tensor) -> Tensor:
        """The pose [4, 4] float64 that maps points of this frame to the camera.

        Far from the world's origin float64 makes errors that are much smaller than `step`; rounding removes them.
        """
        pose = world_to_camera.double().clone()
        pose[:3, 3] += pose[:3, :3] @ self.origin
        if self.step > 0:
            pose[:3, 3] = (pose[:3, 3] / self.step).round() * self.step
        return pose


def composed(first: Tensor | None, second: Tensor | None) -> Tensor | None:
    """The map of points that applies two maps one after the other; None is the identity."""
    return second if first is None else first if second is None else second[first]


def warn_of_rounding(points: Tensor, spacing: Tensor) -> None:
    """Warns if coordinates were rounded to a step near the spacing, as float32 does it far from the origin.

    Args:
        points: [N, 3], the given points.
        spacing: [M] metres, spacing of the points without copies.
    """
    if len(spacing) < 2:
        return
    step, typical = float(points.abs().max()) * torch.finfo(points.dtype).eps, _lower_median(spacing)
    if len(points) > 2 * len(spacing):  # so many copies may come from rounding before
        step = max(step, _lower_median(torch.cat([axis.unique().diff() for axis in points.unbind(1)])))
    if step > ROUNDING * typical:
        told = f"points: coordinates keep only {step:.2g} m, but neighbours are {typical:.2g} m apart"
        warnings.warn(f"{told}; pass float64, or subtract an offset in float64, before they are rounded", stacklevel=2)


def local_cloud(cloud: Cloud, frame: LocalFrame, merge_within: float = 0.0) -> tuple[Cloud, Tensor]:
    """The cloud in float32 coordinates of a local frame, without copies, in an order that only its points decide.

    Args:
        cloud: N points.
        frame: the local frame.
        merge_within: metres; points in one cube with this side are merged; 0: only copies are merged.

    Returns:
        the cloud; and [N] int64, its point for each given point.
    """
    local, of_point = frame.cloud(cloud), None
    if not torch.equal(local.points.to(cloud.points.dtype), cloud.points):
        local, of_point = without_copies(local)  # rounding makes copies
    if merge_within > 0:
        merged = points_within(local.points, merge_within)
        local, of_point = merged_points(local, merged, int(merged.max()) + 1), composed(of_point, merged)
    order = order_of_points(local.points)
    place = torch.empty_like(order)
    place[order] = torch.arange(len(order))
    return local.selected(order), place if of_point is None else place[of_point]
