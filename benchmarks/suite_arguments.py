"""The suite that a benchmark is run on, from the command line; fewer scenes of it where asked for."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from torchjoint.benchmark.suites import SUITES, Scenes, Suite


def add(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments."""
    parser.add_argument("suite", choices=SUITES)
    parser.add_argument("--data", type=Path, help="folder of the data; synthetic scenes need none")
    parser.add_argument("--scenes", type=int, metavar="COUNT", help="only so many scenes, evenly spread; default: all")


def suite_of(arguments: argparse.Namespace) -> Suite:
    """The suite, with as many scenes in each half as are wanted."""
    if arguments.scenes is not None and arguments.scenes < 1:
        raise ValueError(f"--scenes: expected at least 1, got {arguments.scenes}")
    suite = SUITES[arguments.suite]
    suite = replace(
        suite, tuning=_some(suite.tuning, arguments.scenes), checking=_some(suite.checking, arguments.scenes)
    )
    suite.scenes("checking", arguments.data)  # an error about the folder comes at once
    return suite


def _some(half: Callable[[Path | None], Scenes], count: int | None) -> Callable[[Path | None], Scenes]:
    """As many, evenly spread: neighbours in the list are much alike."""

    def scenes(data: Path | None) -> Scenes:
        found = list(half(data).items())
        return dict(found[:: max(1, len(found) // (count or len(found)))][:count]) if found else {}

    return scenes
