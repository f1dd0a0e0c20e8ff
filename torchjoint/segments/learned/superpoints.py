"""Step 6, method learned: groups a cloud into superpoints, and measures the edges between them, once.

The points are first grouped into small superpoints, which are never split again. Only edges between two superpoints can
be part of a boundary, so only these are measured.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.edge_weights import EDGES, map_edges
from torchjoint.cloud.graph import PointGraph, orient_normals
from torchjoint.cloud.normals import angle_between, dot, is_convex, length, rows_of
from torchjoint.cloud.scales import Scales
from torchjoint.images.boundary import to_lab
from torchjoint.images.segmenter import brightened
from torchjoint.runtime.threads import all_threads
from torchjoint.segments.learned.boundaries import Boundaries
from torchjoint.segments.learned.images import image_colors, segments_of_superpoints, without_dropouts
from torchjoint.segments.learned.masks import cut_by_masks
from torchjoint.segments.learned.occluded_surfaces import find_occlusions
from torchjoint.segments.learned.region_statistics import InnerEdges, Surface, statistics_of_points
from torchjoint.segments.learned.superpoint_graph import SuperpointGraph, give_back_much, masks_of_superpoints, pairs_of
from torchjoint.segments.planes import Planes, combined_costs, crease_costs, one_sided_planes, small_regions
from torchjoint.views.evidence import Evidence
from torchjoint.views.observations import Observations
from torchjoint.views.propagation import disagreement

# The model was trained on boundaries between superpoints made with these numbers. With other numbers its probabilities
# would be wrong, so they are not parameters of the config.

#: Factor on the cost of a crease where the surface is convex.
CONVEX_FACTOR = 0.05
#: Weight of the images' disagreement in an edge's cost.
IMAGE_WEIGHT = 0.3
#: Overlap of two windows at which an image is neutral, r_o of eq. 6.
OVERLAP_THRESHOLD = 0.7
#: Share of a crease's cost that the images' agreement removes.
AGREEMENT = 0.22
#: Weight of the colour step in an edge's cost.
COLOR_WEIGHT = 0.3
#: A colour step of this many median colour steps has the full weight.
LARGE_COLOR_STEP = 6
#: Smallest median colour step by which colour steps are divided, units of Lab, because smaller steps are noise of the
#: camera; first for the costs of edges, then for the model.
SMALLEST_MEDIAN = 1.0
SMALLEST_TYPICAL = 0.5
#: Mean boundary cost up to which points merge into superpoints.
THRESHOLD = 0.05
#: Smallest superpoint, points.
MIN_SIZE = 8
#: Right angles in one radian.
RIGHT_ANGLES = 2 / math.pi


class Colors(NamedTuple):
    """Colours of points and edges; all None without colours."""

    lab: Tensor | None = None  #: [N, 3] Lab, NaN = none
    step: Tensor | None = None  #: [E] units of Lab, distance between the two ends of an edge, NaN = unknown
    median: float | None = None  #: of the steps


def measure_colors(graph: PointGraph, observations: Observations) -> Colors:
    """The colours of the cloud; if it has none, the visible points get colours from the images."""
    if graph.colors is None:
        colors = image_colors(graph.num_points, observations)
    else:
        colors = without_dropouts(graph.colors, graph.edge_index)
    if colors is None:
        return Colors()
    lab = to_lab(brightened(colors).T[None, :, :, None].contiguous())[0, :, :, 0].T
    # Distances [E] of the Lab colours of the two ends of each edge.
    step = map_edges(lambda ends: length(rows_of(lab, ends[0]) - rows_of(lab, ends[1])), graph.edge_index)
    known = step[step.isfinite()]
    return Colors(lab, step, float(known.median()) if len(known) else 0.0)


def build_superpoint_graph(
    graph: PointGraph, scales: Scales, evidence: Evidence, colors: Colors | None = None
) -> SuperpointGraph:
    """Groups the points into superpoints, and measures the edges between the superpoints.

    Args:
        graph: the point graph.
        scales: noise and spacing of the points.
        evidence: of the images.
        colors: of these points, if they are known already.
    """
    give_back_much(graph.num_points)
    normals, oriented = orient_normals(graph, evidence.facing)
    planes = one_sided_planes(graph, small_regions(graph, normals, oriented), normals)
    seen = evidence.observations
    r = disagreement(evidence.views, evidence.overlap_sum, OVERLAP_THRESHOLD) if seen else None
    lab, color_step, median = colors or measure_colors(graph, seen)
    cost = _edge_costs(crease_costs(graph.edge_index, planes, oriented, CONVEX_FACTOR), r, color_step, median)
    with all_threads():
        size = torch.ones(graph.num_points, dtype=torch.int64)
        superpoint = ops.merge_regions(graph.edge_index, cost, size, THRESHOLD, MIN_SIZE)
    superpoint = cut_by_masks(superpoint, graph.edge_index, seen)
    across, pairs, pair = pairs_of(superpoint, graph.edge_index)
    measures = _geometry(graph, graph.edge_index[:, across], normals, oriented, planes, scales)
    give_back_much(graph.num_points)
    if color_step is not None:
        measures["color_step"] = color_step[across]
    if r is not None:
        total, views = evidence.contour_sum[across], evidence.contour_views[across]
        measures["contour"] = torch.where(views > 0, total.float() / (255 * views.clamp(min=1)), torch.nan)
        measures["disagreement"] = torch.where(evidence.views[across] > 0, r[across], torch.nan)
        measures |= {"seen": views > 0, "views": views}
    boundaries = Boundaries.of(pair, pairs.shape[1], measures)
    masks = masks_of_superpoints(superpoint, seen)
    surface = Surface(graph.points, planes.normal, oriented, scales.noise, scales.spacing, lab)
    inner = _inner_edges(superpoint, graph.edge_index, normals, oriented, color_step)
    statistics = statistics_of_points(superpoint, surface, inner)
    return SuperpointGraph(
        superpoint,
        pairs,
        boundaries,
        statistics,
        None if median is None else max(median, SMALLEST_TYPICAL),
        segments_of_superpoints(superpoint, seen) if seen else None,
        masks,
        find_occlusions(superpoint, statistics, graph.points, scales, seen) if seen and masks is None else None,
    )


def _inner_edges(
    superpoint: Tensor, edge_index: Tensor, normals: Tensor, oriented: Tensor, color_step: Tensor | None
) -> Iterator[InnerEdges]:
    """The edges inside the superpoints [N], with the angles between normals [N, 3], and colour steps [E]."""
    for block, (i, j) in enumerate(edge_index.split(EDGES, 1)):
        inner = torch.nonzero(superpoint[i] == superpoint[j]).squeeze(1)
        i, j = i[inner], j[inner]
        turn = angle_between(rows_of(normals, i), rows_of(normals, j), oriented[i] & oriented[j])
        step = None if color_step is None else color_step[EDGES * block :][inner]
        yield InnerEdges(superpoint[i], turn * RIGHT_ANGLES, step)


def _edge_costs(crease: Tensor, r: Tensor | None, color_step: Tensor | None, median: float | None) -> Tensor:
    """Costs [E] of edges from creases, disagreement of the images, and colour steps with their median."""
    cost = crease if r is None else combined_costs(crease, r, IMAGE_WEIGHT, AGREEMENT)
    if color_step is None or median is None:
        return cost
    large = LARGE_COLOR_STEP * max(median, SMALLEST_MEDIAN)
    return cost + COLOR_WEIGHT * (1 - crease) * (color_step / large).clamp(max=1).nan_to_num()


def _geometry(
    graph: PointGraph, edge_index: Tensor, normals: Tensor, oriented: Tensor, planes: Planes, scales: Scales
) -> dict[str, Tensor]:
    """The values of edges [2, C] that geometry gives, [C] each."""
    assert graph.wide_normals is not None  # it has scales
    wide = torch.where(dot(graph.wide_normals, normals)[:, None] < 0, -graph.wide_normals, graph.wide_normals)

    def measured(ends: Tensor) -> dict[str, Tensor]:
        i, j = ends
        both = oriented[i] & oriented[j]
        one, other = rows_of(planes.normal, i), rows_of(planes.normal, j)
        between = rows_of(planes.mean, j) - rows_of(planes.mean, i)
        angle = angle_between(one, other, both) * RIGHT_ANGLES
        crease = torch.where(both & is_convex(between, other - one), -angle, angle)
        off_one, off_other = dot(between, one).abs(), dot(between, other).abs()
        noise, spacing = (torch.maximum(of[i], of[j]) for of in (scales.noise, scales.spacing))
        return {
            "crease": crease,
            "hollow": crease.clamp(min=0),
            "bend": angle_between(rows_of(normals, i), rows_of(normals, j), both) * RIGHT_ANGLES,
            "wide_bend": angle_between(rows_of(wide, i), rows_of(wide, j), both) * RIGHT_ANGLES,
            "offset": torch.minimum(off_one, off_other) / noise,
            "larger_offset": torch.maximum(off_one, off_other) / noise,
            "gap": length(rows_of(graph.points, j) - rows_of(graph.points, i)) / spacing,
            "unoriented": ~both,
        }

    values: dict[str, Tensor] = {}
    for start, ends in enumerate(edge_index.split(EDGES, 1)):  # less memory than all edges at once
        for name, value in measured(ends).items():
            if name not in values:
                values[name] = value.new_empty(edge_index.shape[1])
            values[name][EDGES * start : EDGES * start + len(value)] = value
    return values
