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
        100.0, "geodesic: path cost of an RGB distance of 1, as a path length; a boundary of strength 1 costs half as "
        "much; more makes labels meet at the edges of the image; 0: each pixel takes the nearest point's label",
        unit="px", low=0, high=1000, sensible="25-200",
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
