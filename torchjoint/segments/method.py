"""Step 6: which method segments a cloud, if the config leaves it to the cloud; and what was measured, in one line."""

from __future__ import annotations

from torch import Tensor

from torchjoint.cloud.graph import PointGraph
from torchjoint.config import Config
from torchjoint.scene import Scene
from torchjoint.segments.scan.recognition import find_rings


def with_method(config: Config, points: Tensor) -> Config:
    """The config with a definite method of step 6: auto becomes scan for a scan of a turning LiDAR, else learned.

    Args:
        config: all parameters.
        points: [N, 3] metres; of a scan: z up, the sensor at the origin.
    """
    if config.point_segments.method != "auto":
        return config
    method = "learned" if find_rings(points) is None else "scan"
    return config.replace({"point_segments": {"method": method}})


def describe(cloud: Scene, graph: PointGraph, config: Config) -> str:
    """One line that says what was measured of a cloud, and which method segments it.

    Args:
        cloud: as it came.
        graph: of the cloud.
        config: with the method of step 6 that :func:`with_method` returned.
    """
    method, what = config.point_segments.method, f"points: {len(cloud.points)}"
    if graph.num_points < len(cloud.points):
        what += f", much denser than their noise: thinned to {graph.num_points}"
    if method == "scan":
        rings = find_rings(graph.points)
        what += f" of a turning LiDAR with about {rings.number} rings" if rings else ", no rings of a LiDAR found"
    elif graph.scales is not None:
        spacing, noise = (1000 * float(of_points.median()) for of_points in (graph.scales.spacing, graph.scales.noise))
        normals = "given" if graph.has_given_normals else f"from {graph.scales.normal_neighbors} neighbours"
        what += f", spacing {spacing:.2g} mm, noise {noise:.2g} mm, normals {normals}"
    if method == "learned" and graph.colors is None:
        what += f", {'no colours' if cloud.colors is None else 'all of one colour'} (those of images count)"
    return f"{what}; step 6 by method {method}"
