"""All parameters, the presets, and what can be changed after all frames were seen."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar, cast

import yaml

from torchjoint.config import stages as steps
from torchjoint.config.parameter import Stage
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import damage_is, no_twice, read_text

T = TypeVar("T")


class _Loader(yaml.SafeLoader):
    """Refuses aliases (``*name``), with which a short text can become a value of gigabytes, and keys that are twice."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        events = yaml.CSafeLoader(text) if yaml.__with_libyaml__ else self  # which reads ten times as fast
        vars(self).update({name: getattr(events, name) for name in ("check_event", "peek_event", "get_event")})

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError(f"expected a value, got an alias (*name)\n{self.peek_event().start_mark}")
        node = super().compose_node(parent, index)
        if isinstance(node, yaml.MappingNode):
            no_twice((str(key.value) for key, _ in node.value), "the name")
        return node


def _number(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> float:
    """YAML 1.1 reads 010 as 8 and 1:30.5 as 90.5: here a number has the value that people read, or is an error."""
    with damage_is(f"expected a number, got {node.value[:60]!r}"):
        if node.tag.endswith("float") and ":" not in node.value:
            return loader.construct_yaml_float(node)
        bounds.check(len(node.value), 19, "digits")  # larger ones can have one hash, and dicts of them take long
        return int(node.value)


_Loader.add_constructor("tag:yaml.org,2002:int", _number)
_Loader.add_constructor("tag:yaml.org,2002:float", _number)


def presets(*folder: str) -> dict[str, Any]:
    """The presets in `configs/` or in one of its folders: name -> readable resource."""
    files = resources.files("torchjoint.configs").joinpath(*folder).iterdir()
    return {Path(file.name).stem: file for file in sorted(files, key=lambda f: f.name) if file.name.endswith(".yaml")}


def read_preset(
    name: str, known: Mapping[str, Any], make: Callable[[Mapping[str, Any]], T], form: str = "parameters by name"
) -> T:
    """Reads a preset, or a user's file if the name ends in .yaml or .yml.

    Args:
        name: of the preset, or the path of a file.
        known: the presets, name -> readable resource.
        make: makes the result from the values that were read.
        form: what the values should be; used in error messages.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError, TypeError: naming the preset or the file.
    """
    if name.endswith((".yaml", ".yml")):
        return read_yaml(Path(name), make, form)
    if name not in known:
        raise ValueError(f"preset: expected one of {', '.join(known)}, or a YAML file, got {name!r}")
    return _parse(known[name].read_text(encoding="utf-8"), f"preset {name!r}", make, form)


def read_yaml(path: Path, make: Callable[[Mapping[str, Any]], T], form: str = "parameters by name") -> T:
    """Reads a YAML file and returns ``make(values)``; arguments as in :func:`read_preset`.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError, TypeError: invalid YAML, or an error of `make`; the message names the file.
    """
    return _parse(read_text(path, form, bounds.YAML_BYTES), str(path), make, form)


def read_assignment(assignment: str, form: str = "parameter") -> tuple[str, Any]:
    """Name and value of a command-line assignment ``name=value``; `form` shows what a name looks like.

    Raises:
        ValueError: `assignment` does not have this form, or the value is not valid YAML.
    """
    name, equals, text = map(str.strip, assignment.partition("="))
    if not equals or not name or form.count(".") != name.count("."):
        raise ValueError(f"--set: expected {form}=value, got {assignment!r}")
    with damage_is(f"{name}: expected a value, got {text!r}", yaml.YAMLError):
        return name, yaml.load(text, _Loader)


def _parse(text: str, source: str, make: Callable[[Mapping[str, Any]], T], form: str) -> T:
    with damage_is(f"{source}: not valid YAML", yaml.YAMLError):  # such as a date or a number that cannot be
        values = yaml.load(text, _Loader)
    if values is not None and not isinstance(values, dict):
        raise ValueError(f"{source}: expected {form}, got a {type(values).__name__}")
    try:
        return make(values or {})
    except (ValueError, TypeError) as error:
        raise type(error)(f"{source}: {error}") from error
    except (LookupError, AttributeError, OverflowError) as error:
        raise ValueError(f"{source}: expected {form}, got another form: {error!r}") from error


@dataclass(frozen=True)
class Config:
    """All parameters of :class:`torchjoint.JointSegmenter`; each stage documents its own parameters.

    Raises:
        ValueError, TypeError: a stage of the wrong type, or values that do not fit together, by name.
    """

    boundary: steps.BoundaryConfig = field(default_factory=steps.BoundaryConfig)
    contours: steps.ContoursConfig = field(default_factory=steps.ContoursConfig)
    image_graph: steps.ImageGraphConfig = field(default_factory=steps.ImageGraphConfig)
    image_segments: steps.ImageSegmentsConfig = field(default_factory=steps.ImageSegmentsConfig)
    point_graph: steps.PointGraphConfig = field(default_factory=steps.PointGraphConfig)
    visibility: steps.VisibilityConfig = field(default_factory=steps.VisibilityConfig)
    propagation: steps.PropagationConfig = field(default_factory=steps.PropagationConfig)
    point_segments: steps.PointSegmentsConfig = field(default_factory=steps.PointSegmentsConfig)
    scan: steps.ScanConfig = field(default_factory=steps.ScanConfig)
    refinement: steps.RefinementConfig = field(default_factory=steps.RefinementConfig)
    paper: steps.PaperConfig = field(default_factory=steps.PaperConfig)

    #: Stages of steps 6-8 whose parameters are used only after all frames, see :mod:`torchjoint.config.config`.
    afterwards: ClassVar[tuple[str, ...]] = ("scan", "refinement", "paper")
    #: Parameters of these stages (stage.parameter) that are used before, for the normals of the point graph.
    before: ClassVar[tuple[str, ...]] = ("paper.normal_neighbors",)

    def __post_init__(self) -> None:
        for name, expected in self.stages().items():
            if not isinstance(getattr(self, name), expected):
                raise TypeError(f"{name}: expected a {expected.__name__}, got {type(getattr(self, name)).__name__}")
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


C = TypeVar("C", bound=Config)


def evidence_config(config: C) -> C:
    """The config with the `afterwards` parameters at their defaults. Equal results mean equal stored evidence."""

    def kept(stage: str) -> Any:
        given = dataclasses.asdict(getattr(config, stage)).items()
        return getattr(type(config)(), stage).replace({k: v for k, v in given if f"{stage}.{k}" in config.before})

    return dataclasses.replace(config, **{stage: kept(stage) for stage in config.afterwards})


def evidence_differences(first: Config, second: Config) -> list[str]:
    """Names (stage.parameter) of the parameters that differ and that change the stored evidence."""
    one, other = evidence_config(first).to_dict(), evidence_config(second).to_dict()
    return [
        f"{stage}.{name}"
        for stage, values in one.items()
        for name, value in values.items()
        if value != other.get(stage, {}).get(name)
    ]
