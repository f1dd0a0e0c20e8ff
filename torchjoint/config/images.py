"""Parameters of the steps that images are in: 1 and 2, 7 and 8."""

from __future__ import annotations

import re
from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter

#: Boundary detectors of the package.
DETECTORS = ("structured_forest", "gradient")


@dataclass(frozen=True)
class BoundaryConfig(Stage):
    """Step 1: how strongly a pixel looks like an object boundary."""

    detector: str = parameter(
        "structured_forest", "structured_forest, learned from people's segmentations; gradient, of colours, several "
        "times as fast; or a module of your own, as my_package.my_module:MyBoundary",
    )  # fmt: skip
    model: str | None = parameter(
        None, "structured_forest: file of a forest, NAME.yml.gz; null: the one that comes with the package"
    )
    multi_scale: bool = parameter(
        False, "structured_forest: look at half and twice the size, too; better, and takes about five times as long"
    )
    smoothing: float = parameter(
        1.0, "gradient: Gaussian blur before it; more ignores texture and softens edges", unit="px", low=0,
        high=20, sensible="0.5-3",
    )  # fmt: skip
    contrast: float = parameter(
        8.0, "gradient: the one at which a boundary has strength 1 - 1/e; less sees fainter edges",
        unit="Lab units/px", above=0, sensible="2-20",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.detector not in DETECTORS and not re.fullmatch(r"\w+(\.\w+)*:\w+", self.detector):
            raise ValueError(
                f"boundary.detector: expected {', '.join(DETECTORS)} or package.module:Class, got {self.detector!r}"
            )


@dataclass(frozen=True)
class ContoursConfig(Stage):
    """Step 1: closed contours in the place of the boundaries."""

    closed: bool = parameter(
        True, "make contours closed, each as strong as what parts whole regions; false: as in the paper"
    )
    smoothing: float = parameter(
        1.0, "Gaussian blur of the boundaries before regions are sought; more makes for fewer and larger ones",
        unit="px", low=0, high=20, sensible="1-3",
    )  # fmt: skip
    exponent: float = parameter(
        3.0, "power that a contour's strength is raised to; more lets weak contours go", above=0, sensible="1-4"
    )


@dataclass(frozen=True)
class ImageGraphConfig(Stage):
    """Step 1, eq. 2: weights of the 8-connected pixel graph."""

    smoothing: float = parameter(
        0.8, "Gaussian blur of the colours; more ignores noise and fine texture", unit="px", low=0, high=20,
        sensible="0-2",
    )  # fmt: skip
    color_weight: float = parameter(0.11, "w_c, weight of the RGB distance of two pixels", low=0, sensible="0-1")
    boundary_weight: float = parameter(
        1.0, "w_b, weight of the weaker boundary of two pixels; more closes gaps in faint contours", low=0,
        sensible="0-2",
    )  # fmt: skip


@dataclass(frozen=True)
class ImageSegmentsConfig(Stage):
    """Step 2: Felzenszwalb-Huttenlocher on the pixel graph."""

    scale: float = parameter(
        3.0, "k; more gives larger segments", unit="weight x px", low=0, sensible="0.5-200 for 640x480"
    )
    min_size: int = parameter(100, "smaller segments are joined to a neighbour", unit="px", low=0, sensible="20-1000")
