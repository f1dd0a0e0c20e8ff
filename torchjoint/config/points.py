"""Parameters of steps 3 and 6: the graph of the points, and the method that segments it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torchjoint.config.parameter import Stage, parameter


def reach_parameter() -> Any:
    """Declares `reach`, a parameter of the point graph of both the joint method and superpoints."""
    return parameter(
        0.0, "if all neighbours of a point are closer than this, search them among half, a quarter or an eighth of the "
        "points instead, so that edges connect neighbouring LiDAR beams; more connects sparser scans and loses detail; "
        "0: always the nearest neighbours", unit="m", low=0, sensible="0 for depth cameras, 0.3-0.7 for LiDAR",
    )  # fmt: skip


@dataclass(frozen=True)
class PointGraphConfig(Stage):
    """Step 3, eq. 3-4, all methods but scan: the k-nearest-neighbour graph and its geometric edge weights."""

    neighbors: int = parameter(
        16, "K, neighbours of a point in the graph; more bridges gaps and takes longer", low=1, high=200,
        sensible="8-30",
    )  # fmt: skip
    normal_neighbors: int = parameter(
        45, "regions, edges: neighbours to which a point's normal is fitted; more suits noisy clouds, but rounds edges",
        low=3, high=500, sensible="10-80",
    )  # fmt: skip
    reach: float = reach_parameter()
    distance_weight: float = parameter(
        0.2, "edges: w_d, weight of the distance between two points (w_theta is 1 per radian); more separates "
        "sparse parts of the cloud from dense ones", unit="1/m", low=0, sensible="0-10",
    )  # fmt: skip
    convex_factor: float = parameter(
        0.05,
        "regions, edges: factor on the angle where the surface is convex and the normals are oriented; less keeps "
        "convex objects whole, because boundaries between objects are mostly concave; 1: eq. 3 as in the paper",
        low=0,
        high=1,
        sensible="0.03-1",
    )
    color_weight: float = parameter(
        0.0, "edges: weight of the RGB distance between two points; more cuts at colour changes; needs Scene.colors",
        low=0, sensible="0-1",
    )  # fmt: skip


@dataclass(frozen=True)
class PointSegmentsConfig(Stage):
    """Step 6: the method that segments the points."""

    method: str = parameter(
        "auto", "regions: region merging by mean boundary cost; edges: as in the paper, Felzenszwalb-Huttenlocher "
        "with the weights of eq. 3; learned: regions merge where a learned model says that they belong to one object "
        "(no parameter of step 6 counts); scan: ground and objects of one LiDAR scan (z up, sensor at the origin), "
        "without evidence from images; auto: scan if the rings of a turning LiDAR are recognised in the cloud, else "
        "learned", choices=("regions", "edges", "learned", "scan", "auto"), renamed={"sweep": "scan"},
    )  # fmt: skip
    scale: float = parameter(
        4.5, "edges: k of Felzenszwalb-Huttenlocher; more gives larger segments", unit="weight x points", low=0
    )
    min_size: int = parameter(
        120, "edges: smallest segment; smaller segments are joined to a neighbour", unit="points", low=0
    )
