"""Parameters of the method: one frozen dataclass a stage, YAML presets, unknown keys and bad values refused by name.

Every parameter is declared once (:mod:`torchjoint.parameter`); the checks and the README's table read that declaration.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchjoint.parameter import Stage, parameter
from torchjoint.presets import presets, read_assignment, read_preset, read_yaml
from torchjoint.region_config import BordersConfig, BridgesConfig, ConfirmationConfig, RegionsConfig
from torchjoint.sweep_config import SweepConfig

#: Boundary detectors of the package.
DETECTORS = ("structured_forest", "gradient")


@dataclass(frozen=True)
class BoundaryConfig(Stage):
    """Step 1: how strongly a pixel looks like an object boundary."""

    detector: str = parameter(
        "structured_forest", "structured_forest, learned from people's segmentations; gradient, of colours, several "
        "times as fast; or a module of your own, as my_package.my_module:MyBoundary",
    )  # fmt: skip
    model: str | None = parameter(
        None, "structured_forest: file of a forest, NAME.yml.gz; null: the one that comes with the package"
    )
    multi_scale: bool = parameter(
        False, "structured_forest: look at half and twice the size, too; better, and takes about five times as long"
    )
    smoothing: float = parameter(
        1.0, "gradient: Gaussian blur before it; more ignores texture and softens edges", unit="px", low=0,
        high=20, sensible="0.5-3",
    )  # fmt: skip
    contrast: float = parameter(
        8.0, "gradient: the one at which a boundary has strength 1 - 1/e; less sees fainter edges",
        unit="Lab units/px", above=0, sensible="2-20",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.detector not in DETECTORS and not re.fullmatch(r"\w+(\.\w+)*:\w+", self.detector):
            raise ValueError(
                f"boundary.detector: expected {', '.join(DETECTORS)} or package.module:Class, got {self.detector!r}"
            )


@dataclass(frozen=True)
class ContoursConfig(Stage):
    """Step 1: closed contours in the place of the boundaries."""

    closed: bool = parameter(
        True, "make contours closed, each as strong as what parts whole regions; false: as in the paper"
    )
    smoothing: float = parameter(
        1.0, "Gaussian blur of the boundaries before regions are sought; more makes for fewer and larger ones",
        unit="px", low=0, high=20, sensible="1-3",
    )  # fmt: skip
    exponent: float = parameter(
        3.0, "power that a contour's strength is raised to; more lets weak contours go", above=0, sensible="1-4"
    )


@dataclass(frozen=True)
class ImageGraphConfig(Stage):
    """Step 1, eq. 2: weights of the 8-connected pixel graph."""

    smoothing: float = parameter(
        0.8, "Gaussian blur of the colours; more ignores noise and fine texture", unit="px", low=0, high=20,
        sensible="0-2",
    )  # fmt: skip
    color_weight: float = parameter(0.11, "w_c, weight of the RGB distance of two pixels", low=0, sensible="0-1")
    boundary_weight: float = parameter(
        1.0, "w_b, weight of the weaker boundary of two pixels; more closes gaps in faint contours", low=0,
        sensible="0-2",
    )  # fmt: skip


@dataclass(frozen=True)
class ImageSegmentsConfig(Stage):
    """Step 2: Felzenszwalb-Huttenlocher on the pixel graph."""

    scale: float = parameter(
        3.0, "k; more gives larger segments", unit="weight x px", low=0, sensible="0.5-200 for 640x480"
    )
    min_size: int = parameter(100, "smaller segments are joined to a neighbour", unit="px", low=0, sensible="20-1000")


def reach_parameter() -> Any:
    """Declares `reach`, which point graphs of the joint method and of superpoints share."""
    return parameter(
        0.0, "where all of a point's neighbours lie closer than this, they are sought among half of the points, "
        "a quarter or an eighth, so that a LiDAR's beams are joined to one another; 0: just the nearest", unit="m",
        low=0, sensible="0 for depth cameras, 0.3-0.7 for LiDAR",
    )  # fmt: skip


@dataclass(frozen=True)
class PointGraphConfig(Stage):
    """Step 3, eq. 3-4: the k-nearest-neighbour graph of the cloud and its geometric weight."""

    neighbors: int = parameter(16, "K, neighbours of a point in the graph", low=1, high=200, sensible="8-30")
    normal_neighbors: int = parameter(
        45, "neighbours a normal is fitted to; more suits noisy clouds and rounds edges", low=3, high=500,
        sensible="10-80",
    )  # fmt: skip
    reach: float = reach_parameter()
    plane_neighbors: int = parameter(
        45, "regions: neighbours that a point's one-sided plane is fitted to, of which those in its own region count",
        low=3, high=500, sensible="20-60, more for noisy clouds",
    )  # fmt: skip
    distance_weight: float = parameter(
        0.2, "edges: w_d, weight of the distance of two points; separates sparse from dense", unit="1/m", low=0,
        sensible="0-10",
    )  # fmt: skip
    angle_weight: float = parameter(1.0, "edges: w_theta, weight of the angle of two normals", unit="1/rad", low=0)
    convex_factor: float = parameter(
        0.06,
        "the angle counts only this much where the surface is convex: objects mostly are, and the borders between "
        "them concave; 1 is the paper's letter",
        low=0,
        high=1,
        sensible="0.1-1",
    )
    color_weight: float = parameter(
        0.0, "edges: weight of the RGB distance of two points; needs Scene.colors", low=0, sensible="0-1"
    )


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
        0.7, "w_r, weight of the images' disagreement r; 0 is plain 3D segmentation, cameras then but turn normals",
        low=0, high=1000, sensible="0.05-0.8",
    )  # fmt: skip


@dataclass(frozen=True)
class PointSegmentsConfig(Stage):
    """Step 6: segments of the point graph."""

    method: str = parameter(
        "regions", "regions: small ones, merged by what lies on their whole border; edges: as in the paper, "
        "Felzenszwalb-Huttenlocher on eq. 3; sweep: of a LiDAR, z up and the sensor at the origin, its ground and what "
        "stands on it, in which images have no say", choices=("regions", "edges", "sweep"),
    )  # fmt: skip
    scale: float = parameter(4.5, "edges: k; more gives larger segments", unit="weight x points", low=0)
    min_size: int = parameter(120, "edges: smaller segments are joined to a neighbour", unit="points", low=0)


@dataclass(frozen=True)
class RefinementConfig(Stage):
    """Steps 7 and 8: the final labels of each image, from the 3D labels and its own edges."""

    method: str = parameter(
        "spread", "spread: the points' 3D labels spread over the image and meet at its edges; cuts: they merge and "
        "split the initial segments, eq. 7-14", choices=("spread", "cuts"),
    )  # fmt: skip
    color_weight: float = parameter(
        100.0, "spread: how far a label goes on rather than across an RGB distance of 1; 0: to the nearest point",
        unit="px", low=0, high=1000, sensible="25-200",
    )  # fmt: skip
    boundary_weight: float = parameter(
        50.0, "spread: how far a label goes on rather than across a boundary of strength 1", unit="px", low=0,
        high=1000, sensible="10-100",
    )  # fmt: skip
    min_points: int = parameter(
        2, "spread: a connected part of one label with fewer points is left to its neighbours; more removes points "
        "seen through gaps, and small things; 1: none", unit="points", low=1, sensible="1-3",
    )  # fmt: skip
    unseen: float = parameter(
        30.0, "spread: an initial segment without a point keeps an id of its own where so many were to be expected, "
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


@dataclass(frozen=True)
class Config:
    """Everything that :class:`torchjoint.JointSegmenter` can be told; see each stage for its parameters."""

    boundary: BoundaryConfig = field(default_factory=BoundaryConfig)
    contours: ContoursConfig = field(default_factory=ContoursConfig)
    image_graph: ImageGraphConfig = field(default_factory=ImageGraphConfig)
    image_segments: ImageSegmentsConfig = field(default_factory=ImageSegmentsConfig)
    point_graph: PointGraphConfig = field(default_factory=PointGraphConfig)
    visibility: VisibilityConfig = field(default_factory=VisibilityConfig)
    propagation: PropagationConfig = field(default_factory=PropagationConfig)
    point_segments: PointSegmentsConfig = field(default_factory=PointSegmentsConfig)
    regions: RegionsConfig = field(default_factory=RegionsConfig)
    borders: BordersConfig = field(default_factory=BordersConfig)
    confirmation: ConfirmationConfig = field(default_factory=ConfirmationConfig)
    bridges: BridgesConfig = field(default_factory=BridgesConfig)
    sweep: SweepConfig = field(default_factory=SweepConfig)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)

    def __post_init__(self) -> None:
        for spec in dataclasses.fields(self):
            expected = STAGES[spec.name]
            if not isinstance(getattr(self, spec.name), expected):
                came = type(getattr(self, spec.name)).__name__
                raise TypeError(f"{spec.name}: expected a {expected.__name__}, got {came}")
        if self.propagation.window % 2 == 0:
            raise ValueError(f"propagation.window: expected an odd number, got {self.propagation.window}")
        if self.visibility.far <= self.visibility.near:
            raise ValueError(
                f"visibility.far: expected more than near ({self.visibility.near}), got {self.visibility.far}"
            )

    @classmethod
    def from_dict(cls, values: Mapping[str, Any] | None) -> Config:
        """Makes a config from nested dicts, e.g. ``{"propagation": {"weight": 0.2}}``; what is absent is default.

        Raises:
            ValueError, TypeError: an unknown stage or parameter, or a bad value, by name.
        """
        return cls().replace(values or {})

    @classmethod
    def from_yaml(cls, path: str | Path) -> Config:
        """Reads a YAML file of the form of :meth:`to_dict`; errors name the file."""
        return read_yaml(Path(path), cls.from_dict, "stages with parameters")

    @classmethod
    def from_preset(cls, name: str) -> Config:
        """Reads one of the presets that come with the package, see :func:`presets`, or a YAML file of your own."""
        return read_preset(name, presets(), cls.from_dict, "stages with parameters")

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Nested plain dicts, as :meth:`from_dict` takes them."""
        return dataclasses.asdict(self)

    def replace(self, values: Mapping[str, Any]) -> Config:
        """A copy with some parameters replaced: ``config.replace({"propagation": {"weight": 0.2}})``."""
        stages = {}
        for stage, parameters in values.items():
            if stage not in STAGES:
                raise ValueError(f"{stage}: unknown stage, expected one of {', '.join(STAGES)}")
            if not isinstance(parameters, Mapping):
                raise TypeError(f"{stage}: expected parameters by name, got {parameters!r}")
            stages[stage] = getattr(self, stage).replace(parameters)
        return dataclasses.replace(self, **stages)

    def set(self, assignments: Sequence[str]) -> Config:
        """A copy with assignments applied as the command line writes them: ``["propagation.weight=0.2"]``."""
        config = self
        for assignment in assignments:
            key, value = read_assignment(assignment, "stage.parameter")
            stage, _, name = key.partition(".")
            config = config.replace({stage: {name: value}})
        return config


