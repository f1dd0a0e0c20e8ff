"""Parameters of :func:`torchjoint.superpoints` (step 3's graph, segmented alone); presets in `configs/superpoints/`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torchjoint.config.config import presets, read_assignment, read_preset
from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class SuperpointsConfig(Stage):
    """Superpoints of a cloud: the graph, its edge weights, and Felzenszwalb-Huttenlocher."""

    neighbors: int = parameter(
        10, "neighbours of a point in the graph; more bridges gaps and takes longer", low=1, high=200, sensible="8-30"
    )
    normal_neighbors: int = parameter(
        30, "neighbours of a normal's fit; more suits noise, but rounds edges", low=2, high=500, sensible="12-80",
    )  # fmt: skip
    reach: float = parameter(
        0.0, "if all neighbours of a point are closer, search them among half, a quarter or an eighth of the points, "
        "so that edges connect LiDAR beams; more connects sparser scans and loses detail; 0: never",
        unit="m", low=0, sensible="0 for depth cameras, 0.3-0.7 for LiDAR",
    )  # fmt: skip
    weight: str = parameter(
        "angle", "how the surface's turn along an edge is measured: angle (between the two normals), or segmentator "
        "(ScanNet's 1 - cosine, squared where convex)", choices=("angle", "segmentator"),
    )  # fmt: skip
    angle_weight: float = parameter(
        1.0, "weight of the surface's turn; more cuts at flatter creases", unit="1/rad, or 1", low=0
    )
    convex_factor: float = parameter(
        0.1, "angle: factor on the angle where the surface is convex, as it is inside most objects; less keeps convex "
        "objects whole; needs oriented normals (given, of a mesh, or turned to a viewpoint)",
        low=0, high=1, sensible="0.03-1",
    )  # fmt: skip
    distance_weight: float = parameter(
        0.0, "weight of the distance of two points; more separates sparse parts from dense ones",
        unit="1/m", low=0, sensible="0-10",
    )  # fmt: skip
    color_weight: float = parameter(
        0.4, "weight of the RGB distance of two points, if there are colours; more cuts at colour changes",
        low=0, sensible="0-1",
    )  # fmt: skip
    scale: float = parameter(
        1.0, "k of Felzenszwalb-Huttenlocher; more: larger superpoints", unit="weight x points", low=0,
        sensible="0.1-5",
    )  # fmt: skip
    min_size: int = parameter(20, "smaller superpoints join a neighbour", unit="points", low=0)
    joining: float = parameter(
        0.0, "then superpoints of a and b points join while the mean weight of their border x ab/(a + b) is at most "
        "this; 0: never", unit="weight x points", low=0, sensible="0, or 5-50 with scale 0.1",
    )  # fmt: skip

    @classmethod
    def from_preset(cls, name: str) -> SuperpointsConfig:
        """Reads a preset (``presets("superpoints")``), or a YAML file of your own.

        Raises:
            ValueError, TypeError: an unknown preset, or a bad file; the message names it.
        """
        return read_preset(name, presets("superpoints"), cls().replace)

    def set(self, assignments: Sequence[str]) -> SuperpointsConfig:
        """A copy with command-line assignments applied: ``["scale=2", "color_weight=0.5"]``.

        Raises:
            ValueError, TypeError: a bad assignment, an unknown name or a bad value, by name.
        """
        return self.replace(dict(map(read_assignment, assignments)))
