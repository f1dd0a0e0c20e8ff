"""Parameters of steps 7 and 8: the final labels of the images."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class RefinementConfig(Stage):
    """Steps 7 and 8: the final labels of each image, from the 3D labels and its own edges."""

    method: str = parameter(
        "geodesic", "geodesic: the points' 3D labels spread over the image and meet at its edges; cuts: they merge and "
        "split the initial segments, eq. 7-14", choices=("geodesic", "cuts"), renamed={"spread": "geodesic"},
    )  # fmt: skip
    color_weight: float = parameter(
        100.0, "geodesic: how far a label goes on rather than across an RGB distance of 1; 0: to the nearest point",
        unit="px", low=0, high=1000, sensible="25-200",
    )  # fmt: skip
    boundary_weight: float = parameter(
        50.0, "geodesic: how far a label goes on rather than across a boundary of strength 1", unit="px", low=0,
        high=1000, sensible="10-100",
    )  # fmt: skip
    min_points: int = parameter(
        2, "geodesic: a connected part of one label with fewer points is left to its neighbours; more removes points "
        "seen through gaps, and small things; 1: none", unit="points", low=1, sensible="1-3",
    )  # fmt: skip
    unseen: float = parameter(
        30.0, "geodesic: an initial segment without a point keeps an id of its own where so many were to be expected, "
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
