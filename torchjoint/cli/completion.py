"""torchjoint completion: prints the script that makes a shell complete commands and options."""

from __future__ import annotations

import io
from contextlib import redirect_stdout, suppress
from importlib import import_module
from typing import Literal

import tyro


def completion(shell: tyro.conf.Positional[Literal["bash", "zsh"]]) -> None:
    """Prints a script for a shell; docs/installation.md says where it belongs.

    Args:
        shell: bash or zsh.
    """
    from torchjoint.cli.main import COMMANDS

    functions = {}
    for name, command in COMMANDS.items():
        module, _, function = command.function.partition(":")
        functions[name] = getattr(import_module(module), function)
    written = io.StringIO()
    with redirect_stdout(written), suppress(SystemExit):
        tyro.extras.subcommand_cli_from_dict(functions, prog="torchjoint", args=["--tyro-print-completion", shell])
    # The script offers each line of a description as a word.
    for line in written.getvalue().splitlines():
        print(line.replace("\\n", " ") if line.startswith("COMPLETION_SPEC") else line)
