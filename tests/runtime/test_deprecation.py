"""A deprecated name works, warns once a line, and does not outlive the version in which it goes."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import warnings

import pytest

import torchjoint
from torchjoint.runtime import deprecation
from torchjoint.runtime.deprecation import deprecated


def overdue(version):
    """The deprecations that `version` should no longer have."""
    return [entry for entry in deprecation.DEPRECATIONS if numbers(entry.gone) <= numbers(version)]


def numbers(version):
    return tuple(map(int, re.findall(r"\d+", version)[:3]))  # 0.2.0rc1 counts as 0.2.0


@pytest.fixture
def registry(monkeypatch):
    """An empty list of deprecations, so that made-up ones do not stay."""
    monkeypatch.setattr(deprecation, "DEPRECATIONS", [])
    return deprecation.DEPRECATIONS


@pytest.fixture
def twice(registry):
    @deprecated(since="0.3.0", gone="0.10.0", use="doubled", name="tj.twice")
    def twice(number, *, by=2):
        """Twice a number."""
        return number * by

    return twice


def test_the_function_stays_the_same(twice):
    assert twice.__doc__ == "Twice a number."
    assert list(inspect.signature(twice).parameters) == ["number", "by"]
    with pytest.warns(FutureWarning):
        assert twice(3, by=4) == 12


def test_the_warning_names_what_to_use(twice):
    message = r"^tj\.twice is deprecated since torchjoint 0\.3\.0, removed in 0\.10\.0: use doubled$"
    with pytest.warns(FutureWarning, match=message) as caught:
        twice(3)
    assert caught[0].filename == __file__  # it points at the caller's line


def test_each_calling_line_warns_once(twice):
    with warnings.catch_warnings(record=True) as caught:
        warnings.resetwarnings()  # Python's own rule; pytest makes warnings errors
        for number in range(3):
            twice(number)
        twice(4)
    assert len(caught) == 2


def test_without_a_name_it_is_the_module_s(registry):
    deprecated("0.2.0", "0.4.0", "nothing")(inspect.cleandoc)
    assert registry[0].name == "inspect.cleandoc"


@pytest.mark.parametrize(
    ("version", "due"),
    [
        ("0.3.0", False),
        ("0.9.9", False),
        ("0.10.0rc1", True),
        ("0.10.0", True),
        ("0.10.1", True),
        ("0.11.0", True),
        ("1.0.0", True),
    ],
)
def test_it_is_overdue_from_its_version_on(twice, version, due):
    assert [entry.name for entry in overdue(version)] == ["tj.twice"] * due


def test_the_package_has_nothing_overdue():
    """If not: remove what this lists, and say so in the changelog."""
    for module in pkgutil.walk_packages(torchjoint.__path__, "torchjoint."):
        if not module.name.startswith(("torchjoint.csrc", "torchjoint.__main__")):
            importlib.import_module(module.name)
    assert overdue(torchjoint.__version__) == []
