"""Parameters of steps 4 and 5: visibility, and evidence from the images for the edges of the point graph."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class VisibilityConfig(Stage):
    """Step 4: which points an image sees."""

    method: str = parameter(
        "zbuffer", "zbuffer: z-buffer of splats; hidden_point_removal: spherical flipping and a convex hull (Katz et "
        "al. 2007)",
        choices=("zbuffer", "hidden_point_removal"),
    )  # fmt: skip
    footprint: float = parameter(
        0.5,
        "zbuffer: half width of a point's splat in units of the point's spacing; more closes holes in surfaces, but "
        "also hides points beside an occluder",
        above=0,
        high=10,
        sensible="0.3-1",
    )
    depth_tolerance: float = parameter(
        0.01,
        "zbuffer: a point is visible up to this far behind the nearest splat; more tolerates noise and errors of "
        "poses, but lets hidden points through",
        unit="of the point's depth",
        above=0,
        sensible="0.005-0.02",
        too_low="a noisy cloud hides its own points: the images say nothing about many points",
        too_high="points behind an object count as seen: in images, an object has labels of what is behind it",
    )


@dataclass(frozen=True)
class PropagationConfig(Stage):
    """Step 5, eq. 5-6, all methods but scan: the images' evidence r for each edge of the point graph."""

    window: int = parameter(
        1, "t, side of the window around a point's pixel (odd); more tolerates pose errors, but blurs boundaries",
        unit="px", low=1, high=31, sensible="1-7",
    )  # fmt: skip
    overlap_threshold: float = parameter(
        0.7, "r_o, overlap of two windows at which an image is neutral; an edge that no image sees has r = 1 - r_o, so "
        "more makes such edges cheaper", low=0, high=1,
    )  # fmt: skip
    normalization: str = parameter(
        "saturating", "L of eq. 6: all (the number of images, as in the paper), or saturating (the edge's own number "
        "of views)", choices=("saturating", "all"),
    )  # fmt: skip
    weight: float = parameter(
        0.3, "w_r, weight of the images' disagreement r; more cuts where images show different segments; 0: images do "
        "not affect the point segments, cameras only orient the normals; learned: all values above 0 are the same",
        low=0, high=1000, sensible="0.05-1",
    )  # fmt: skip
