"""The suite that a benchmark is run on, from the command line; fewer scenes of it where asked for."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path

from torchjoint.benchmark.suites import SUITES, Scenes, Suite


def add(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments."""
    parser.add_argument("suite", choices=SUITES)
    parser.add_argument("--data", type=Path, help="folder of the data; synthetic scenes need none")
    parser.add_argument("--scenes", type=int, metavar="COUNT", help="only the first scenes; default: all")


def suite_of(arguments: argparse.Namespace) -> Suite:
    """The suite, with as many scenes in each half as are wanted."""
    suite = SUITES[arguments.suite]
    suite = replace(
        suite, tuning=_first(suite.tuning, arguments.scenes), checking=_first(suite.checking, arguments.scenes)
    )
    suite.scenes("checking", arguments.data)  # an error about the folder comes at once
    return suite


def _first(half: Callable[[Path | None], Scenes], count: int | None) -> Callable[[Path | None], Scenes]:
    return lambda data: dict(islice(half(data).items(), count))
