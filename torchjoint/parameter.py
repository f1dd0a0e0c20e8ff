"""How a parameter is declared and checked: once, with its unit, range and effect."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self


def parameter(
    default: Any,
    doc: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    above: float | None = None,
    sensible: str = "",
    choices: Sequence[str] = (),
) -> Any:
    """Declares a parameter: its default, what turning it does, unit, allowed range and sensible range."""
    return field(
        default=default,
        metadata={
            "doc": doc,
            "unit": unit,
            "low": low,
            "high": high,
            "above": above,
            "sensible": sensible,
            "choices": tuple(choices),
        },
    )


@dataclass(frozen=True)
class Stage:
    """Base of the stages: checks every parameter against its declaration when the object is made."""

    def __post_init__(self) -> None:
        for spec in dataclasses.fields(self):
            value = _check(f"{self.key()}.{spec.name}", getattr(self, spec.name), spec)
            object.__setattr__(self, spec.name, value)

    @classmethod
    def key(cls) -> str:
        """The stage's name in a config: `image_graph` for ImageGraphConfig."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__.removesuffix("Config")).lower()

    def replace(self, values: Mapping[str, Any]) -> Self:
        """A copy with some parameters replaced, by name. Raises ValueError for a name that does not exist."""
        names = [spec.name for spec in dataclasses.fields(self)]
        for name in values:
            if name not in names:
                raise ValueError(f"{self.key()}.{name}: unknown parameter, expected one of {', '.join(names)}")
        return dataclasses.replace(self, **values)


def _check(name: str, value: Any, spec: dataclasses.Field[Any]) -> Any:
    """Checks one value against its declaration; whole floats pass for ints, ints for floats."""
    optional = "None" in str(spec.type)
    if value is None:
        if optional:
            return None
        raise TypeError(f"{name}: expected {spec.type}, got null")
    kind = str(spec.type).split(" |")[0]
    if kind == "str":
        return _check_text(name, value, spec.metadata["choices"])
    if kind == "bool":
        if not isinstance(value, bool):
            raise TypeError(f"{name}: expected true or false, got {value!r}")
        return value
    if isinstance(value, str):  # YAML 1.1 takes 1e-3 for a string
        try:
            value = float(value)
        except ValueError:
            raise TypeError(f"{name}: expected {spec.type}, got {value!r}") from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{name}: expected {spec.type}, got {value!r}")
    if not math.isfinite(value):
        raise ValueError(f"{name}: expected a finite number, got {value}")
    if kind == "int" and value != int(value):
        raise TypeError(f"{name}: expected a whole number, got {value}")
    low, high, above = (spec.metadata[key] for key in ("low", "high", "above"))
    if (low is not None and value < low) or (above is not None and value <= above):
        raise ValueError(f"{name}: expected {f'>= {low}' if low is not None else f'> {above}'}, got {value}")
    if high is not None and value > high:
        raise ValueError(f"{name}: expected <= {high}, got {value}")
    return int(value) if kind == "int" else float(value)


def _check_text(name: str, value: Any, choices: Sequence[str]) -> str:
    """A text without choices is free; what it means is checked where it is used."""
    if not isinstance(value, str):
        raise TypeError(f"{name}: expected a text, got {value!r}")
    if choices and value not in choices:
        raise ValueError(f"{name}: expected one of {', '.join(choices)}, got {value!r}")
    return value
