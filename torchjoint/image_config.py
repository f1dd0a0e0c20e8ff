"""Parameters of the steps that images are in: 1 and 2, 7 and 8."""

from __future__ import annotations

import re
from dataclasses import dataclass

from torchjoint.parameter import Stage, parameter

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


@dataclass(frozen=True)
class RefinementConfig(Stage):
    """Steps 7 and 8: the final labels of each image, from the 3D labels and its own edges."""

    method: str = parameter(
        "spread", "spread: the points' 3D labels spread over the image and meet at its edges; cuts: they merge and "
        "split the initial segments, eq. 7-14", choices=("spread", "cuts"),
    )  # fmt: skip
    color_weight: float = parameter(
        100.0, "spread: how far a label goes on rather than across an RGB distance of 1; 0: to the nearest point",
        unit="px", low=0, high=1000, sensible="25-200",
    )  # fmt: skip
    boundary_weight: float = parameter(
        50.0, "spread: how far a label goes on rather than across a boundary of strength 1", unit="px", low=0,
        high=1000, sensible="10-100",
    )  # fmt: skip
    min_points: int = parameter(
        2, "spread: a connected part of one label with fewer points is left to its neighbours; more removes points "
        "seen through gaps, and small things; 1: none", unit="points", low=1, sensible="1-3",
    )  # fmt: skip
    unseen: float = parameter(
        30.0, "spread: an initial segment without a point keeps an id of its own where so many were to be expected, "
        "at the image's mean density; less keeps sky and glass apart, and breaks up what has few points",
        unit="points", low=0, sensible="10-100",
    )  # fmt: skip
    radius: float = parameter(
        3.0, "cuts: R, visible points closer than this in the image are compared", unit="px", above=0, high=100,
        sensible="2-8; at least the spacing of the projected points",
    )  # fmt: skip
    merge_ratio: float | None = parameter(
        None, "cuts: r_m, two image segments merge when this share of their point pairs has one 3D label; null: off "
        "(merging chains whole images together, and step 8 joins segments of one label anyway)", low=0, high=1,
        sensible="null, or 0.9-1",
    )  # fmt: skip
    split_min_edges: int | None = parameter(
        10, "cuts: n_s, external point pairs inside an image segment before it is cut in two; null: never cut", low=1,
        sensible="5-100",
    )  # fmt: skip
    max_splits: int = parameter(8, "cuts: how often a segment may be cut again, at the most", low=1, high=64)
