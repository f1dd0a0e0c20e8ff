"""The command line."""

import argparse
import gc
import io
import logging
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager, suppress
from dataclasses import is_dataclass
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import version
from inspect import cleandoc, signature
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, NamedTuple, NoReturn, get_args, get_origin, get_type_hints

from torchjoint.runtime.files import cache_folder
from torchjoint.runtime.messages import in_one_line, is_out_of_memory, on_terminal

#: Exit status of a program whose output is not read to its end, and of one that is interrupted, as shells give it: 128
#: + SIGPIPE, 128 + SIGINT.
PIPE_CLOSED, STOPPED = 141, 130

PLAIN = (Path, str, int, float)
#: Values in the help that are not called as their argument.
VALUES = dict.fromkeys(("voxel_size", "thin", "merge_within", "step", "tile", "buffer"), "METRES")
VALUES |= dict.fromkeys(("threads", "max_frames", "every", "views", "rate"), "N")
VALUES |= dict.fromkeys(("up", "viewpoint"), "X Y Z") | dict.fromkeys(("static", "rerun"), "FILE")
VALUES |= {"set": "NAME=VALUE ...", "topics": "ROLE=TOPIC ...", "scenes": "SCENE ...", "time_limit": "SECONDS"}
VALUES |= {"granularity": "LEVEL", "least_opacity": "OPACITY", "host": "ADDRESS", "text_encoder": "MODULE:FUNCTION"}
VALUES |= {"memory": "SIZE", "turn": "DEGREES"}


class Command(NamedTuple):
    """One command: the function of its name, with _ for -, in the module of this name."""

    help: str  #: what it does, in one line
    example: str  #: arguments of a common call
    module: str = ""  #: the function's module, if it has another name


def run(program: str, commands: Mapping[str, Command], description: str, interrupted: str) -> None:
    """Runs the command that the command line names; prints user errors and warnings as one line.

    Args:
        program: name of the program, and of its distribution; the commands are in the folder cli of its package.
        commands: by name.
        description: for `--help`.
        interrupted: the message after Ctrl-C about commands that can be resumed.
    """
    _prepare(program)
    names = argparse.ArgumentParser(program, description=description, formatter_class=argparse.RawTextHelpFormatter)
    names.add_argument("-V", "--version", action="version", version=f"{program} {version(program)}")
    listed = names.add_subparsers(title="commands", dest="command", metavar="COMMAND", required=True)
    for name, command in commands.items():
        listed.add_parser(name, help=command.help, add_help=False)
    if not sys.argv[1:]:
        names.print_help()
        return
    for word in sys.argv[1:2]:
        if word not in commands and (similar := get_close_matches(word, commands, 1)):
            names.error(f"no command {word!r}; did you mean {similar[0]!r}?")
    try:
        command, arguments = names.parse_known_args(sys.argv[1:2])[0].command, sys.argv[2:]
        try:
            os.getcwd()
        except FileNotFoundError as error:  # torch would find its own library no more, and abort
            raise FileNotFoundError("the current folder was deleted; change to another one") from error
        function = _loaded(program, command, commands[command].module)
        _call(function, f"{program} {command}", arguments, commands[command].example)
        sys.stdout.flush()  # here, where an error of a closed pipe can still be handled
    except BrokenPipeError as error:  # `torchjoint parameters | head`
        with suppress(BrokenPipeError):
            print(flush=True)
            _tell(program, error)  # stdout is open: another pipe, such as a worker's
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(PIPE_CLOSED)
    except KeyboardInterrupt as stop:
        print(f"{program}: interrupted; {interrupted}{f'; {stop}' if str(stop) else ''}", file=sys.stderr)
        sys.exit(STOPPED)
    except (ValueError, TypeError, OSError, ImportError, MemoryError, RecursionError, RuntimeError) as error:
        _tell(program, error)


def _prepare(program: str) -> None:
    """Makes streams, warnings and matplotlib fit for a program that others call."""
    for stream in ("stdin", "stdout", "stderr"):
        if getattr(sys, stream) is None:  # closed, as by >&-; the next file to be opened would have its number
            setattr(sys, stream, nothing := open(os.devnull, "r+"))  # noqa: SIM115
            os.set_inheritable(nothing.fileno(), True)  # for workers
    if isinstance(sys.stdout, io.TextIOWrapper):  # a name may have letters that the terminal lacks
        sys.stdout.reconfigure(errors="backslashreplace")
    told = set()

    def once(message: Warning | str, *_: object, **__: object) -> str:  # each frame may give the same warning
        line = "" if str(message) in told else f"{program}: warning: {on_terminal(str(message))}\n"
        told.add(str(message))
        return line

    warnings.formatwarning = once
    if (cache := cache_folder()) is not None:  # else matplotlib writes its list of fonts to the home folder
        os.environ.setdefault("MPLCONFIGDIR", str(cache / "matplotlib"))


