"""The parameters of the whole method (steps 1-8): :class:`Config`, one frozen dataclass per stage."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self, cast

from torchjoint.config.images import BoundaryConfig, ContoursConfig, ImageGraphConfig, ImageSegmentsConfig
from torchjoint.config.labels import RefinementConfig
from torchjoint.config.paper import PaperConfig
from torchjoint.config.parameter import Stage
from torchjoint.config.points import PointGraphConfig, PointSegmentsConfig
from torchjoint.config.presets import presets, read_assignment, read_preset, read_yaml
from torchjoint.config.scan import ScanConfig
from torchjoint.config.views import PropagationConfig, VisibilityConfig


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
    scan: ScanConfig = field(default_factory=ScanConfig)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)

    #: Stages of steps 6-8 whose parameters are used only after all frames, see :mod:`torchjoint.config.afterwards`.
    afterwards: ClassVar[tuple[str, ...]] = ("scan", "refinement", "paper")
    #: Parameters of these stages (stage.parameter) that are used before, for the normals of the point graph.
    before: ClassVar[tuple[str, ...]] = ("paper.normal_neighbors",)

    def __post_init__(self) -> None:
        for name, expected in self.stages().items():
            if not isinstance(getattr(self, name), expected):
                came = type(getattr(self, name)).__name__
                raise TypeError(f"{name}: expected a {expected.__name__}, got {came}")
        if self.propagation.window % 2 == 0:
            raise ValueError(f"propagation.window: expected an odd number, got {self.propagation.window}")

    @classmethod
    def stages(cls) -> dict[str, type[Stage]]:
        """The stages by name: first those that the default method reads, in the order of the steps."""
        return {spec.name: cast(type[Stage], spec.default_factory) for spec in dataclasses.fields(cls)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any] | None) -> Self:
        """Makes a config from nested dicts, e.g. ``{"propagation": {"window": 3}}``; missing values are defaults.

        Raises:
            ValueError, TypeError: an unknown stage or parameter, or a bad value, by name.
        """
        return cls().replace(values or {})

    @classmethod
    def from_yaml(cls, path: str | Path) -> Self:
        """Reads a YAML file with the structure of :meth:`to_dict`.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError, TypeError: invalid YAML, an unknown name or a bad value; the message names the file.
        """
        return read_yaml(Path(path), cls.from_dict, "stages with parameters")

    @classmethod
    def from_preset(cls, name: str) -> Self:
        """Reads one of the package's presets (see :func:`presets`), or a YAML file of your own.

        Raises:
            ValueError, TypeError: an unknown preset, or a bad file; the message names it.
        """
        return read_preset(name, presets(), cls.from_dict, "stages with parameters")

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Nested plain dicts, the inverse of :meth:`from_dict`."""
        return dataclasses.asdict(self)

    def replace(self, values: Mapping[str, Any]) -> Self:
        """A copy with some parameters replaced: ``config.replace({"propagation": {"window": 3}})``.

        Raises:
            ValueError, TypeError: an unknown stage or parameter, or a bad value, by name.
        """
        stages = {}
        for stage, parameters in values.items():
            if stage not in self.stages():
                raise ValueError(f"{stage}: unknown stage, expected one of {', '.join(self.stages())}")
            if not isinstance(parameters, Mapping):
                raise TypeError(f"{stage}: expected parameters by name, got {parameters!r}")
            stages[stage] = getattr(self, stage).replace(parameters)
        return dataclasses.replace(self, **stages)

    def set(self, assignments: Sequence[str]) -> Self:
        """A copy with command-line assignments applied: ``["propagation.window=3"]``.

        Raises:
            ValueError, TypeError: a bad assignment, an unknown name or a bad value, by name.
        """
        config = self
        for assignment in assignments:
            key, value = read_assignment(assignment, "stage.parameter")
            stage, _, name = key.partition(".")
            config = config.replace({stage: {name: value}})
        return config
