"""Superpoints of LAS and LAZ files that are larger than memory: tiles are segmented, and their superpoints stitched.

Read it in this order: :mod:`~torchjoint.tiles.plan` counts the points, and cuts the plane;
:mod:`~torchjoint.tiles.tile` writes a file of points for each tile, and segments one tile;
:mod:`~torchjoint.tiles.stitching` unites the superpoints that two tiles share, and decides where they disagree;
:mod:`~torchjoint.results.labelled_file` writes the result; :mod:`~torchjoint.tiles.run` calls them.
"""

from torchjoint.tiles.run import superpoints_of_files

__all__ = ["superpoints_of_files"]
