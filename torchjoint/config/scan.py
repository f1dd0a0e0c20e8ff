"""Parameters of step 6, method scan: the segmentation of one LiDAR scan."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class ScanConfig(Stage):
    """Step 6, method scan: the ground of a LiDAR scan, and the objects on it."""

    object_height: float = parameter(
        0.25, "ground: what is lower than this belongs to it, if nothing rises from it; more takes low objects for "
        "ground, less leaves fragments of pavements and verges", unit="m", low=0, sensible="0.2-0.4",
        too_low="pavements and verges are many small segments",
        too_high="low things, such as kerbs, boxes and animals, belong to the ground",
    )  # fmt: skip
    gap: float = parameter(
        0.2, "points closer than this are joined; more joins objects that stand side by side", unit="m", low=0,
        sensible="0.1-0.5",
        too_low="one car or tree is several segments",
        too_high="things that stand side by side, such as parked cars, are one segment",
    )  # fmt: skip
    gap_growth: float = parameter(
        0.02, "increase of the allowed gap per metre of range; more joins points far from the sensor", unit="m/m",
        low=0, sensible="0.01-0.04",
    )  # fmt: skip
    min_size: int = parameter(
        15, "smallest segment; smaller segments are joined to a neighbour within 1.1 gaps", unit="points", low=0,
        sensible="5-30",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gap == 0 == self.gap_growth:
            raise ValueError("scan.gap: expected > 0 where gap_growth is 0, got 0.0")
