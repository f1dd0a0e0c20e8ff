"""Slow and simple Python versions of the compiled operators: the reference for tests, and easy to read."""

from torchjoint.ops.reference.forest import structured_forest_reference
from torchjoint.ops.reference.graphs import (
    felzenszwalb_reference,
    min_cut_reference,
    quantise_reference,
)
from torchjoint.ops.reference.images import (
    match_pixels_reference,
    outvoted_markers_reference,
    propagate_labels_reference,
    segment_graphs_reference,
    ultrametric_contours_reference,
)
from torchjoint.ops.reference.points import (
    fit_normals_reference,
    line_maxima_reference,
    nearest_neighbors_reference,
    neighbor_edges_reference,
    pair_counts_reference,
    project_reference,
    splat_depth_reference,
    window_overlaps_reference,
)
from torchjoint.ops.reference.regions import (
    ascending_order_reference,
    group_summaries_reference,
    mask_merges_reference,
    merge_regions_reference,
    region_dendrogram_reference,
    region_planes_reference,
)
from torchjoint.ops.reference.text import parse_numbers_reference
from torchjoint.ops.reference.trees import boosted_trees_reference

__all__ = [
    "ascending_order_reference",
    "boosted_trees_reference",
    "felzenszwalb_reference",
    "fit_normals_reference",
    "group_summaries_reference",
    "line_maxima_reference",
    "mask_merges_reference",
    "match_pixels_reference",
    "merge_regions_reference",
    "min_cut_reference",
    "nearest_neighbors_reference",
    "neighbor_edges_reference",
    "outvoted_markers_reference",
    "pair_counts_reference",
    "parse_numbers_reference",
    "project_reference",
    "propagate_labels_reference",
    "quantise_reference",
    "region_dendrogram_reference",
    "region_planes_reference",
    "segment_graphs_reference",
    "splat_depth_reference",
    "structured_forest_reference",
    "ultrametric_contours_reference",
    "window_overlaps_reference",
]
