"""Parameters of method paper alone: its edge weights (step 3), its disagreement (5), its segments (6) and cuts (7)."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class PaperConfig(Stage):
    """Steps 3-7, method paper: what only the paper's own way of segmenting points and images reads."""

    normal_neighbors: int = parameter(
        45, "step 3: neighbours to which a point's normal is fitted; more suits noisy clouds, but rounds edges", low=3,
        high=500, sensible="10-80",
    )  # fmt: skip
    distance_weight: float = parameter(
        0.2, "eq. 3: w_d, weight of the distance between two points (w_theta is 1 per radian); more separates sparse "
        "parts of the cloud from dense ones", unit="1/m", low=0, sensible="0-10",
    )  # fmt: skip
    convex_factor: float = parameter(
        1.0, "eq. 3: factor on the angle where the surface is convex and the normals are oriented; less keeps convex "
        "objects whole, because boundaries between objects are mostly concave; 1: as in the paper", low=0, high=1,
        sensible="0.03-1",
    )  # fmt: skip
    color_weight: float = parameter(
        0.0, "eq. 3: weight of the RGB distance between two points, not in the paper; more cuts at colour changes; "
        "needs Scene.colors", low=0, sensible="0-1",
    )  # fmt: skip
    overlap_threshold: float = parameter(
        0.5, "eq. 6: r_o, overlap of two windows at which an image is neutral; an edge that no image sees has "
        "r = 1 - r_o, so more makes such edges cheaper", low=0, high=1,
    )  # fmt: skip
    normalization: str = parameter(
        "all", "eq. 6: L, all (the number of images, as in the paper), or saturating (the edge's own number of views)",
        choices=("saturating", "all"),
    )  # fmt: skip
    weight: float = parameter(
        0.12, "eq. 4: w_r, weight of the images' disagreement r; more cuts where images show different segments; 0: "
        "images do not affect the point segments, cameras only orient the normals", low=0, high=1000,
        sensible="0.05-1",
    )  # fmt: skip
    scale: float = parameter(
        13.0, "step 6: k of Felzenszwalb-Huttenlocher; more gives larger segments", unit="weight x points", low=0
    )
    min_size: int = parameter(
        120, "step 6: smallest segment; smaller segments are joined to a neighbour", unit="points", low=0
    )
    merge_ratio: float | None = parameter(
        0.8, "eq. 12: r_m, two image segments merge if at least this share of the point pairs between them has one 3D "
        "label; less merges more, and chains whole images together on real data; null: never", low=0, high=1,
        sensible="null, or 0.8-1",
    )  # fmt: skip
    split_min_edges: int | None = parameter(
        10, "step 7: n_s, an image segment is cut in two if it contains at least this many pairs of points with "
        "different 3D labels; less cuts more; null: never", low=1, sensible="5-100",
    )  # fmt: skip
