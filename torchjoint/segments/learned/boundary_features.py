"""Step 6, method learned: the features from which a model judges the boundary between two regions.

No feature has a unit of length. Lengths are divided by the noise, the spacing, or another length of the cloud.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchjoint.cloud._vectors import dot, length
from torchjoint.runtime.threads import parallel_map
from torchjoint.segments.learned.images import image_agreement
from torchjoint.segments.learned.piece_graph import PieceGraph
from torchjoint.segments.learned.region_statistics import (
    Measure,
    RegionStatistics,
    axes,
    bulge_of_unions,
    color_contrasts,
    covariance_of_unions,
    pooled,
    sum_by,
    summarize,
)

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


def _context(name: str) -> tuple[str, ...]:
    return (f"{name}_above_mean_of_small", f"{name}_above_least_of_small", f"{name}_above_least_of_large")


#: Values by the names of features, [B] each.
Columns = dict[str, Tensor]
#: Measures of edges of which a boundary has a mean and quantiles.
SUMMARIES = (
    "crease", "bend", "wide_bend", "offset", "larger_offset", "gap", "color_step", "disagreement", "contour"
)  # fmt: skip
_SHAPE = ("noise_ratio", "width", "elongation", "thickness", "flatness")

#: The names of the features. The order is part of a trained model.
FEATURE_NAMES: tuple[str, ...] = (
    *_summary("crease"),
    *_summary("bend"),
    *_summary("wide_bend"),
    *_summary("offset"),
    *_summary("larger_offset"),
    *_summary("gap"),
    "unoriented_share",
    "log_points_small",
    "log_points_large",
    "boundary_per_perimeter_small",
    "boundary_per_perimeter_large",
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
    "color_spread_small",
    "color_spread_large",
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
    "bulge_small",
    "bulge_large",
    "bulge_union",
    "bulge_growth",
    "roughness_small",
    "roughness_large",
    "bend_above_roughness",
    "texture_small",
    "texture_large",
    "color_step_above_texture",
)


class BoundaryFeatures(NamedTuple):
    """The features of B boundaries, in the order of their pairs."""

    pairs: Tensor  #: [2, B] int64, regions a < b
    values: Tensor  #: [B, F] float32, one column for each of FEATURE_NAMES, NaN = missing
    of_edge: Tensor  #: [C] int64, boundary of each edge of PieceGraph.edges, -1 = inside a region


class _Boundaries(NamedTuple):
    """The boundaries between R regions."""

    of_piece: Tensor  #: [P] int64, region of each piece
    num_regions: int  #: R
    pairs: Tensor  #: [2, B] int64
    edges: Tensor  #: [c] int64, the edges of PieceGraph.edges that cross a boundary
    of_edge: Tensor  #: [c] int64, boundary of each of these edges
    of_any_edge: Tensor  #: [C] int64, boundary of each edge of PieceGraph.edges, -1 = inside a region
    num_edges: Tensor  #: [B] float64

    def summary(self, measure: Measure) -> Tensor:
        return summarize(measure, self.of_any_edge, self.pairs.shape[1])

    def mean(self, values: Tensor) -> Tensor:
        """Means [B] float64 over the edges of each boundary of values [C]."""
        return sum_by(self.of_edge, values.index_select(0, self.edges).double(), self.pairs.shape[1]) / self.num_edges


def boundary_features(pieces: PieceGraph, region: Tensor) -> BoundaryFeatures:
    """The features of each boundary between two regions.

    Args:
        pieces: the pieces, and the edges between them.
        region: [N] int64, 0 ... R - 1, region of each point; each region is a union of pieces.
    """
    boundaries = _find_boundaries(pieces, region)
    statistics = pooled(pieces.statistics, boundaries.of_piece, boundaries.num_regions)
    a, b = boundaries.pairs
    a_is_small = statistics.size[a] <= statistics.size[b]
    small, large = torch.where(a_is_small, a, b), torch.where(a_is_small, b, a)
    edges, images = pieces.edges, pieces.images
    known = [name for name in SUMMARIES if getattr(edges, name) is not None]
    averaged = [edges.crease.values.clamp(min=0), edges.unoriented]
    averaged += [] if edges.views is None else [edges.views > 0, edges.views]
    crease, unoriented, *of_views = parallel_map(boundaries.mean, averaged)
    columns: Columns = {"unoriented_share": unoriented}
    for name, summary in zip(
        known, parallel_map(lambda name: boundaries.summary(getattr(edges, name)), known), strict=True
    ):
        columns |= zip(_summary(name), summary.unbind(1), strict=True)
    columns |= _sizes(statistics, small, large, boundaries.num_edges)
    columns |= _shapes(statistics, small, large)
    columns |= _colors(statistics, small, large)
    columns |= _in_context("crease", crease, boundaries, small, large)
    if images is not None and edges.views is not None:
        columns |= {"seen_share": of_views[0], "log_views": of_views[1].log1p()}
        columns |= image_agreement(images, boundaries.of_piece, boundaries.num_regions, boundaries.pairs)
        columns |= _in_context("disagreement", columns["disagreement_mean"], boundaries, small, large)
    columns |= _neighborhood(boundaries, small)
    columns |= _bulges(statistics, small, large)
    columns |= _roughness(statistics, small, large, columns["bend_median"])
    if edges.color_step is not None:
        columns["color_step_ratio"] = columns["color_step_median"] / (pieces.typical_color_step or 1)
        columns |= _textures(statistics, small, large, columns["color_step_median"])
    return BoundaryFeatures(boundaries.pairs, _in_order(columns, len(a)), boundaries.of_any_edge)


def _in_order(columns: Columns, count: int) -> Tensor:
    """The values [count, F] float32 in the order of FEATURE_NAMES; NaN for a column that is missing."""
    if unknown := columns.keys() - set(FEATURE_NAMES):
        raise KeyError(f"features: {sorted(unknown)} are not in FEATURE_NAMES")
    missing = torch.full((count,), torch.nan, dtype=torch.float32)
    return torch.stack([columns[name].float() if name in columns else missing for name in FEATURE_NAMES], 1)


def _find_boundaries(pieces: PieceGraph, region: Tensor) -> _Boundaries:
    of_piece = pieces.regions_of_pieces(region)
    num_regions = int(region.max()) + 1
    first, second = of_piece[pieces.pairs]
    across = first != second
    key = torch.minimum(first, second) * num_regions + torch.maximum(first, second)
    key, of_crossing = torch.unique(key[across], return_inverse=True)
    of_pair = torch.full((len(first),), -1, dtype=torch.int64)
    of_pair[across] = of_crossing
    of_any_edge = of_pair.index_select(0, pieces.edges.pair)  # several times as fast as brackets
    edges = torch.nonzero(of_any_edge >= 0).squeeze(1)
    of_edge = of_any_edge.index_select(0, edges)
    num_edges = torch.bincount(of_edge, minlength=len(key)).double()
    pairs = torch.stack([key // num_regions, key % num_regions])
    return _Boundaries(of_piece, num_regions, pairs, edges, of_edge, of_any_edge, num_edges)


def _sizes(regions: RegionStatistics, small: Tensor, large: Tensor, num_edges: Tensor) -> Columns:
    """Sizes of both regions, and of the boundary relative to them."""
    one, other = regions.size[small], regions.size[large]
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


def _in_context(name: str, value: Tensor, boundaries: _Boundaries, small: Tensor, large: Tensor) -> Columns:
    """The value of each boundary relative to the other boundaries of the same regions.

    Args:
        name: of the value.
        value: [B], a value of each boundary, NaN counts as TYPICAL.
        boundaries: the boundaries.
        small, large: [B] int64, the regions of each boundary.

    Returns:
        above the mean of the small region's boundaries, above their minimum, above the large region's minimum.
    """
    value = value.nan_to_num(nan=TYPICAL)
    ends = boundaries.pairs.flatten()
    weighted = sum_by(ends, (value * boundaries.num_edges).repeat(2), boundaries.num_regions)
    mean = weighted / sum_by(ends, boundaries.num_edges.repeat(2), boundaries.num_regions)
    least = value.new_zeros(boundaries.num_regions)
    least = least.scatter_reduce(0, ends, value.repeat(2), "amin", include_self=False)
    return {
        f"{name}_above_mean_of_small": value - mean[small],
        f"{name}_above_least_of_small": value - least[small],
        f"{name}_above_least_of_large": value - least[large],
    }


def _neighborhood(boundaries: _Boundaries, small: Tensor) -> Columns:
    """The boundary's share of all edges around the small region, and the log of its number of neighbours."""
    ends = boundaries.pairs.flatten()
    perimeter = sum_by(ends, boundaries.num_edges.repeat(2), boundaries.num_regions)
    neighbors = torch.bincount(ends, minlength=boundaries.num_regions).double()
    return {
        "perimeter_share_small": boundaries.num_edges / perimeter[small],
        "log_neighbors_small": neighbors[small].log(),
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


def _roughness(regions: RegionStatistics, small: Tensor, large: Tensor, bend: Tensor) -> Columns:
    """Roughness of both regions, and the boundary's bend [B] divided by it."""
    one, other = regions.roughness[small], regions.roughness[large]
    above = bend.double() / (torch.maximum(one, other) + SMALLEST_ROUGHNESS)
    return {"roughness_small": one, "roughness_large": other, "bend_above_roughness": above}


def _textures(regions: RegionStatistics, small: Tensor, large: Tensor, color_step: Tensor) -> Columns:
    """Texture of both regions, and the boundary's colour step [B] divided by it; nothing without colours."""
    if regions.texture is None:
        return {}
    one, other = regions.texture[small], regions.texture[large]
    above = color_step.double() / (torch.maximum(one, other) + SMALLEST_TEXTURE)
    return {"texture_small": one, "texture_large": other, "color_step_above_texture": above}
