"""Parameters of step 6, method scan: the segmentation of one LiDAR scan."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class ScanConfig(Stage):
    """Step 6, method scan: the ground of a LiDAR scan, and the objects on it."""

    azimuth_cell: float = parameter(
        2.0, "ground: width of the azimuth columns along which the ground is followed; more fills gaps, loses detail",
        unit="degrees", above=0, high=90, sensible="1-4",
    )  # fmt: skip
    elevation_cell: float = parameter(
        0.4, "ground: height of the elevation cells of a column; each cell contributes its lowest point; about the "
        "angle between two beams; more sees less detail", unit="degrees", above=0, high=10, sensible="0.3-2",
    )  # fmt: skip
    max_slope: float = parameter(
        10.0, "ground: largest slope; more takes car bonnets and hedges for ground, less loses hills", unit="degrees",
        low=0, high=60, sensible="5-15",
    )  # fmt: skip
    max_step: float = parameter(
        0.05, "ground: allowed step in height in addition to the slope; about twice the noise; more takes low objects "
        "for ground", unit="m", low=0, sensible="0.03-0.1",
    )  # fmt: skip
    max_bump: float = parameter(
        0.2, "ground: parts of a profile more than this above the profiles beside it are not ground; more takes wider "
        "objects for ground", unit="m", above=0, sensible="0.1-0.5",
    )  # fmt: skip
    ground_height: float = parameter(
        0.08, "ground: points lower than this above the ground belong to it; less keeps feet and kerbs, but leaves "
        "fragments of a rough road", unit="m", above=0, sensible="0.05-0.3",
    )  # fmt: skip
    object_height: float = parameter(
        0.25, "ground: what is lower than this belongs to it, if nothing rises from it; more takes low objects for "
        "ground, less leaves fragments of pavements and verges", unit="m", low=0, sensible="0.2-0.4",
    )  # fmt: skip
    neighbors: int = parameter(
        12, "K, neighbours of a point in the graph; more bridges gaps and takes longer", low=1, high=200,
        sensible="8-24",
    )  # fmt: skip
    gap: float = parameter(
        0.2, "points closer than this are joined; more joins objects that stand side by side", unit="m", low=0,
        sensible="0.1-0.5",
    )  # fmt: skip
    gap_growth: float = parameter(
        0.02, "increase of the allowed gap per metre of range; more joins points far from the sensor", unit="m/m",
        low=0, sensible="0.01-0.04",
    )  # fmt: skip
    min_size: int = parameter(
        15, "smallest segment; smaller segments are joined to a neighbour within `joining_gap`", unit="points", low=0,
        sensible="5-30",
    )  # fmt: skip
    joining_gap: float = parameter(
        2.0, "largest distance over which a small segment is joined to a neighbour; more leaves fewer fragments, but "
        "joins small distant objects to the background", unit="gaps", low=1, sensible="1.5-3",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gap == 0 == self.gap_growth:
            raise ValueError("scan.gap: expected > 0 where gap_growth is 0, got 0.0")
