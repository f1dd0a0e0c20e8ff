"""Reads parameters (all steps) from the package's presets, users' YAML files and command-line assignments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import yaml

from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import damage_is, read_text

T = TypeVar("T")


class _Loader(yaml.SafeLoader):
    """Refuses aliases (``*name``), because with them a short text can become a value of gigabytes."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.composer.ComposerError(None, None, "expected a value, got an alias (*name)", mark)
        return super().compose_node(parent, index)


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
    name, equals, text = assignment.partition("=")
    name = name.strip()
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
