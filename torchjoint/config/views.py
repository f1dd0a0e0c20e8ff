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
    max_footprint: int = parameter(
        8, "zbuffer: largest half width of a splat; more closes holes in near surfaces and takes longer", unit="px",
        low=0, high=100, sensible="4-20",
    )  # fmt: skip
    depth_tolerance: float = parameter(
        0.01,
        "zbuffer: a point is visible up to this far behind the nearest splat; more tolerates noise and errors of "
        "poses, but lets hidden points through",
        unit="of the point's depth",
        above=0,
        sensible="0.005-0.02",
    )
    slant_tolerance: float = parameter(
        2.0,
        "zbuffer: additional depth tolerance in units of the point's spacing; less loses points on slanted surfaces",
        low=0,
        high=10,
        sensible="1-3",
    )
    radius_factor: float = parameter(
        0.01, "hidden_point_removal: sphere radius = largest distance x N x this; more lets hidden points through",
        above=0, sensible="0.001-0.1",
    )  # fmt: skip
    margin: float = parameter(
        0.1, "hidden_point_removal: margin around the image in which points still hide others; more finds occluders "
        "farther outside the image and takes longer", unit="image widths", low=0, high=5,
    )  # fmt: skip


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
        "of views, at least `saturation`)", choices=("saturating", "all"),
    )  # fmt: skip
    saturation: int = parameter(
        1, "saturating: s, number of views from which on an edge's evidence counts fully; more trusts few views less",
        unit="views", low=1, sensible="1-10",
    )  # fmt: skip
    weight: float = parameter(
        0.3, "w_r, weight of the images' disagreement r; more cuts where images show different segments; 0: images do "
        "not affect the point segments, cameras only orient the normals", low=0, high=1000, sensible="0.05-1",
    )  # fmt: skip
