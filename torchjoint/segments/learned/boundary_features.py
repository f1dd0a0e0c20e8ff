"""Step 6, method learned: the features from which a model judges the boundary between two regions.

No feature has a unit of length. Lengths are divided by the noise, the spacing, or another length of the cloud.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchjoint.cloud.normals import dot, length
from torchjoint.segments.learned.images import image_agreement
from torchjoint.segments.learned.region_statistics import (
    RegionStatistics,
    axes,
    bulge_of_unions,
    color_contrasts,
    covariance_of_unions,
    sum_by,
)
from torchjoint.segments.learned.superpoint_graph import SuperpointGraph

#: Smallest divisor, because regions of one point or of points in a line or plane have widths of 0.
TINY = 1e-30
#: Value of a boundary whose own value is missing, where the boundaries of a region are compared.
TYPICAL = 0.3
#: Added to the texture (units of Lab) and the roughness (right angles) before colour steps and bends are divided by it.
SMALLEST_TEXTURE, SMALLEST_ROUGHNESS = 0.5, 0.02
#: Sides of a boundary: the region with fewer points, and the other.
SIDES = ("small", "large")


def _summary(name: str) -> tuple[str, ...]:
    return tuple(f"{name}_{part}" for part in ("mean", "low", "median", "high"))


def _sides(name: str) -> tuple[str, ...]:
    return tuple(f"{name}_{side}" for side in SIDES)


def _context(name: str) -> tuple[str, ...]:
    return (f"{name}_above_mean_of_small", f"{name}_above_least_of_small", f"{name}_above_least_of_large")


#: Values by the names of features, [B] each.
Columns = dict[str, Tensor]
#: The quantiles of a measure over the edges of a boundary; they follow the mean.
QUANTILES = (0.1, 0.5, 0.9)
_SHAPE = ("noise_ratio", "width", "elongation", "thickness", "flatness")

#: The names of the features. The order is part of a trained model.
FEATURE_NAMES: tuple[str, ...] = (
    *(part for name in ("crease", "bend", "wide_bend", "offset", "larger_offset", "gap") for part in _summary(name)),
    "unoriented_share",
    *_sides("log_points"),
    *_sides("boundary_per_perimeter"),
    "boundary_share",
    *(f"{name}_{side}" for side in SIDES for name in _SHAPE),
    "noise_ratio_union",
    "thickness_union",
    "thickness_growth",
    "extent_ratio",
    "normals_cosine",
    "side_of_large",
    "side_of_small",
    "center_distance",
    "lightness_difference",
    "chroma_difference",
    "color_contrast",
    *_sides("color_spread"),
    *_summary("color_step"),
    "color_step_ratio",
    *_summary("disagreement"),
    *_summary("contour"),
    "seen_share",
    "log_views",
    "agreement",
    "agreement_mean",
    "agreement_deviation",
    "agreement_log_views",
    "overlap_gain",
    "better_overlap",
    "worse_overlap",
    "agreement_range",
    *_context("crease"),
    *_context("disagreement"),
    "perimeter_share_small",
    "log_neighbors_small",
    *_sides("bulge"),
    "bulge_union",
    "bulge_growth",
    *_sides("roughness"),
    "bend_above_roughness",
    *_sides("texture"),
    "color_step_above_texture",
)


class _Sides(NamedTuple):
    """The two regions of each of B boundaries, and how many edges cross it."""

    ends: Tensor  #: [2, B] int64
    small: Tensor  #: [B] int64, the region with fewer points
    large: Tensor  #: [B] int64
    num_edges: Tensor  #: [B] float64


def boundary_features(superpoints: SuperpointGraph) -> Tensor:
    """The features of each boundary between two superpoints: [B, F] float32.

    There is one column for each of FEATURE_NAMES; NaN = missing. The rows have the order of `superpoints.pairs`.
    """
    statistics, images, boundaries = superpoints.statistics, superpoints.images, superpoints.boundaries
    a, b = superpoints.pairs
    a_is_small = statistics.size[a] <= statistics.size[b]
    small, large = torch.where(a_is_small, a, b), torch.where(a_is_small, b, a)
    sides = _Sides(superpoints.pairs, small, large, boundaries.num_edges.double())
    mean = boundaries.averages()
    columns: Columns = {"unoriented_share": mean["unoriented"]}
    for name, (mean_of_edges, quantiles) in boundaries.summaries(QUANTILES).items():
        mean[name] = mean_of_edges
        columns |= zip(_summary(name), (mean[name], *quantiles.unbind(1)), strict=True)
    columns |= _sizes(statistics, sides)
    columns |= _shapes(statistics, small, large)
    columns |= _colors(statistics, small, large)
    columns |= _in_context("crease", mean["hollow"], sides, len(superpoints))
    if images is not None:
        columns |= {"seen_share": mean["seen"], "log_views": mean["views"].log1p()}
        columns |= image_agreement(images, len(superpoints), superpoints.pairs)
        columns |= _in_context("disagreement", mean["disagreement"], sides, len(superpoints))
    columns |= _neighborhood(sides, len(superpoints))
    columns |= _bulges(statistics, small, large)
    bend, rough = columns["bend_median"], statistics.roughness
    columns |= _against_inside("roughness", rough, sides, "bend", bend, SMALLEST_ROUGHNESS)
    if superpoints.typical_color_step is not None:
        step = columns["color_step_median"]
        columns["color_step_ratio"] = step / superpoints.typical_color_step
        if statistics.texture is not None:
            columns |= _against_inside("texture", statistics.texture, sides, "color_step", step, SMALLEST_TEXTURE)
    return _in_order(columns, len(a))


def _in_order(columns: Columns, count: int) -> Tensor:
    """Moves the values to [count, F] float32 in the order of FEATURE_NAMES; NaN for a column that is missing."""
    if unknown := columns.keys() - set(FEATURE_NAMES):
        raise KeyError(f"features: {sorted(unknown)} are not in FEATURE_NAMES")
    values = torch.full((count, len(FEATURE_NAMES)), torch.nan, dtype=torch.float32)
    for number, name in enumerate(FEATURE_NAMES):
        if name in columns:
            values[:, number] = columns.pop(name)  # one by one: less memory
    return values


def _sizes(regions: RegionStatistics, sides: _Sides) -> Columns:
    """Sizes of both regions, and of the boundary relative to them."""
    one, other, num_edges = regions.size[sides.small], regions.size[sides.large], sides.num_edges
    return {
        "log_points_small": one.log(),
        "log_points_large": other.log(),
        "boundary_per_perimeter_small": num_edges / one.sqrt(),
        "boundary_per_perimeter_large": num_edges / other.sqrt(),
        "boundary_share": num_edges / (num_edges + one),
    }


def _shapes(regions: RegionStatistics, small: Tensor, large: Tensor) -> Columns:
    """Shapes of both regions and of their union, and their positions relative to each other."""
    deviations = axes(regions.covariance)
    thin, middle, long = deviations.unbind(1)
    own = {
        "noise_ratio": thin / regions.noise,
        "width": middle / regions.spacing,
        "elongation": long / middle.clamp(min=TINY),
        "thickness": thin / middle.clamp(min=TINY),
        "flatness": length(regions.normal),
    }
    union = axes(covariance_of_unions(regions, small, large))
    between = regions.mean[small] - regions.mean[large]
    normal_small, normal_large = normalize(regions.normal[small], dim=1), normalize(regions.normal[large], dim=1)
    reach = long[small].clamp(min=TINY)
    extent = length(deviations)
    return {
        **{f"{name}_small": values[small] for name, values in own.items()},
        **{f"{name}_large": values[large] for name, values in own.items()},
        "noise_ratio_union": union[:, 0] / torch.maximum(regions.noise[small], regions.noise[large]),
        "thickness_union": union[:, 0] / union[:, 1].clamp(min=TINY),
        "thickness_growth": union[:, 0] / torch.maximum(thin[small], thin[large]).clamp(min=TINY),
        "extent_ratio": torch.minimum(long[small], long[large]) / union[:, 2].clamp(min=TINY),
        "normals_cosine": dot(normal_small, normal_large),
        "side_of_large": dot(between, normal_large) / reach,
        "side_of_small": dot(-between, normal_small) / reach,
        "center_distance": length(between) / (extent[small] + extent[large]),
    }


def _colors(regions: RegionStatistics, small: Tensor, large: Tensor) -> Columns:
    """Differences of the regions' colours, and the spreads of the colours; nothing without colours."""
    if regions.color is None or regions.color_variance is None:
        return {}
    difference = regions.color[small] - regions.color[large]
    spread = regions.color_variance.sum(1).sqrt()
    return {
        "lightness_difference": difference[:, 0].abs(),
        "chroma_difference": difference[:, 1:].square().sum(1).sqrt(),
        "color_contrast": color_contrasts(regions, small, large),
        "color_spread_small": spread[small],
        "color_spread_large": spread[large],
    }


