"""Parameters of the method: one frozen dataclass a stage, YAML presets, unknown keys and bad values refused by name.

Every parameter is declared once (:mod:`torchjoint.parameter`); the checks and the README's table read that declaration.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchjoint.image_config import (
    DETECTORS,
    BoundaryConfig,
    ContoursConfig,
    ImageGraphConfig,
    ImageSegmentsConfig,
    RefinementConfig,
)
from torchjoint.parameter import Stage, parameter
from torchjoint.presets import presets, read_assignment, read_preset, read_yaml
from torchjoint.region_config import BordersConfig, BridgesConfig, ConfirmationConfig, PiecesConfig, RegionsConfig
from torchjoint.sweep_config import SweepConfig

__all__ = [
    "DETECTORS",
    "STAGES",
    "BordersConfig",
    "BoundaryConfig",
    "BridgesConfig",
    "Config",
    "ConfirmationConfig",
    "ContoursConfig",
    "ImageGraphConfig",
    "ImageSegmentsConfig",
    "PiecesConfig",
    "PointGraphConfig",
    "PointSegmentsConfig",
    "PropagationConfig",
    "RefinementConfig",
    "RegionsConfig",
    "SweepConfig",
    "VisibilityConfig",
    "parameter_table",
    "reach_parameter",
]


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
        0.9, "w_r, weight of the images' disagreement r; 0 is plain 3D segmentation, cameras then but turn normals",
        low=0, high=1000, sensible="0.05-1",
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
    pieces: PiecesConfig = field(default_factory=PiecesConfig)
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
    PiecesConfig,
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
