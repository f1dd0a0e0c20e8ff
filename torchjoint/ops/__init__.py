"""Compiled torch operators for users of graphs, point clouds and images.

They work on CPU tensors with any strides, are deterministic, release the GIL, and support :func:`torch.compile`. As
with torch's own operators, no other thread may change an argument while one runs: its numbers were checked before.

Operators that only this package calls are in :mod:`torchjoint.ops.internal`; they may change without notice. A slow and
simple Python version of each operator is in ``tests/reference/``.
"""

from torchjoint.ops.graphs import connected_components, felzenszwalb, merge_regions, min_cut, region_dendrogram
from torchjoint.ops.images import propagate_labels, ultrametric_contours
from torchjoint.ops.points import fit_normals, nearest_neighbors, neighbor_edges, project, splat_depth

__all__ = [
    "connected_components", "felzenszwalb", "fit_normals", "merge_regions", "min_cut", "nearest_neighbors",
    "neighbor_edges", "project", "propagate_labels", "region_dendrogram", "splat_depth", "ultrametric_contours",
]  # fmt: skip
