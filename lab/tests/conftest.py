"""Fixtures of the lab's tests: those of all tests, and the lab's command line."""

import sys
import warnings
from collections.abc import Callable

import pytest
from fixtures import *  # noqa: F403 (pytest finds fixtures by name)


@pytest.fixture(scope="session")
def run_lab() -> Callable[..., None]:
    """The lab's command line: `run_lab("benchmark", "mosd", "-o", out)`."""
    from torchjoint_lab.cli import main

    def command(*arguments: object) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "argv", ["torchjoint-lab", *map(str, arguments)])
            patch.setattr(warnings, "formatwarning", warnings.formatwarning)  # `main` sets its own
            main()

    return command
