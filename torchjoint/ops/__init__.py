"""Compiled torch operators for users of graphs, point clouds and images.

They work on CPU tensors with any strides, are deterministic, release the GIL, and support :func:`torch.compile`. As
with torch's own operators, no other thread may change an argument while one runs: its numbers were checked before.

Each operator has a module with its name. Operators that only this package calls, such as
:mod:`torchjoint.ops.parse_numbers`, also have one; they may change without notice. A slow and simple Python version of
each operator is in ``tests/reference/``.
"""

from torchjoint.ops import _extension  # noqa: F401  must come first: it registers the operators
from torchjoint.ops.connected_components import connected_components
from torchjoint.ops.felzenszwalb import felzenszwalb
from torchjoint.ops.felzenszwalb_image import felzenszwalb_image
from torchjoint.ops.fit_normals import fit_normals
from torchjoint.ops.match_pixels import match_pixels
from torchjoint.ops.merge_regions import merge_regions
from torchjoint.ops.min_cut import min_cut
from torchjoint.ops.nearest_neighbors import nearest_neighbors
from torchjoint.ops.neighbor_edges import neighbor_edges
from torchjoint.ops.project import project
from torchjoint.ops.propagate_labels import propagate_labels
from torchjoint.ops.region_dendrogram import region_dendrogram
from torchjoint.ops.splat_depth import splat_depth
from torchjoint.ops.ultrametric_contours import ultrametric_contours

__all__ = [
    "connected_components",
    "felzenszwalb",
    "felzenszwalb_image",
    "fit_normals",
    "match_pixels",
    "merge_regions",
    "min_cut",
    "nearest_neighbors",
    "neighbor_edges",
    "project",
    "propagate_labels",
    "region_dendrogram",
    "splat_depth",
    "ultrametric_contours",
]
