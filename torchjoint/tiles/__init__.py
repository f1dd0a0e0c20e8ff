"""Superpoints of LAS and LAZ files that no memory holds: the cloud is cut in tiles, and their superpoints are stitched.

Read it in this order: :mod:`~torchjoint.tiles.survey` counts the points, :mod:`~torchjoint.tiles.plan` cuts the plane,
:mod:`~torchjoint.tiles.spill` writes a file of points for each tile, :mod:`~torchjoint.tiles.tile` segments one,
:mod:`~torchjoint.tiles.stitching` unites what two tiles share, and decides where they disagree,
:mod:`~torchjoint.tiles.labelled_las` writes the result, and :mod:`~torchjoint.tiles.run` calls them.
"""

from __future__ import annotations

from torchjoint.tiles.run import superpoints_of_files

__all__ = ["superpoints_of_files"]
