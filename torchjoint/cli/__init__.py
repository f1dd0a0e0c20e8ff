"""The command line: one file a command; :mod:`torchjoint.cli.main` lists them."""

from torchjoint.cli.main import main

__all__ = ["main"]
