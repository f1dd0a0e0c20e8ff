"""Parameters of steps 3 and 6: the graph of the points, and the method that segments it."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class PointGraphConfig(Stage):
    """Step 3, eq. 3, all methods but scan: the graph of the nearest neighbours."""

    neighbors: int = parameter(
        16, "K, neighbours of a point in the graph; more bridges gaps and takes longer", low=1, high=200,
        sensible="8-30",
    )  # fmt: skip


@dataclass(frozen=True)
class PointSegmentsConfig(Stage):
    """Step 6: the method that segments the points."""

    method: str = parameter(
        "auto", "learned: regions merge where a trained model says that they belong to one object; scan: ground and "
        "objects of one LiDAR scan (z up, sensor at the origin), without evidence from images; paper: as in the paper, "
        "with the parameters of stage paper; auto: scan if the cloud is recognised as a scan of one or more LiDARs, "
        "else learned; NAME.npz: learned, with this model of torchjoint-lab train-boundary-model",
        choices=("auto", "learned", "scan", "paper", "NAME.npz"),
    )  # fmt: skip
