"""Parameters of steps 4 and 5: visibility, and propagation from the images to the cloud."""

from __future__ import annotations

from dataclasses import dataclass

from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class VisibilityConfig(Stage):
    """Step 4: which points an image sees."""

    method: str = parameter(
        "zbuffer", "z-buffer of splats, or hidden point removal (Katz et al. 2007)",
        choices=("zbuffer", "hidden_point_removal"),
    )  # fmt: skip
    near: float = parameter(0.05, "points closer to the camera plane are not seen", unit="m", above=0)
    far: float = parameter(100.0, "points farther than this are not seen", unit="m", above=0)
    footprint: float = parameter(
        0.5,
        "z-buffer: half width of a point's splat in units of its own spacing; more closes holes, and hides points "
        "beside what is in front of them",
        above=0,
        high=10,
        sensible="0.3-1",
    )
    max_footprint: int = parameter(
        8, "z-buffer: half width of a splat at the most; more costs time", unit="px", low=0, high=100, sensible="4-20"
    )
    depth_tolerance: float = parameter(
        0.02,
        "z-buffer: how far behind the nearest splat a point still counts as seen; about the noise of the points",
        unit="m",
        above=0,
        sensible="0.01-0.05 indoors, 0.2-1 outdoors",
    )
    slant_tolerance: float = parameter(
        2.0,
        "z-buffer: further tolerance in units of a point's own spacing; less loses points on slanted surfaces",
        low=0,
        high=10,
        sensible="1-3",
    )
    radius_factor: float = parameter(
        0.01, "hidden point removal: sphere radius = max distance x N x this; more lets hidden points through",
        above=0, sensible="0.001-0.1",
    )  # fmt: skip
    margin: float = parameter(
        0.1, "hidden point removal: how much larger than the image the frustum crop is, so that occluders beside "
        "the image count", unit="image widths", low=0, high=5,
    )  # fmt: skip


@dataclass(frozen=True)
class PropagationConfig(Stage):
    """Step 5, eq. 5-6: what the image segmentations say about each edge of the point graph."""

    window: int = parameter(
        1, "t, side of the window around a point's pixel (odd); more forgives pose error and softens borders",
        unit="px", low=1, high=31, sensible="1-7",
    )  # fmt: skip
    overlap_threshold: float = parameter(
        0.7, "r_o, overlap of two windows at which an image says neither same nor different", low=0, high=1
    )
    normalization: str = parameter(
        "saturating", "L of eq. 6: 'all' images (the paper's letter), or an edge's own views, trusted in full from "
        "`saturation` on", choices=("saturating", "all"),
    )  # fmt: skip
    saturation: int = parameter(
        1, "s, views after which an edge is trusted in full (normalization: saturating)", unit="views", low=1,
        sensible="1-10",
    )  # fmt: skip
    weight: float = parameter(
        0.9, "w_r, weight of the images' disagreement r; 0 is plain 3D segmentation, cameras then but turn normals",
        low=0, high=1000, sensible="0.05-1",
    )  # fmt: skip