def _in_context(name: str, value: Tensor, sides: _Sides, num_regions: int) -> Columns:
    """The value of each boundary relative to the other boundaries of the same regions.

    Args:
        name: of the value.
        value: [B], a value of each boundary, NaN counts as TYPICAL.
        sides: of the boundaries.
        num_regions: R.

    Returns:
        above the mean of the small region's boundaries, above their minimum, above the large region's minimum.
    """
    value, ends = value.nan_to_num(nan=TYPICAL), sides.ends.flatten()
    weighted = sum_by(ends, (value * sides.num_edges).repeat(2), num_regions)
    mean = weighted / sum_by(ends, sides.num_edges.repeat(2), num_regions)
    least = value.new_zeros(num_regions).scatter_reduce(0, ends, value.repeat(2), "amin", include_self=False)
    return {
        f"{name}_above_mean_of_small": value - mean[sides.small],
        f"{name}_above_least_of_small": value - least[sides.small],
        f"{name}_above_least_of_large": value - least[sides.large],
    }


def _neighborhood(sides: _Sides, num_regions: int) -> Columns:
    """The boundary's share of all edges around the small region, and the log of its number of neighbours."""
    ends = sides.ends.flatten()
    perimeter = sum_by(ends, sides.num_edges.repeat(2), num_regions)
    neighbors = torch.bincount(ends, minlength=num_regions).double()
    return {
        "perimeter_share_small": sides.num_edges / perimeter[sides.small],
        "log_neighbors_small": neighbors[sides.small].log(),
    }


