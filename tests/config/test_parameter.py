"""Declared parameters: their types however annotations are stored, their sensible ranges, and old names.

This module has no `from __future__ import annotations`, as a user's own may not have it either: annotations are types.
"""

import dataclasses
import re
from dataclasses import dataclass
from importlib import import_module

import pytest
from torchjoint.config.removed import REMOVED

from torchjoint.config import STAGES, Config, SuperpointsConfig, marked_parameters, marked_table, parameter_table
from torchjoint.config.parameter import Stage, parameter


@dataclass(frozen=True)
class TypesConfig(Stage):
    """Annotations are types."""

    count: int = parameter(3, "how many", low=1)
    share: float | None = parameter(None, "which part", high=1)
    method: str = parameter("new", "by which means", choices=("new", "other"), renamed={"old": "new"})
    on: bool = parameter(True, "whether at all")


@dataclass(frozen=True)
class TextsConfig(Stage):
    """Annotations are texts, as `from __future__ import annotations` stores them."""

    count: "int" = parameter(3, "how many", low=1)  # noqa: RUF009
    share: "float | None" = parameter(None, "which part", high=1)  # noqa: RUF009
    method: "str" = parameter("new", "by which means", choices=("new", "other"), renamed={"old": "new"})  # noqa: RUF009
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
            ("count", None, "expected int, got null"),
            ("count", True, "expected int, got True"),
            ("count", 0, "expected >= 1, got 0"),
            ("share", "half", "expected float | null, got 'half'"),
            ("share", 2, "expected <= 1, got 2"),
            ("method", 3, "expected a text, got 3"),
            ("method", "strange", "expected one of new, other, got 'strange'"),
            ("method", "old", "'old' is now called 'new'"),
            ("on", 1, "expected true or false, got 1"),
        ],
    )
    def test_wrong_ones_are_refused_by_name(self, stage, name, value, message):
        with pytest.raises((TypeError, ValueError), match=re.escape(f"{stage.key()}.{name}: {message}")):
            stage(**{name: value})


EVERY = (*STAGES.values(), SuperpointsConfig)
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
    assert sum(len(dataclasses.fields(stage)) for stage in STAGES.values()) <= 40


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


OLD_STAGES = {
    "borders": "region_merging",
    "bridges": "occlusion_bridging",
    "confirmation": "image_support",
    "sweep": "scan",
}


class TestRemoved:
    @pytest.mark.parametrize("name", [name for name in REMOVED if "." in name])
    def test_parameters(self, tmp_path, name):
        stage, _, parameter_name = name.partition(".")
        message = rf"{stage}\.{parameter_name}: this parameter {re.escape(REMOVED[name])}$"
        with pytest.raises(ValueError, match=f"^{message}"):
            Config().set([f"{name}=1"])
        file = tmp_path / "mine.yaml"
        file.write_text(f"{stage}: {{{parameter_name}: 1}}\n")
        with pytest.raises(ValueError, match=rf"mine\.yaml: {message}"):
            Config.from_yaml(file)
        assert name not in PARAMETERS

    @pytest.mark.parametrize("stage", [name for name in REMOVED if "." not in name])
    def test_stages(self, stage):
        for parameters in ({}, {"scale": 1}):
            with pytest.raises(ValueError, match=rf"^{stage}: this stage {re.escape(REMOVED[stage])}$"):
                Config.from_dict({stage: parameters})
        assert stage not in STAGES

    @pytest.mark.parametrize("name", [name for name, reason in REMOVED.items() if "torchjoint/" in reason])
    def test_constants_are_where_the_message_says(self, name):
        constant, file = re.search(r"(\w+) in torchjoint/(\S+)\.py$", REMOVED[name]).groups()
        assert hasattr(import_module(f"torchjoint.{file.replace('/', '.')}"), constant)


class TestOldNames:
    @pytest.mark.parametrize("old", OLD_STAGES)
    def test_of_stages(self, tmp_path, old):
        file = tmp_path / "mine.yaml"
        file.write_text(f"{old}: {{}}\n")
        with pytest.raises(ValueError, match=rf"mine\.yaml: {old}: this stage is now called {OLD_STAGES[old]}$"):
            Config.from_yaml(file)
        with pytest.raises(ValueError, match=rf"^{old}: this stage is now called {OLD_STAGES[old]}$"):
            Config().set([f"{old}.threshold=1"])
        assert OLD_STAGES[old] in STAGES

    @pytest.mark.parametrize(
        ("stage", "old", "new"), [("point_segments", "sweep", "scan"), ("refinement", "spread", "geodesic")]
    )
    def test_of_choices(self, tmp_path, stage, old, new):
        file = tmp_path / "mine.yaml"
        file.write_text(f"{stage}: {{method: {old}}}\n")
        with pytest.raises(ValueError, match=rf"mine\.yaml: {stage}\.method: '{old}' is now called '{new}'$"):
            Config.from_yaml(file)
        file.write_text(f"{stage}: {{method: {new}}}\n")
        assert getattr(Config.from_yaml(file), stage).method == new
