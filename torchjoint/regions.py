"""Step 6, regions: small regions that reach across no object, and the plane on which each of their points lies."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torchjoint import ops
from torchjoint.config import PointGraphConfig
from torchjoint.point_graph import PointGraph, geometric_weights
from torchjoint.region_config import RegionsConfig
from torchjoint.segmentator import segmentator_turn
from torchjoint.threads import all_threads

#: Points that a plane is fitted to, at the least.
MIN_POINTS = 6


class Planes(NamedTuple):
    """The plane of each point and those of its neighbours that lie in its own region."""

    mean: Tensor  #: [N, 3] metres
    normal: Tensor  #: [N, 3] unit length, on the side of the point's own normal


def small_regions(
    graph: PointGraph, normals: Tensor, oriented: Tensor, disagreement: Tensor | None, config: RegionsConfig
) -> Tensor:
    """Groups points that nothing parts: neither shape, nor colour, nor images.

    Edges weigh 1 - n_i . n_j, squared where the surface is convex, and what colours and images add.

    Args:
        normals: [N, 3] unit length.
        oriented: [N] bool, whether a normal's sign is known.
        disagreement: [E], r of eq. 6; None where no image is asked.

    Returns:
        [N] int64 regions 0, 1, ...
    """
    weighed = PointGraphConfig(
        distance_weight=0, angle_weight=1, color_weight=0 if graph.colors is None else config.color_weight
    )
    weights = geometric_weights(
        graph.points, graph.edge_index, normals, oriented, weighed, graph.colors, segmentator_turn
    )
    if disagreement is not None:
        weights = weights + config.image_weight * disagreement
    return ops.felzenszwalb(graph.edge_index, weights, graph.num_points, config.scale, config.min_size)


def one_sided_planes(graph: PointGraph, region: Tensor, normals: Tensor) -> Planes:
    """Planes that no longer look across the border which they are to find: creases become sharp again.

    Args:
        region: [N] int64.
        normals: [N, 3], kept where fewer than MIN_POINTS of the neighbours are in a point's own region.
    """
    with all_threads():
        return Planes(*ops.region_planes(graph.points, graph.neighbors, region, normals, MIN_POINTS))