def _loaded(program: str, command: str, module: str) -> Callable[..., None]:
    """The function of a command. An interruption while its module loads ends the program at once."""
    # Modules that load turn it into other errors, or abort.
    before = signal.signal(signal.SIGINT, lambda *_: before == signal.SIG_IGN or os._exit(STOPPED))
    gc.disable()  # a search for garbage would walk through all of torch, again and again
    try:
        name = command.replace("-", "_")
        return getattr(import_module(f"{program.replace('-', '_')}.cli.{module or name}"), name)
    finally:
        signal.signal(signal.SIGINT, before)
        gc.freeze()
        gc.enable()


def _call(function: Callable[..., None], program: str, arguments: list[str], example: str) -> None:
    import tyro

    _name_values(function)
    if {"-h", "--help"} & set(arguments):  # tyro would leave out what stands before it: the `import` of `edits import`
        arguments = ["--help"]
    text = f"Example: {program} {example}\n\n" + cleandoc(function.__doc__ or "").partition("\n\nArgs:")[0]
    tyro.cli(function, prog=program, args=arguments, description=text, config=(tyro.conf.FlagCreatePairsOff,))


def _name_values(owner: Any) -> None:
    """Names the values in the help of a function or dataclass as the text does: METRES; else by the argument: OUT."""
    import tyro

    if owner.__doc__:  # tyro would keep some ends of its lines
        owner.__doc__ = re.sub(r"\n {8,}(?=\S)", " ", cleandoc(owner.__doc__))
    defaults = {name: parameter.default for name, parameter in signature(owner).parameters.items()}
    for name, hint in get_type_hints(owner, include_extras=True).items():
        kind, extras = (hint.__origin__, hint.__metadata__) if get_origin(hint) is Annotated else (hint, ())
        if is_dataclass(kind):
            _name_values(kind)
        is_union = isinstance(kind, UnionType)
        parts = [one for one in get_args(kind) if one is not type(None)] if is_union else [kind]
        is_named = any(getattr(extra, "metavar", None) for extra in extras)
        is_left_out, is_tuple = is_union and defaults.get(name) is None, get_origin(parts[0]) is tuple
        if name == "return" or is_named or len(parts) != 1 or not (is_tuple or parts[0] in (bool, *PLAIN)):
            continue
        value = None if kind is bool else VALUES.get(name, name.upper())
        # Neither "(default: None)" nor "(default: False)" nor "(default: )".
        hide = "" if kind is bool or is_left_out or is_tuple else None
        # A type or None would be tried as None, too, and a wrong value would be two errors.
        made: Any = parts[0] if is_left_out and parts[0] in PLAIN else None
        more = tyro.conf.arg(metavar=value, help_behavior_hint=hide, constructor=made)
        owner.__annotations__[name] = Annotated[hint, more]


def _tell(program: str, error: Exception) -> NoReturn:
    """Exits with the message of a user error; raises any other error again, so that its traceback is printed."""
    is_users = isinstance(error, BrokenExecutor | RecursionError | ModuleNotFoundError) or is_out_of_memory(error)
    if isinstance(error, RuntimeError | ImportError) and not is_users:
        raise error
    sys.exit(f"{program}: error: {in_one_line(error)}")


COMMANDS = {
    "demo": Command("segments a rendered room, and scores it; needs no data", "--show"),
    "segment": Command("segments a recording: posed frames, with or without a cloud", "my_recording -o result"),
    "batch": Command("segments any number of recordings over many workers", "scans/* -o results"),
    "live": Command("plays a recording with depth, and segments what was seen so far", "my_recording --show"),
    "superpoints": Command("cuts a cloud of any size into superpoints", "cloud.laz -o superpoints.laz"),
    "show": Command("shows a result in the browser", "result"),
    "export": Command("writes a result in the format of another tool", "result --format coco"),
    "edits": Command("brings corrections of another program back into a result", "import result boxes.json"),
    "label": Command("puts labels into the file of a cloud, a mesh or Gaussian splats", "result site.laz -o out.laz"),
    "formats": Command("lists the formats of recordings that can be read", "| grep depth", module="arguments"),
    "parameters": Command("prints the parameters as tables", "paper", module="arguments"),
}

DESCRIPTION = """\
Examples: torchjoint demo --show
          torchjoint segment my_recording -o result && torchjoint show result

Joint segmentation of a point cloud and its images. The default needs no choice. --preset takes default, paper,
scan, or a YAML file; that of superpoints takes default, scan, segmentator, or a YAML file."""

INTERRUPTED = "`segment` and `batch` resume when they are started again"


class _Formatter(logging.Formatter):
    """Messages may have names of others."""

    def format(self, record: logging.LogRecord) -> str:
        return on_terminal(super().format(record))


@contextmanager
def _printed_log() -> Iterator[None]:
    """Inside the block, log messages of the package are printed to stderr as ``torchjoint: ...``."""
    logger, handler = logging.getLogger("torchjoint"), logging.StreamHandler(sys.stderr)
    handler.setFormatter(_Formatter("torchjoint: %(message)s"))
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


def main() -> None:
    """Entry point."""
    with _printed_log():
        run("torchjoint", COMMANDS, DESCRIPTION, INTERRUPTED)
