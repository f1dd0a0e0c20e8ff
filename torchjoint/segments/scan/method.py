"""Step 6, method scan: segments one scan of a LiDAR into ground and objects, without images."""

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor

from torchjoint.cloud.graph import PointGraph, build_edgeless_graph
from torchjoint.cloud.local import LocalFrame, local_cloud
from torchjoint.cloud.neighbors import SPACING_NEIGHBORS
from torchjoint.config import Config, ScanConfig
from torchjoint.ops.internal import local_spacing
from torchjoint.runtime.threads import all_threads, one_thread_per_operation, parallel_map
from torchjoint.scene import Cloud, Hierarchy
from torchjoint.scene.checks import as_points
from torchjoint.segments.scan.cut import falls_apart, gain_of_parts, levels_of, load_scan_model
from torchjoint.segments.scan.gaps import Gaps
from torchjoint.segments.scan.ground import GROUND_HEIGHT, ground_below, grow_ground
from torchjoint.segments.scan.recognition import Directions, Rings, directions, find_rings, look_for_scan
from torchjoint.segments.scan.tree import Tree, grow_tree
from torchjoint.views.evidence import Evidence

#: Largest mean distance of a point of the ground to its nearest neighbours, in allowed gaps: the ground is denser than
#: what rises from it far away. Points with a larger one than the gap itself may be outliers, from which nothing rises.
GROUND_GAP = 0.6

#: The part of the allowed gap that grows with range must span at least this many steps between rings.
RINGS_IN_GAP = 4

#: No LiDAR on the ground sees farther, metres.
FAR = 1000.0

#: The rings of a scan; None: it has none; "search": they are searched for.
GivenRings = Rings | Literal["search"] | None


def segment_levels(
    points: Tensor, config: ScanConfig | None = None, rings: GivenRings = "search", model: Path | None = None
) -> Hierarchy:
    """The segments of one scan of a LiDAR, without colours or normals, at all levels.

    Points on the ground (:func:`~torchjoint.segments.scan.ground.grow_ground`) are one segment. All other points
    are connected with their nearest neighbours over at most a share of the gap that is allowed at the range of the
    nearer one, `gap` + `gap_growth` r (:class:`~torchjoint.segments.scan.gaps.Gaps`). Larger shares connect more, so
    that the connected parts are a tree (:func:`~torchjoint.segments.scan.tree.grow_tree`). For each node, boosted trees
    say whether it is a thing, or its parts are (:func:`~torchjoint.segments.scan.cut.falls_apart`). Distances are those
    after the rings were moved closer together (:func:`with_near_rings`).

    Args:
        points: [N, 3] metres, z up, the sensor at the origin.
        config: see :class:`ScanConfig`.
        rings: of the scan; None: it has none; "search": they are searched for.
        model: file of another model than the packaged one.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """
    with torch.no_grad(), one_thread_per_operation():
        tree = scan_tree(points, config or ScanConfig(), rings)
        return levels_of(tree, falls_apart(tree, gain_of_parts(tree, load_scan_model(model))), len(points))


def scan_tree(points: Tensor, config: ScanConfig, rings: GivenRings) -> Tree:
    """The tree of all points that are not on the ground; arguments and errors are those of :func:`segment_levels`."""
    gaps, on_ground, height = scan_gaps(points, config, rings)
    return grow_tree(gaps, ~on_ground, points.float(), height, config.min_size)


def scan_gaps(points: Tensor, config: ScanConfig, rings: GivenRings) -> tuple[Gaps, Tensor, Tensor]:
    """The points over the profiles of the ground, with their neighbours; [N] bool, all points on the ground; heights.

    Heights [N] float64 are those above the profiles. Arguments and errors are those of :func:`segment_levels`.
    """
    points = as_points(points).float()
    seen, height = directions(points), points[:, 2].double()
    if len(points) and (away := float(seen.range.min())) > FAR:
        told = f"method scan expects the sensor at the origin, {away:.3g} m from here: subtract its place"
        warnings.warn(told, stacklevel=2)
    gap = config.gap + config.gap_growth * seen.range
    with all_threads():
        spacing = local_spacing(points, gap, GROUND_GAP, SPACING_NEIGHBORS)
    parts: list[Callable[[], Any]] = [partial(ground_below, seen, height, _or_all(spacing == 0))]
    if rings == "search":
        parts.append(partial(find_rings, points, seen))
    below, *found = parallel_map(lambda part: part(), parts)
    height, rings = height - below, found[0] if rings == "search" else rings
    drawn = with_near_rings(points, seen, rings, config)
    gaps = Gaps.of(drawn, gap, torch.nonzero(height >= GROUND_HEIGHT).flatten())
    return gaps, grow_ground(points, height, seen, gaps, config, _or_all(spacing < torch.inf)), height


def _or_all(used: Tensor) -> Tensor | None:
    return used if bool(used.any()) else None


def with_near_rings(points: Tensor, seen: Directions, rings: Rings | None, config: ScanConfig) -> Tensor:
    """Scales the elevations of points down, so that the step between two rings is a quarter of the gap's growth.

    With few beams, two rings are farther apart than two objects side by side. After the scaling, one gap is large
    enough to join rings and small enough to separate such objects. If the rings are already near enough, or unknown,
    the points are returned unchanged.

    Args:
        points: [N, 3] metres, z up, the sensor at the origin.
        seen: their directions.
        rings: the rings of the scan; None: unknown.
        config: gap_growth.
    """
    if rings is None or config.gap_growth >= RINGS_IN_GAP * rings.step:
        return points
    elevation = seen.elevation * (config.gap_growth / (RINGS_IN_GAP * rings.step))
    flat = seen.range * elevation.cos()
    x, y, z = flat * seen.azimuth.cos(), flat * seen.azimuth.sin(), seen.range * elevation.sin()
    return torch.stack([x, y, z], dim=1).float()


def prepare(cloud: Cloud, config: Config, merge_within: float) -> PointGraph:
    """The points alone, in the given coordinates, because the sensor is at the origin. Merges only copies."""
    if merge_within > 0:
        warnings.warn("merge_within: without effect here, where method scan segments the points", stacklevel=4)
    world = LocalFrame.of_world()
    local, of_cloud = local_cloud(cloud.without_constants(), world)
    return build_edgeless_graph(local).of(world, of_cloud)


def segment(
    graph: PointGraph, evidence: Evidence, config: Config, rings: GivenRings = "search", model: Path | None = None
) -> Hierarchy:
    """The ground and the objects on it at all levels; `rings` and `model` as for :func:`segment_levels`."""
    return segment_levels(graph.points, config.scan, rings, model)


def measured(graph: PointGraph) -> str:
    """The rings of the scan, or how sure it is that it is one."""
    return str(look_for_scan(graph.points))
