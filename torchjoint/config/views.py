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
    """Step 5, eq. 5, all methods but scan: the images' evidence for each edge of the point graph."""

    window: int = parameter(
        1, "t, side of the window around a point's pixel (odd); more tolerates pose errors, but blurs boundaries",
        unit="px", low=1, high=31, sensible="1-7",
    )  # fmt: skip
