"""Parameters of steps 7 and 8: the final labels of the images."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class RefinementConfig(Stage):
    """Steps 7 and 8, all methods but paper: geodesic propagation of the points' labels in each image."""

    color_weight: float = parameter(
        100.0, "path cost of an RGB distance of 1, as a path length; a boundary of strength 1 costs half as much; more "
        "makes labels meet at the edges of the image; 0: each pixel takes the nearest point's label", unit="px", low=0,
        high=1000, sensible="25-200",
    )  # fmt: skip
