"""Parameters of steps 1 and 2: boundaries of an image, its pixel graph and its initial segments."""

from __future__ import annotations

import re
from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter

#: The package's own boundary detectors.
DETECTORS = ("structured_forest", "gradient")


@dataclass(frozen=True)
class BoundaryConfig(Stage):
    """Step 1: boundary detection, the strength of an object boundary at each pixel."""

    detector: str = parameter(
        "structured_forest", "boundary detector: structured_forest (trained on human segmentations), gradient (of the "
        "colours; needs no training, several times as fast), or your own module as my_package.my_module:MyBoundary",
    )  # fmt: skip
    model: str | None = parameter(
        None, "structured_forest: file of the forest, NAME.yml.gz; null: the forest that comes with the package"
    )
    multi_scale: bool = parameter(
        False,
        "structured_forest: also run on the image at half and double size; more accurate, about five times slower",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.detector not in DETECTORS and not re.fullmatch(r"\w+(\.\w+)*:\w+", self.detector):
            raise ValueError(
                f"boundary.detector: expected {', '.join(DETECTORS)} or package.module:Class, got {self.detector!r}"
            )


@dataclass(frozen=True)
class ContoursConfig(Stage):
    """Step 1: closed contours instead of the detector's boundaries."""

    closed: bool = parameter(
        True,
        "replace the boundaries by closed contours, each with the mean boundary strength between the two regions "
        "it separates; false: use the detector's boundaries, as in the paper",
    )


@dataclass(frozen=True)
class ImageGraphConfig(Stage):
    """Step 1, eq. 2: edge weights of the 8-connected pixel graph."""

    smoothing: float = parameter(
        0.8, "standard deviation of the Gaussian blur of the colours (steps 1, 7 and 8); more suppresses noise and "
        "fine texture", unit="px", low=0, high=20,
        sensible="0-2",
    )  # fmt: skip
    color_weight: float = parameter(
        0.11, "w_c, weight of the RGB distance between two pixels; more cuts at fainter colour changes", low=0,
        sensible="0-1",
    )  # fmt: skip
    boundary_weight: float = parameter(
        1.0, "w_b, weight of the smaller boundary strength of two pixels; more cuts at fainter contours", low=0,
        sensible="0-2",
    )  # fmt: skip


@dataclass(frozen=True)
class ImageSegmentsConfig(Stage):
    """Step 2: Felzenszwalb-Huttenlocher segmentation of the pixel graph."""

    scale: float = parameter(
        3.0, "k of Felzenszwalb-Huttenlocher; more gives larger segments", unit="weight x px", low=0,
        sensible="0.5-30 for 640x480",
        too_low="segments of the images are scraps that say nothing: the result is as without images",
        too_high="a segment of an image spans several objects: small and flat things join what they lie on",
    )  # fmt: skip
    min_size: int = parameter(
        100, "smallest segment; smaller segments are joined to a neighbour", unit="px", low=0,
        sensible="20-300 for 640x480",
        too_low="prints and highlights are segments of the images: objects fall into parts",
        too_high="small things have no segment of their own in the images, and join what they lie on",
    )  # fmt: skip
