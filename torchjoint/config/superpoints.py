"""Parameters of :func:`torchjoint.superpoints`: one frozen dataclass, and presets of it in `configs/superpoints/`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from torchjoint.config.parameter import Stage, parameter
from torchjoint.config.points import PointGraphConfig, reach_parameter
from torchjoint.config.presets import presets, read_assignment, read_preset


@dataclass(frozen=True)
class SuperpointsConfig(Stage):
    """Superpoints of a cloud: its graph, the weight of its edges, and Felzenszwalb-Huttenlocher."""

    neighbors: int = parameter(
        10, "neighbours of a point in the graph; more costs time and bridges gaps", low=1, high=200, sensible="8-30"
    )
    normal_neighbors: int = parameter(
        30, "neighbours a normal is fitted to; more suits noisy clouds and rounds edges", low=2, high=500,
        sensible="12-80",
    )  # fmt: skip
    reach: float = reach_parameter()
    weight: str = parameter(
        "angle", "how a surface's turn is measured: the angle of two normals, or ScanNet's 1 - cosine, squared where "
        "convex", choices=("angle", "segmentator"),
    )  # fmt: skip
    angle_weight: float = parameter(1.0, "weight of that turn", unit="1/rad, or 1", low=0)
    convex_factor: float = parameter(
        0.1,
        "an angle counts only this much where the surface is convex, as within most objects; takes effect where the "
        "normals' signs are known (given, of a mesh, or turned to a viewpoint)",
        low=0,
        high=1,
        sensible="0.1-1",
    )
    distance_weight: float = parameter(
        0.0, "weight of the distance of two points; separates sparse from dense", unit="1/m", low=0, sensible="0-10"
    )
    color_weight: float = parameter(
        0.4, "weight of the RGB distance of two points, where there are colours", low=0, sensible="0-1"
    )
    scale: float = parameter(1.0, "k; more gives larger superpoints", unit="weight x points", low=0, sensible="0.1-5")
    min_size: int = parameter(20, "smaller superpoints are joined to a neighbour", unit="points", low=0)

    @property
    def point_graph(self) -> PointGraphConfig:
        """The terms of the weights that superpoints share with step 3 of the joint method."""
        return PointGraphConfig(
            distance_weight=self.distance_weight,
            angle_weight=self.angle_weight,
            convex_factor=self.convex_factor,
            color_weight=self.color_weight,
        )

    @classmethod
    def from_preset(cls, name: str) -> SuperpointsConfig:
        """Reads a preset (see :func:`superpoint_presets`), or a YAML file of your own."""
        return read_preset(name, superpoint_presets(), cls().replace)

    def set(self, assignments: Sequence[str]) -> SuperpointsConfig:
        """A copy with assignments applied as the command line writes them: ``["scale=2", "color_weight=0.5"]``."""
        return self.replace(dict(map(read_assignment, assignments)))


def superpoint_presets() -> dict[str, Any]:
    """The presets that come with the package: name -> readable resource."""
    return presets("superpoints")
