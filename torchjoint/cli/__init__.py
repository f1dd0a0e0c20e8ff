"""The command line: one file per command; :mod:`torchjoint.cli.main` lists the commands."""

from torchjoint.cli.main import main

__all__ = ["main"]
