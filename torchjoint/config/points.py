"""Parameters of steps 3 and 6: the graph of the points, and its segments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torchjoint.config.parameter import Stage, parameter


def reach_parameter() -> Any:
    """Declares `reach`, which point graphs of the joint method and of superpoints share."""
    return parameter(
        0.0, "where all of a point's neighbours lie closer than this, they are sought among half of the points, "
        "a quarter or an eighth, so that a LiDAR's beams are joined to one another; 0: just the nearest", unit="m",
        low=0, sensible="0 for depth cameras, 0.3-0.7 for LiDAR",
    )  # fmt: skip


@dataclass(frozen=True)
class PointGraphConfig(Stage):
    """Step 3, eq. 3-4: the k-nearest-neighbour graph of the cloud and its geometric weight."""

    neighbors: int = parameter(16, "K, neighbours of a point in the graph", low=1, high=200, sensible="8-30")
    normal_neighbors: int = parameter(
        45, "neighbours a normal is fitted to; more suits noisy clouds and rounds edges", low=3, high=500,
        sensible="10-80",
    )  # fmt: skip
    reach: float = reach_parameter()
    plane_neighbors: int = parameter(
        45, "regions: neighbours that a point's one-sided plane is fitted to, of which those in its own region count",
        low=3, high=500, sensible="20-60, more for noisy clouds",
    )  # fmt: skip
    distance_weight: float = parameter(
        0.2, "edges: w_d, weight of the distance of two points; separates sparse from dense", unit="1/m", low=0,
        sensible="0-10",
    )  # fmt: skip
    angle_weight: float = parameter(1.0, "edges: w_theta, weight of the angle of two normals", unit="1/rad", low=0)
    convex_factor: float = parameter(
        0.06,
        "the angle counts only this much where the surface is convex: objects mostly are, and the borders between "
        "them concave; 1 is the paper's letter",
        low=0,
        high=1,
        sensible="0.1-1",
    )
    color_weight: float = parameter(
        0.0, "edges: weight of the RGB distance of two points; needs Scene.colors", low=0, sensible="0-1"
    )


@dataclass(frozen=True)
class PointSegmentsConfig(Stage):
    """Step 6: segments of the point graph."""

    method: str = parameter(
        "regions", "regions: small ones, merged by what lies on their whole border; edges: as in the paper, "
        "Felzenszwalb-Huttenlocher on eq. 3; scan: of a LiDAR, z up and the sensor at the origin, its ground and what "
        "stands on it, in which images have no say", choices=("regions", "edges", "scan"), renamed={"sweep": "scan"},
    )  # fmt: skip
    scale: float = parameter(4.5, "edges: k; more gives larger segments", unit="weight x points", low=0)
    min_size: int = parameter(120, "edges: smaller segments are joined to a neighbour", unit="points", low=0)
