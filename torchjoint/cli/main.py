"""The entry point of the command line; lists the commands of torchjoint."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import Any

import tyro

from torchjoint.cli.benchmark import benchmark
from torchjoint.cli.demo import demo
from torchjoint.cli.evaluate import evaluate
from torchjoint.cli.evaluate_boundaries import evaluate_boundaries
from torchjoint.cli.export import export
from torchjoint.cli.paper_tables import paper_tables
from torchjoint.cli.parameters import parameters
from torchjoint.cli.segment import segment
from torchjoint.cli.show import show
from torchjoint.cli.superpoints import superpoints
from torchjoint.cli.train_boundaries import train_boundaries
from torchjoint.cli.train_boundary_model import train_boundary_model

INTERRUPTED = (
    "torchjoint: interrupted; `segment`, `benchmark --tuning`, `train-boundaries` and `train-borders` go on where they "
    "were when started again"
)


def main() -> None:
    """Entry point; prints user errors and warnings as one line."""
    warnings.formatwarning = lambda message, *_, **__: f"torchjoint: warning: {message}\n"
    try:
        commands: dict[str, Callable[..., Any]] = {
            "demo": demo,
            "segment": segment,
            "superpoints": superpoints,
            "evaluate": evaluate,
            "benchmark": benchmark,
            "train-boundaries": train_boundaries,
            "train-borders": train_boundary_model,
            "evaluate-boundaries": evaluate_boundaries,
            "paper-tables": paper_tables,
            "show": show,
            "export": export,
            "parameters": parameters,
        }
        tyro.extras.subcommand_cli_from_dict(commands, prog="torchjoint")
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except (ValueError, TypeError, OSError, ModuleNotFoundError) as error:
        sys.exit(f"torchjoint: error: {error}")
