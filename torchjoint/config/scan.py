"""Parameters of the segmentation of a LiDAR scan."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class ScanConfig(Stage):
    """A scan's ground, and what stands on it."""

    azimuth_cell: float = parameter(
        2.0, "ground: width of the columns that the ground is followed along; more fills gaps and sees less detail",
        unit="degrees", above=0, high=90, sensible="1-4",
    )  # fmt: skip
    elevation_cell: float = parameter(
        0.4, "ground: height of the cells of a column, of which each gives its lowest point; about the angle between "
        "two beams", unit="degrees", above=0, high=10, sensible="0.3-2",
    )  # fmt: skip
    max_slope: float = parameter(
        10.0, "ground: how steep it may be; more takes bonnets and hedges for ground", unit="degrees", low=0, high=60,
        sensible="5-15",
    )  # fmt: skip
    max_step: float = parameter(
        0.05, "ground: a step that is allowed on top of the slope; about twice the noise", unit="m", low=0,
        sensible="0.03-0.1",
    )  # fmt: skip
    max_bump: float = parameter(
        0.2, "ground: what rises more than this over the ground of the columns beside it is none", unit="m", above=0,
        sensible="0.1-0.5",
    )  # fmt: skip
    ground_height: float = parameter(
        0.08, "ground: points lower than this over it belong to it; less keeps feet and kerbs, and leaves crumbs of a "
        "rough road", unit="m", above=0, sensible="0.05-0.3",
    )  # fmt: skip
    foot_distance: float = parameter(
        0.2, "points of the upper half of `ground_height` that are this near, on the level, to something standing are "
        "its feet, and no ground; 0: there are none", unit="m", low=0, sensible="0.1-0.3",
    )  # fmt: skip
    neighbors: int = parameter(12, "K, neighbours of a point in the graph", low=1, high=200, sensible="8-24")
    gap: float = parameter(
        0.2, "points closer than this belong together; more joins what stands side by side", unit="m", low=0,
        sensible="0.1-0.5",
    )  # fmt: skip
    gap_growth: float = parameter(
        0.02, "how much the gap grows with the distance from the sensor; more joins what is far", unit="m/m", low=0,
        sensible="0.01-0.04; about twice the angle between two beams, in radians",
    )  # fmt: skip
    min_size: int = parameter(
        15, "smaller segments are joined to a neighbour, if one is near", unit="points", low=0, sensible="5-30"
    )
    joining_gap: float = parameter(
        2.0, "how far small segments may be from what they are joined to; more leaves fewer crumbs, and joins what is "
        "far and small to what is behind it", unit="gaps", low=1, sensible="1.5-3",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gap == 0 == self.gap_growth:
            raise ValueError("scan.gap: expected > 0 where gap_growth is 0, got 0.0")
