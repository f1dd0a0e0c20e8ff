"""The commands of torchjoint-lab, one file each; :mod:`torchjoint_lab.cli.main` lists them."""

from torchjoint_lab.cli.main import main

__all__ = ["main"]
