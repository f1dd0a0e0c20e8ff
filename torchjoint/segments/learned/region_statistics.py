"""Step 6, method learned: statistics of the points of each region: shape, bulge, noise, spacing, colour and texture.

They are computed from points only once, for small superpoints. A region is a union of superpoints, so its statistics
follow from the statistics of its superpoints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchjoint.cloud.normals import dot, length


def sum_by(group: Tensor, values: Tensor, num_groups: int) -> Tensor:
    """Sums of values [n, ...] over groups [n] int64: [G, ...], added in the order of the values."""
    return values.new_zeros(num_groups, *values.shape[1:]).index_add_(0, group, values)


#: Number of points processed at a time, so that intermediate results of large clouds need little memory.
POINTS = 1 << 16
#: Added to the spread of colours before a division by it, units of Lab: about the spread of colours of one surface.
COLOR_NOISE = 2.0


class RegionStatistics(NamedTuple):
    """Statistics of R regions, all float64."""

    size: Tensor  #: [R] points
    mean: Tensor  #: [R, 3] metres
    covariance: Tensor  #: [R, 3, 3] square metres
    normal: Tensor  #: [R, 3] mean of the points' unit normals: short if the surface turns
    noise: Tensor  #: [R] metres, mean
    spacing: Tensor  #: [R] metres, mean
    color: Tensor | None  #: [R, 3] mean Lab colour
    color_variance: Tensor | None  #: [R, 3] of each channel of Lab
    outward: Tensor  #: [R, 3] mean of the oriented unit normals, 0 where a point's normal is not oriented
    bulge: Tensor  #: [R] metres, mean of (point - mean) . outward normal: > 0 if convex, < 0 if hollow
    #: [R] right angles, mean angle between the normals of neighbours; of a union the mean of its parts by their points
    roughness: Tensor
    texture: Tensor | None  #: [R] Lab, mean difference of the colours of neighbours; of a union as the roughness
    colored: Tensor | None = None  #: [R] points with a colour; None: all. Colours and texture are NaN if it is 0

    @classmethod
    def union(cls, parts: Sequence[RegionStatistics]) -> RegionStatistics:
        """The regions of several graphs, one after the other; all graphs have colours, or none has."""
        columns: list[Any] = [None if all_[0] is None else torch.cat(all_) for all_ in zip(*parts, strict=True)]
        return cls(*columns)


class Surface(NamedTuple):
    """The points of a cloud and the properties of their surface."""

    points: Tensor  #: [N, 3] metres
    normals: Tensor  #: [N, 3] unit length
    oriented: Tensor  #: [N] bool, the normal points out of the surface
    noise: Tensor  #: [N] metres
    spacing: Tensor  #: [N] metres
    lab: Tensor | None  #: [N, 3] Lab colours, NaN = none


class InnerEdges(NamedTuple):
    """Some of the edges between neighbouring points of the same region."""

    region: Tensor  #: [E] int64
    turn: Tensor  #: [E] right angles, angle between the normals
    color_step: Tensor | None  #: [E] Lab, difference of the colours, NaN if an end has none


def statistics_of_points(region: Tensor, surface: Surface, inner: Iterable[InnerEdges]) -> RegionStatistics:
    """The statistics of each region of points.

    Args:
        region: [N] int64, 0 ... R - 1, each with at least one point.
        surface: properties of the points.
        inner: edges inside the regions, in blocks; a region without edges has roughness and texture 0.
    """
    size = int(region.max()) + 1
    lab = surface.lab
    count = torch.bincount(region, minlength=size).double()

    def mean_of(values: Callable[[slice], Tensor], count: Tensor = count) -> Tensor:
        """The mean [R, ...] of values, which are given for blocks of successive points: [n, ...]."""
        total = values(slice(0, 0)).double()
        total = total.new_zeros(size, *total.shape[1:])
        for start in range(0, len(region), POINTS):
            at = slice(start, start + POINTS)
            total.index_add_(0, region[at], values(at).double())
        return total / count.view(-1, *[1] * (total.ndim - 1))

    def away(at: slice) -> Tensor:
        return surface.points[at].double() - mean[region[at]]

    def outward(at: slice) -> Tensor:
        return torch.where(surface.oriented[at, None], surface.normals[at].double(), 0.0)

    mean = mean_of(lambda at: surface.points[at])
    color = variance = colored = None
    if lab is not None:
        has_color = lab[:, 0].isfinite()
        known = torch.bincount(region[has_color], minlength=size).double()
        colored = None if has_color.all() else known
        color = mean_of(lambda at: lab[at].nan_to_num(), known)
        variance = mean_of(lambda at: (lab[at].double() - color[region[at]]).square().nan_to_num(), known)
    roughness, texture = _means_of_edges(inner, size)
    if texture is not None and colored is not None:
        texture = torch.where(colored > 0, texture, torch.nan)
    covariance, bulge = mean_of(lambda at: _outer(away(at))), mean_of(lambda at: dot(away(at), outward(at)))
    normal, noise, spacing = (mean_of(of.__getitem__) for of in (surface.normals, surface.noise, surface.spacing))
    out = mean_of(outward)
    return RegionStatistics(
        count, mean, covariance, normal, noise, spacing, color, variance, out, bulge, roughness, texture, colored
    )


def _means_of_edges(inner: Iterable[InnerEdges], size: int) -> tuple[Tensor, Tensor | None]:
    """The mean turn of the edges of each region [R], and the mean known colour step; None without colours."""
    (turn, step), (edges, known_edges) = torch.zeros(2, 2, size, dtype=torch.float64)
    has_steps = False
    for region, turns, steps in inner:
        turn.index_add_(0, region, turns.double())
        edges += torch.bincount(region, minlength=size)
        if steps is not None:
            has_steps, known = True, steps.isfinite()
            step.index_add_(0, region[known], steps[known].double())
            known_edges += torch.bincount(region[known], minlength=size)
    return turn / edges.clamp(min=1), step / known_edges.clamp(min=1) if has_steps else None


def pooled(parts: RegionStatistics, of_part: Tensor, num_regions: int) -> RegionStatistics:
    """The statistics of regions that consist of parts.

    Args:
        parts: statistics of P parts.
        of_part: [P] int64, region of each part, 0 ... R - 1, each with at least one part.
        num_regions: R.
    """
    count = sum_by(of_part, parts.size, num_regions)

    def mean_of(values: Tensor, weight: Tensor = parts.size, total: Tensor = count) -> Tensor:
        ones = [1] * (values.ndim - 1)
        return sum_by(of_part, weight.view(-1, *ones) * values, num_regions) / total.view(-1, *ones)

    mean = mean_of(parts.mean)
    # Squares relative to the mean: sums of squares of coordinates would cancel out for flat regions.
    covariance = mean_of(parts.covariance + _outer(parts.mean - mean[of_part]))
    color = variance = texture = colored = None
    if parts.color is not None and parts.color_variance is not None:
        weight = parts.size if parts.colored is None else parts.colored
        of_colors = sum_by(of_part, weight, num_regions)
        colored = None if parts.colored is None else of_colors

        def mean_of_colors(values: Tensor) -> Tensor:
            return mean_of(values.nan_to_num(), weight, of_colors)  # parts without colours have weight 0

        color = mean_of_colors(parts.color)
        variance = mean_of_colors(parts.color_variance + (parts.color - color[of_part]).square())
        texture = None if parts.texture is None else mean_of_colors(parts.texture)
    normal, noise, spacing = (mean_of(values) for values in (parts.normal, parts.noise, parts.spacing))
    bulge = mean_of(parts.bulge + dot(parts.mean - mean[of_part], parts.outward))
    outward, roughness = mean_of(parts.outward), mean_of(parts.roughness)
    return RegionStatistics(
        count, mean, covariance, normal, noise, spacing, color, variance, outward, bulge, roughness, texture, colored
    )


def covariance_of_unions(regions: RegionStatistics, first: Tensor, second: Tensor) -> Tensor:
    """The covariance of each union of two regions.

    Args:
        regions: statistics of R regions.
        first, second: [B] int64, the two regions of each union.

    Returns:
        [B, 3, 3] float64 square metres.
    """
    one, other = (regions.size[which][:, None, None] for which in (first, second))
    total = one + other
    within = (one * regions.covariance[first] + other * regions.covariance[second]) / total
    return within + one * other / total.square() * _outer(regions.mean[first] - regions.mean[second])


def bulge_of_unions(regions: RegionStatistics, first: Tensor, second: Tensor) -> Tensor:
    """The bulge of each union of two regions, [B] float64 metres; arguments as in :func:`covariance_of_unions`."""
    one, other = regions.size[first], regions.size[second]
    total = one + other
    within = (one * regions.bulge[first] + other * regions.bulge[second]) / total
    between = dot(regions.mean[first] - regions.mean[second], regions.outward[first] - regions.outward[second])
    return within + one * other / total.square() * between


def axes(covariance: Tensor) -> Tensor:
    """Standard deviations along the principal axes, [R, 3] ascending, metres, of covariances [R, 3, 3]."""
    return torch.linalg.eigvalsh(covariance).clamp(min=0).sqrt()


def _outer(vectors: Tensor) -> Tensor:
    return vectors[:, :, None] * vectors[:, None, :]


def color_contrasts(regions: RegionStatistics, one: Tensor, other: Tensor) -> Tensor:
    """Distances [B] of the mean colours of two regions, in multiples of the spread within them; NaN = no colours."""
    if regions.color is None or regions.color_variance is None:
        return torch.full((len(one),), torch.nan, dtype=torch.float64)
    spread = regions.color_variance.sum(1).sqrt()
    return length(regions.color[one] - regions.color[other]) / ((spread[one] + spread[other]) / 2 + COLOR_NOISE)