def _bulges(regions: RegionStatistics, small: Tensor, large: Tensor) -> Columns:
    """How far both regions and their union bulge outward, relative to their extents.

    The growth is the union's bulge minus the mean of both, because a whole object bulges more than its sides.
    """
    bulge = regions.bulge / _extent(regions.covariance)
    union = bulge_of_unions(regions, small, large) / _extent(covariance_of_unions(regions, small, large))
    share = regions.size[small] / (regions.size[small] + regions.size[large])
    mean = share * bulge[small] + (1 - share) * bulge[large]
    return {
        "bulge_small": bulge[small],
        "bulge_large": bulge[large],
        "bulge_union": union,
        "bulge_growth": union - mean,
    }


def _extent(covariance: Tensor) -> Tensor:
    """Root mean square distances [R] from the means, metres, of covariances [R, 3, 3]."""
    return torch.diagonal(covariance, dim1=1, dim2=2).sum(1).sqrt().clamp(min=TINY)


def _against_inside(name: str, inside: Tensor, sides: _Sides, step: str, of_boundary: Tensor, least: float) -> Columns:
    """Roughness or texture [R] of both regions, and the boundary's bend or colour step [B] divided by it."""
    one, other = inside[sides.small], inside[sides.large]
    above = of_boundary.double() / (torch.maximum(one, other) + least)
    return {f"{name}_small": one, f"{name}_large": other, f"{step}_above_{name}": above}
