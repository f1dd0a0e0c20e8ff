"""Parameters of steps 7 and 8: the final labels of the images."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class RefinementConfig(Stage):
    """Steps 7 and 8: the final labels of each image, from the 3D labels of its points and its own edges."""

    method: str = parameter(
        "geodesic", "geodesic: geodesic label propagation, each pixel takes the 3D label of the point with the "
        "cheapest path to it; cuts: as in the paper, 3D labels merge and split the initial segments, eq. 7-14",
        choices=("geodesic", "cuts"), renamed={"spread": "geodesic"},
    )  # fmt: skip
    color_weight: float = parameter(
        100.0, "geodesic: path cost of an RGB distance of 1, as a path length; more makes labels meet at colour edges; "
        "0 (here and in boundary_weight): each pixel takes the nearest point's label", unit="px", low=0, high=1000,
        sensible="25-200",
    )  # fmt: skip
    boundary_weight: float = parameter(
        50.0, "geodesic: path cost of a boundary of strength 1, as a path length; more makes labels meet at "
        "boundaries", unit="px", low=0, high=1000, sensible="10-100",
    )  # fmt: skip
    min_points: int = parameter(
        2, "geodesic: a connected part of one label with fewer points is given to its neighbours; more removes "
        "background points seen through gaps, and also small objects; 1: keep all parts", unit="points", low=1,
        sensible="1-3",
    )  # fmt: skip
    unseen: float = parameter(
        30.0, "geodesic: an initial segment without points keeps its own id if its area would hold this many points at "
        "the image's mean point density; less keeps sky and glass separate, but splits objects with few points",
        unit="points", low=0, sensible="10-100",
    )  # fmt: skip
    radius: float = parameter(
        3.0, "cuts: R, visible points at most this far apart in the image form a pair; more counts more pairs and "
        "takes longer", unit="px", above=0, high=100, sensible="2-8; at least the spacing of the projected points",
    )  # fmt: skip
    merge_ratio: float | None = parameter(
        None, "cuts: r_m, two image segments merge if at least this share of the point pairs between them has one 3D "
        "label; less merges more; null: never (merging chains whole images together, and step 8 gives segments of one "
        "3D label the same id anyway)", low=0, high=1, sensible="null, or 0.9-1",
    )  # fmt: skip
    split_min_edges: int | None = parameter(
        10, "cuts: n_s, an image segment is cut in two if it contains at least this many pairs of points with "
        "different 3D labels; less cuts more; null: never", low=1, sensible="5-100",
    )  # fmt: skip
    max_splits: int = parameter(
        8, "cuts: largest number of rounds in which segments are cut again; more separates more objects per segment",
        low=1, high=64,
    )  # fmt: skip
