"""Compiled torch operators for the inner loops of all steps: graph segmentation, minimum cuts, projection and others.

They work on CPU tensors with any strides, are deterministic, release the GIL, and support :func:`torch.compile`.
Slow and simple Python versions are in :mod:`torchjoint.ops.reference`.
"""

from torchjoint.ops import _extension  # noqa: F401  must come first: it registers the operators
from torchjoint.ops.ascending_order import ascending_order
from torchjoint.ops.boosted_trees import boosted_trees
from torchjoint.ops.felzenszwalb import felzenszwalb
from torchjoint.ops.felzenszwalb_image import felzenszwalb_image
from torchjoint.ops.fit_normals import fit_normals
from torchjoint.ops.group_summaries import group_summaries
from torchjoint.ops.line_maxima import line_maxima
from torchjoint.ops.mask_merges import mask_merges
from torchjoint.ops.match_pixels import match_pixels
from torchjoint.ops.merge_regions import merge_regions
from torchjoint.ops.min_cut import min_cut
from torchjoint.ops.nearest_neighbors import nearest_neighbors
from torchjoint.ops.neighbor_edges import neighbor_edges
from torchjoint.ops.outvoted_markers import outvoted_markers
from torchjoint.ops.pair_counts import pair_counts
from torchjoint.ops.parse_numbers import parse_numbers
from torchjoint.ops.project import project
from torchjoint.ops.propagate_labels import propagate_labels
from torchjoint.ops.region_dendrogram import region_dendrogram
from torchjoint.ops.region_planes import region_planes
from torchjoint.ops.segment_graphs import segment_graphs
from torchjoint.ops.splat_depth import splat_depth
from torchjoint.ops.structured_forest import structured_forest
from torchjoint.ops.ultrametric_contours import ultrametric_contours
from torchjoint.ops.window_overlaps import window_overlaps

__all__ = [
    "ascending_order",
    "boosted_trees",
    "felzenszwalb",
    "felzenszwalb_image",
    "fit_normals",
    "group_summaries",
    "line_maxima",
    "mask_merges",
    "match_pixels",
    "merge_regions",
    "min_cut",
    "nearest_neighbors",
    "neighbor_edges",
    "outvoted_markers",
    "pair_counts",
    "parse_numbers",
    "project",
    "propagate_labels",
    "region_dendrogram",
    "region_planes",
    "segment_graphs",
    "splat_depth",
    "structured_forest",
    "ultrametric_contours",
    "window_overlaps",
]
