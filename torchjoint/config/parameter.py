"""Declaration and checks of a parameter: each is declared once, with its unit, range and effect (all steps)."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import NoneType, UnionType
from typing import Any, Self, get_args, get_type_hints


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
    too_low: str = "",
    too_high: str = "",
) -> Any:
    """Declares a parameter, a field of a :class:`Stage`.

    Args:
        default: default value.
        doc: what the parameter is, what larger and smaller values do, and for which method it counts.
        unit: unit of a number.
        low, high: smallest and largest allowed value.
        above: values must be greater than this.
        sensible: the range in which most users will find their value.
        choices: the allowed texts; "NAME.npz": each text with this end; empty: any text.
        too_low, too_high: what a result looks like if the value is too low or too high. Only the few parameters that
            users change have these texts; the documents show them in a separate table.
    """
    return field(default=default, metadata={**locals(), "choices": tuple(choices)})  # the arguments by name


@dataclass(frozen=True)
class Stage:
    """Base class of the stages: checks every parameter against its declaration when the object is made."""

    def __post_init__(self) -> None:
        kinds = get_type_hints(type(self))  # types, even if the annotations are stored as text
        for spec in dataclasses.fields(self):
            value = _check(f"{self.key()}.{spec.name}", getattr(self, spec.name), kinds[spec.name], spec.metadata)
            object.__setattr__(self, spec.name, value)

    @classmethod
    def key(cls) -> str:
        """The stage's name in a config: `image_graph` for ImageGraphConfig."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__.removesuffix("Config")).lower()

    def replace(self, values: Mapping[str, Any]) -> Self:
        """A copy with some parameters replaced, by name."""
        names = [spec.name for spec in dataclasses.fields(self)]
        if unknown := [name for name in values if name not in names]:
            raise ValueError(f"{self.key()}.{unknown[0]}: unknown parameter, expected one of {', '.join(names)}")
        return dataclasses.replace(self, **values)


def _check(name: str, value: Any, annotation: Any, declared: Mapping[str, Any]) -> Any:
    """Checks one value against its declaration. It accepts whole floats as int, and ints as float."""
    kinds = get_args(annotation) if isinstance(annotation, UnionType) else (annotation,)
    kind = next(kind for kind in kinds if kind is not NoneType)
    expected = " | ".join("null" if one is NoneType else one.__name__ for one in kinds)
    if value is None:
        if NoneType in kinds:
            return None
        raise TypeError(f"{name}: expected {expected}, got null")
    if kind is str:
        return _check_text(name, value, declared)
    if kind is bool:
        if not isinstance(value, bool):
            raise TypeError(f"{name}: expected true or false, got {value!r}")
        return value
    return _check_number(name, value, kind, expected, declared)


def _check_number(name: str, value: Any, kind: type, expected: str, declared: Mapping[str, Any]) -> int | float:
    if isinstance(value, str):  # YAML 1.1 reads 1e-3 as a string
        try:
            value = float(value)
        except ValueError:
            raise TypeError(f"{name}: expected {expected}, got {value!r}") from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{name}: expected {expected}, got {value!r}")
    if not -1e300 < value < 1e300:  # also of integers that no float can be
        raise ValueError(f"{name}: expected a finite number, got {value}")
    if kind is int and (value != int(value) or abs(value) >= 2**63):
        raise TypeError(f"{name}: expected a whole number{' of 64 bits' * (abs(value) >= 2**63)}, got {value}")
    low, high, above = (declared[key] for key in ("low", "high", "above"))
    if (low is not None and value < low) or (above is not None and value <= above):
        raise ValueError(f"{name}: expected {f'>= {low}' if low is not None else f'> {above}'}, got {value}")
    if high is not None and value > high:
        raise ValueError(f"{name}: expected <= {high}, got {value}")
    return int(value) if kind is int else float(value)


def _check_text(name: str, value: Any, declared: Mapping[str, Any]) -> str:
    """Checks a text. Without choices any text is allowed; the code that uses it checks its meaning."""
    if not isinstance(value, str):
        raise TypeError(f"{name}: expected a text, got {value!r}")
    choices = declared["choices"]
    files = tuple(choice.removeprefix("NAME") for choice in choices if choice.startswith("NAME."))  # any file's name
    if choices and value not in choices and not value.endswith(files):
        raise ValueError(f"{name}: expected one of {', '.join(choices)}, got {value!r}")
    return value
