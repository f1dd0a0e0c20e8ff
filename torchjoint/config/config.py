"""The parameters of the whole method (steps 1-8): :class:`Config`, one frozen dataclass per stage."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torchjoint_lab.regions.config import (
    ImageSupportConfig,
    OcclusionBridgingConfig,
    PiecesConfig,
    RegionMergingConfig,
)

from torchjoint.config.images import BoundaryConfig, ContoursConfig, ImageGraphConfig, ImageSegmentsConfig
from torchjoint.config.labels import RefinementConfig
from torchjoint.config.parameter import Stage
from torchjoint.config.points import PointGraphConfig, PointSegmentsConfig
from torchjoint.config.presets import presets, read_assignment, read_preset, read_yaml
from torchjoint.config.removed import REMOVED
from torchjoint.config.scan import ScanConfig
from torchjoint.config.views import PropagationConfig, VisibilityConfig

#: Old names of stages -> new names, for an error message that gives the new name.
RENAMED = {
    "borders": "region_merging",
    "bridges": "occlusion_bridging",
    "confirmation": "image_support",
    "sweep": "scan",
}


@dataclass(frozen=True)
class Config:
    """All parameters of :class:`torchjoint.JointSegmenter`; each stage documents its own parameters.

    Raises:
        ValueError, TypeError: a stage of the wrong type, or values that do not fit together, by name.
    """

    boundary: BoundaryConfig = field(default_factory=BoundaryConfig)
    contours: ContoursConfig = field(default_factory=ContoursConfig)
    image_graph: ImageGraphConfig = field(default_factory=ImageGraphConfig)
    image_segments: ImageSegmentsConfig = field(default_factory=ImageSegmentsConfig)
    point_graph: PointGraphConfig = field(default_factory=PointGraphConfig)
    visibility: VisibilityConfig = field(default_factory=VisibilityConfig)
    propagation: PropagationConfig = field(default_factory=PropagationConfig)
    point_segments: PointSegmentsConfig = field(default_factory=PointSegmentsConfig)
    pieces: PiecesConfig = field(default_factory=PiecesConfig)
    region_merging: RegionMergingConfig = field(default_factory=RegionMergingConfig)
    image_support: ImageSupportConfig = field(default_factory=ImageSupportConfig)
    occlusion_bridging: OcclusionBridgingConfig = field(default_factory=OcclusionBridgingConfig)
    scan: ScanConfig = field(default_factory=ScanConfig)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)

    def __post_init__(self) -> None:
        for spec in dataclasses.fields(self):
            expected = STAGES[spec.name]
            if not isinstance(getattr(self, spec.name), expected):
                came = type(getattr(self, spec.name)).__name__
                raise TypeError(f"{spec.name}: expected a {expected.__name__}, got {came}")
        if self.propagation.window % 2 == 0:
            raise ValueError(f"propagation.window: expected an odd number, got {self.propagation.window}")

    @classmethod
    def from_dict(cls, values: Mapping[str, Any] | None) -> Config:
        """Makes a config from nested dicts, e.g. ``{"propagation": {"weight": 0.2}}``; missing values are defaults.

        Raises:
            ValueError, TypeError: an unknown stage or parameter, or a bad value, by name.
        """
        return cls().replace(values or {})

    @classmethod
    def from_yaml(cls, path: str | Path) -> Config:
        """Reads a YAML file with the structure of :meth:`to_dict`.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError, TypeError: invalid YAML, an unknown name or a bad value; the message names the file.
        """
        return read_yaml(Path(path), cls.from_dict, "stages with parameters")

    @classmethod
    def from_preset(cls, name: str) -> Config:
        """Reads one of the package's presets (see :func:`presets`), or a YAML file of your own.

        Raises:
            ValueError, TypeError: an unknown preset, or a bad file; the message names it.
        """
        return read_preset(name, presets(), cls.from_dict, "stages with parameters")

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Nested plain dicts, the inverse of :meth:`from_dict`."""
        return dataclasses.asdict(self)

    def replace(self, values: Mapping[str, Any]) -> Config:
        """A copy with some parameters replaced: ``config.replace({"propagation": {"weight": 0.2}})``.

        Raises:
            ValueError, TypeError: an unknown stage or parameter, or a bad value, by name.
        """
        stages = {}
        for stage, parameters in values.items():
            if stage not in STAGES:
                raise ValueError(unknown_stage(stage))
            if not isinstance(parameters, Mapping):
                raise TypeError(f"{stage}: expected parameters by name, got {parameters!r}")
            stages[stage] = getattr(self, stage).replace(parameters)
        return dataclasses.replace(self, **stages)

    def set(self, assignments: Sequence[str]) -> Config:
        """A copy with command-line assignments applied: ``["propagation.weight=0.2"]``.

        Raises:
            ValueError, TypeError: a bad assignment, an unknown name or a bad value, by name.
        """
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
    PiecesConfig,
    RegionMergingConfig,
    ImageSupportConfig,
    OcclusionBridgingConfig,
    ScanConfig,
    RefinementConfig,
)

#: The stages by their names in :class:`Config`, in the order of the method's steps.
STAGES = {stage.key(): stage for stage in _STAGES}


def unknown_stage(stage: str) -> str:
    """The message for a name that is no stage: its new name, what became of it, or the names that there are."""
    if stage in RENAMED:
        return f"{stage}: this stage is now called {RENAMED[stage]}"
    if stage in REMOVED:
        return f"{stage}: this stage {REMOVED[stage]}"
    return f"{stage}: unknown stage, expected one of {', '.join(STAGES)}"