_STAGES: tuple[type[Stage], ...] = (
    BoundaryConfig,
    ContoursConfig,
    ImageGraphConfig,
    ImageSegmentsConfig,
    PointGraphConfig,
    VisibilityConfig,
    PropagationConfig,
    PointSegmentsConfig,
    RegionsConfig,
    BordersConfig,
    ConfirmationConfig,
    BridgesConfig,
    SweepConfig,
    RefinementConfig,
)

#: The stages by their names in :class:`Config`, in the order of the method.
STAGES = {stage.key(): stage for stage in _STAGES}


def parameter_table() -> str:
    """All parameters as Markdown tables, a stage each: what the README shows."""
    parts = []
    for name, stage in STAGES.items():
        rows = []
        for spec in dataclasses.fields(stage):
            meta = spec.metadata
            default = "null" if spec.default is None else f"{spec.default}"
            doc = meta["doc"] + (f" (one of: {', '.join(meta['choices'])})" if meta["choices"] else "")
            rows.append(f"| `{spec.name}` | {default} | {meta['unit']} | {meta['sensible']} | {doc} |")
        title = (stage.__doc__ or "").split("\n")[0].rstrip(".")
        head = "| parameter | default | unit | sensible | what it does |\n|---|---:|---|---|---|"
        parts.append(f"**`{name}`**: {title}.\n\n{head}\n" + "\n".join(rows))
    return "\n\n".join(parts)
