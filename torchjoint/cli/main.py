"""The command line."""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Mapping
from concurrent.futures import BrokenExecutor
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import version
from typing import NamedTuple, NoReturn

from torchjoint.runtime.files import cache_folder
from torchjoint.runtime.messages import in_one_line, is_out_of_memory, on_terminal

#: Exit status of a program whose output is not read to its end, and of one that is interrupted, as shells give it: 128
#: + SIGPIPE, 128 + SIGINT.
PIPE_CLOSED, STOPPED = 141, 130


class Command(NamedTuple):
    """One command."""

    function: str  #: module:function
    help: str  #: what it does, in one line


def run(program: str, commands: Mapping[str, Command], description: str, interrupted: str) -> None:
    """Runs the command that the command line names; prints user errors and warnings as one line.

    Args:
        program: name of the program, and of its distribution.
        commands: by name.
        description: for `--help`.
        interrupted: the message after Ctrl-C about commands that can be resumed.
    """
    warnings.formatwarning = lambda message, *_, **__: f"{program}: warning: {on_terminal(str(message))}\n"
    if (cache := cache_folder()) is not None:  # else matplotlib writes its list of fonts to the home folder
        os.environ.setdefault("MPLCONFIGDIR", str(cache / "matplotlib"))
    names = argparse.ArgumentParser(program, description=description, formatter_class=argparse.RawTextHelpFormatter)
    names.add_argument("-V", "--version", action="version", version=f"{program} {version(program)}")
    chosen = names.add_subparsers(title="commands", dest="command", metavar="COMMAND", required=True)
    for name, command in commands.items():
        chosen.add_parser(name, help=command.help, add_help=False)
    if not sys.argv[1:]:
        names.print_help()
        return
    for word in sys.argv[1:2]:
        if word not in commands and (similar := get_close_matches(word, commands, 1)):
            names.error(f"no command {word!r}; did you mean {similar[0]!r}?")
    try:
        command, arguments = names.parse_known_args(sys.argv[1:2])[0].command, sys.argv[2:]
        module, _, function = commands[command].function.partition(":")
        _call(getattr(import_module(module), function), f"{program} {command}", arguments)
        sys.stdout.flush()  # here, where an error of a closed pipe can still be handled
    except BrokenPipeError:  # `torchjoint parameters | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(PIPE_CLOSED)
    except KeyboardInterrupt as stop:
        print(f"{program}: interrupted; {interrupted}{f'; {stop}' if str(stop) else ''}", file=sys.stderr)
        sys.exit(STOPPED)
    except (ValueError, TypeError, OSError, ImportError, MemoryError, RecursionError, RuntimeError) as error:
        _tell(program, error)


def _call(function: object, program: str, arguments: list[str]) -> None:
    import tyro

    tyro.cli(function, prog=program, args=arguments)  # type: ignore[call-overload]


def _tell(program: str, error: Exception) -> NoReturn:
    """Exits with the message of a user error; raises any other error again, so that its traceback is printed."""
    is_users = isinstance(error, BrokenExecutor | RecursionError) or is_out_of_memory(error)
    is_users |= isinstance(error, ModuleNotFoundError)
    if isinstance(error, RuntimeError | ImportError) and not is_users:
        raise error
    sys.exit(f"{program}: error: {in_one_line(error)}")


COMMANDS = {
    "demo": Command("torchjoint.cli.demo:demo", "segments a rendered room, and scores it; needs no data"),
    "segment": Command("torchjoint.cli.segment:segment", "segments a recording: posed frames, with or without a cloud"),
    "batch": Command("torchjoint.cli.batch:batch", "segments any number of recordings over many workers"),
    "live": Command("torchjoint.cli.live:live", "plays a recording with depth, and segments what was seen so far"),
    "superpoints": Command("torchjoint.cli.superpoints:superpoints", "cuts a cloud of any size into superpoints"),
    "show": Command("torchjoint.cli.show:show", "shows a result in the browser"),
    "export": Command("torchjoint.cli.export:export", "writes a result in the format of another tool"),
    "edits": Command("torchjoint.cli.edits:edits", "brings corrections of another program back into a result"),
    "label": Command("torchjoint.cli.label:label", "puts labels into the file of a cloud, a mesh or Gaussian splats"),
    "formats": Command("torchjoint.cli.arguments:formats", "lists the formats of recordings that can be read"),
    "parameters": Command("torchjoint.cli.arguments:parameters", "prints the parameters as tables"),
    "completion": Command("torchjoint.cli.arguments:completion", "prints a script that completes commands in a shell"),
}

DESCRIPTION = """\
Joint segmentation of a point cloud and its images. The default needs no choice. --preset takes default, paper, or a
YAML file; that of superpoints takes default, scan, segmentator, or a YAML file."""

INTERRUPTED = "`segment` and `batch` resume when they are started again"


def main() -> None:
    """Entry point."""
    run("torchjoint", COMMANDS, DESCRIPTION, INTERRUPTED)
