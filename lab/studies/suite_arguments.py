"""Command-line arguments for the suite of a benchmark, and for the number of its scenes."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from torchjoint_lab.benchmark.suites import SUITES, Scenes, Suite


def add(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments to a parser."""
    parser.add_argument("suite", choices=SUITES)
    parser.add_argument("--data", type=Path, help="folder of the data; synthetic scenes need none")
    parser.add_argument("--scenes", type=int, metavar="COUNT", help="only so many scenes, evenly spread; default: all")


def suite_of(arguments: argparse.Namespace) -> Suite:
    """Returns the suite, with the requested number of scenes in each half."""
    if arguments.scenes is not None and arguments.scenes < 1:
        raise ValueError(f"--scenes: expected at least 1, got {arguments.scenes}")
    suite = SUITES[arguments.suite]
    suite = replace(
        suite, tuning=_some(suite.tuning, arguments.scenes), checking=_some(suite.checking, arguments.scenes)
    )
    suite.scenes("checking", arguments.data)  # reports an error in the folder at once
    return suite


def _some(half: Callable[[Path | None], Scenes], count: int | None) -> Callable[[Path | None], Scenes]:
    """Limits a half to `count` scenes, evenly spread, since neighbours in the list are similar."""

    def scenes(data: Path | None) -> Scenes:
        found = list(half(data).items())
        return dict(found[:: max(1, len(found) // (count or len(found)))][:count]) if found else {}

    return scenes
