"""Reads and writes the methods' settings for a suite, in YAML: the settings shipped with the package, or your own."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from torchjoint.config import read_yaml
from torchjoint.runtime.files import write_text
from torchjoint_lab.benchmark.methods import METHODS
from torchjoint_lab.benchmark.space import Setting


def read_settings(suite: str, file: Path | None = None) -> dict[str, Setting]:
    """Returns settings by method; a method without an entry uses its defaults.

    Raises:
        FileNotFoundError: `file` does not exist.
        ValueError: an unknown method or parameter; the message names the file and the method or parameter.
    """
    if file is not None:
        if not file.is_file():
            raise FileNotFoundError(f"--settings: {file} does not exist")
        return read_yaml(file, _checked, "methods with settings")
    shipped = resources.files("torchjoint_lab.configs").joinpath("benchmark", f"{suite}.yaml")
    return _checked(yaml.safe_load(shipped.read_text(encoding="utf-8")) or {}) if shipped.is_file() else {}


def write_settings(file: Path, settings: Mapping[str, Setting], comment: str) -> None:
    """Writes a file for :func:`read_settings`, atomically (a temporary file is renamed)."""
    own = {method: dict(setting) for method, setting in settings.items()}  # no two are one object: YAML would alias it
    write_text(file, f"# {comment}\n{yaml.safe_dump(own, sort_keys=False)}")


def _checked(values: Mapping[str, Any]) -> dict[str, Setting]:
    for method, setting in values.items():
        if method not in METHODS:
            raise ValueError(f"{method}: unknown method, expected one of {', '.join(METHODS)}")
        if not isinstance(setting, Mapping):
            raise TypeError(f"{method}: expected parameters by name, got {setting!r}")
        try:
            METHODS[method].check(dict(setting))
        except (ValueError, TypeError) as error:
            raise type(error)(f"{method}: {error}") from error
    return {method: dict(setting) for method, setting in values.items()}
