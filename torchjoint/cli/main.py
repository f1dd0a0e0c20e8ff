"""The entry point of the command line; lists the commands of torchjoint."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from importlib.metadata import version
from typing import Any

import tyro
from torchjoint_lab.cli.benchmark import benchmark
from torchjoint_lab.cli.evaluate_boundaries import evaluate_boundaries
from torchjoint_lab.cli.paper_tables import paper_tables
from torchjoint_lab.cli.train_boundary_model import train_boundary_model
from torchjoint_lab.cli.train_forest import train_boundaries

from torchjoint.cli.batch import batch
from torchjoint.cli.demo import demo
from torchjoint.cli.evaluate import evaluate
from torchjoint.cli.export import export
from torchjoint.cli.parameters import parameters
from torchjoint.cli.segment import segment
from torchjoint.cli.show import show
from torchjoint.cli.superpoints import superpoints
from torchjoint.config import presets, superpoint_presets
from torchjoint.runtime.messages import in_one_line, is_out_of_memory

INTERRUPTED = (
    "torchjoint: interrupted; `segment`, `batch`, `benchmark --tuning`, `train-boundaries` and `train-borders` go on "
    "where they were when started again"
)


#: Exit status of a program whose output is not read to its end, as shells give it: 128 + SIGPIPE.
PIPE_CLOSED = 141


def main() -> None:
    """Entry point; prints user errors and warnings as one line."""
    warnings.formatwarning = lambda message, *_, **__: f"torchjoint: warning: {message}\n"
    if sys.argv[1:] == ["--version"]:
        print(f"torchjoint {version('torchjoint')}")
        return
    try:
        commands: dict[str, Callable[..., Any]] = {
            "demo": demo,
            "segment": segment,
            "batch": batch,
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
        tyro.extras.subcommand_cli_from_dict(commands, prog="torchjoint", description=_description())
        sys.stdout.flush()  # here, where a closed pipe can still be dealt with
    except BrokenPipeError:  # `torchjoint parameters | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(PIPE_CLOSED)
    except KeyboardInterrupt as stop:
        sys.exit(f"{INTERRUPTED}{f'; {stop}' if str(stop) else ''}")
    except (ValueError, TypeError, OSError, ModuleNotFoundError, MemoryError, RecursionError, RuntimeError) as error:
        sys.exit(f"torchjoint: error: {_message(error)}")


def _description() -> str:
    return (
        "Joint segmentation of a point cloud and its images. The default needs no choice; --preset takes "
        f"{', '.join(presets())}, or a YAML file; of `superpoints`: {', '.join(superpoint_presets())}. "
        "`torchjoint parameters` lists the parameters, `torchjoint --version` prints the version."
    )


def _message(error: Exception) -> str:
    """What went wrong, for a user; an error of the package itself is raised again, with its traceback."""
    is_users = isinstance(error, BrokenExecutor | RecursionError) or is_out_of_memory(error)
    if isinstance(error, RuntimeError) and not is_users:
        raise error
    return in_one_line(error)
