"""Declared parameters: their types however annotations are stored, and their sensible ranges.

This module has no `from __future__ import annotations`, as a user's own may not have it either: annotations are types.
"""

import dataclasses
import re
from dataclasses import dataclass

import pytest

from torchjoint.config import Config, SuperpointsConfig, marked_parameters, marked_table, parameter_table
from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class TypesConfig(Stage):
    """Annotations are types."""

    count: int = parameter(3, "how many", low=1)
    share: float | None = parameter(None, "which part", high=1)
    method: str = parameter("new", "by which means", choices=("new", "other"))
    on: bool = parameter(True, "whether at all")


@dataclass(frozen=True)
class TextsConfig(Stage):
    """Annotations are texts, as `from __future__ import annotations` stores them."""

    count: "int" = parameter(3, "how many", low=1)  # noqa: RUF009
    share: "float | None" = parameter(None, "which part", high=1)  # noqa: RUF009
    method: "str" = parameter("new", "by which means", choices=("new", "other"))  # noqa: RUF009
    on: "bool" = parameter(True, "whether at all")  # noqa: RUF009


@pytest.mark.parametrize("stage", [TypesConfig, TextsConfig])
class TestBothWaysToAnnotate:
    def test_values_have_their_types(self, stage):
        made = stage(count=4.0, share=1)
        assert (made.count, type(made.count)) == (4, int)
        assert (made.share, type(made.share)) == (1.0, float)
        assert stage() == stage(count=3, share=None, method="new", on=True)

    @pytest.mark.parametrize(
        ("name", "value", "message"),
        [
            ("count", 2.5, "expected a whole number, got 2.5"),
            ("count", 1e30, "expected a whole number of 64 bits, got 1e+30"),
            ("count", None, "expected int, got null"),
            ("count", True, "expected int, got True"),
            ("count", 0, "expected >= 1, got 0"),
            ("share", "half", "expected float | null, got 'half'"),
            ("share", 2, "expected <= 1, got 2"),
            ("method", 3, "expected a text, got 3"),
            ("method", "strange", "expected one of new, other, got 'strange'"),
            ("on", 1, "expected true or false, got 1"),
        ],
    )
    def test_wrong_ones_are_refused_by_name(self, stage, name, value, message):
        with pytest.raises((TypeError, ValueError), match=re.escape(f"{stage.key()}.{name}: {message}")):
            stage(**{name: value})


EVERY = (*Config.stages().values(), SuperpointsConfig)
PARAMETERS = {f"{stage.key()}.{spec.name}": spec for stage in EVERY for spec in dataclasses.fields(stage)}


def sensible_range(spec):
    """Of a text like "0.5-3", or "null, or 0.5-3"; None if it is another one."""
    found = re.fullmatch(r"(?:null, or )?([\d.]+)-([\d.]+)", spec.metadata["sensible"])
    return found and (float(found[1]), float(found[2]))


@pytest.mark.parametrize("name", [name for name, spec in PARAMETERS.items() if sensible_range(spec)])
def test_a_default_is_sensible(name):
    spec = PARAMETERS[name]
    low, high = sensible_range(spec)
    assert low < high
    assert spec.default is None or low <= spec.default <= high
    for end in (low, high):  # and what is sensible is allowed
        assert spec.metadata["low"] is None or end >= spec.metadata["low"]
        assert spec.metadata["above"] is None or end > spec.metadata["above"]
        assert spec.metadata["high"] is None or end <= spec.metadata["high"]


def test_most_ranges_are_numbers():
    assert sum(sensible_range(spec) is not None for spec in PARAMETERS.values()) > 20


def test_there_are_not_too_many():
    assert sum(len(dataclasses.fields(stage)) for stage in Config.stages().values()) <= 40


def test_those_that_a_user_turns():
    assert len(marked_parameters()) == 5
    for name in marked_parameters():
        meta = PARAMETERS[name].metadata
        assert meta["too_low"]
        assert meta["too_high"]
        assert meta["sensible"]
        assert f"| `{name}` | {PARAMETERS[name].default} |" in marked_table()
        assert f"| `{name.partition('.')[2]}` |" in parameter_table()
    others = [spec.metadata for name, spec in PARAMETERS.items() if name not in marked_parameters()]
    assert not any(meta["too_low"] or meta["too_high"] for meta in others)
