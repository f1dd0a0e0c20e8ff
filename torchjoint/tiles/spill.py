"""Writes a file for each tile: its points and those of its buffer, in the order of the cloud."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchjoint.datasets.las import LasPoints
from torchjoint.tiles.plan import Plan
from torchjoint.tiles.survey import Survey, read_points

#: Bits of `kind`: the point belongs to this tile; it is in other tiles, too.
OWN, SHARED = 1, 2


def point_type(colored: bool) -> np.dtype[Any]:
    """A point in a tile's file: number in the cloud, place relative to the tile's corner in metres, colour, bits."""
    fields: list[Any] = [("number", "<i8"), ("xyz", "<f4", 3), ("kind", "u1")]
    return np.dtype([*fields, ("rgb", "<u2", 3)] if colored else fields)


def tile_file(folder: Path, number: int) -> Path:
    """The file of a tile's points."""
    return folder / f"{number:06d}.points"


def spill_points(
    files: Sequence[Path], survey: Survey, plan: Plan, folder: Path, progress: Callable[[int], object]
) -> None:
    """Writes the points of all tiles; memory is needed for one part of the cloud at a time.

    Args:
        files: of the cloud.
        survey, plan: of the cloud.
        folder: empty.
        progress: is told the number of points of each part.
    """
    corners = np.array([tile.first for tile in plan.tiles]) * survey.side + survey.origin[:2]
    for first, points in read_points(files):
        row, tile, kind = _copies(points.xyz[:, :2], survey, plan)
        order = np.argsort(tile, kind="stable")
        row, tile, kind = row[order], tile[order], kind[order]
        starts = np.flatnonzero(np.diff(tile, prepend=-1))
        for start, end in zip(starts, [*starts[1:], len(tile)], strict=True):
            number = int(tile[start])
            corner = np.array([*corners[number], survey.origin[2]])
            records = _records(points, row[start:end], kind[start:end], first, corner, survey.white is not None)
            with tile_file(folder, number).open("ab") as stream:
                stream.write(records.tobytes())
        progress(len(points.xyz))


def _copies(
    xy: npt.NDArray[np.float64], survey: Survey, plan: Plan
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32], npt.NDArray[np.uint8]]:
    """Which point [c] is in which tile [c], and the bits of that; the copies of a tile are in the order of points.

    A tile is wider than two buffers. So if it meets the square of side 2 x buffer around a point, it holds one of the
    square's corners.
    """

    def tile_at(shift: tuple[int, int]) -> npt.NDArray[np.int32]:
        cell = survey.cells(xy + plan.buffer * np.array(shift))
        at: npt.NDArray[np.int32] = plan.of_cell[cell[:, 0], cell[:, 1]]
        return at

    own = tile_at((0, 0))
    around = np.stack([own, *(tile_at((x, y)) for x in (-1, 1) for y in (-1, 1))], axis=1)
    near = np.flatnonzero(((around != own[:, None]) & (around >= 0)).any(1))
    found = np.sort(around[near], axis=1)  # each tile once
    is_other = (found >= 0) & (found != own[near, None]) & (np.diff(found, axis=1, prepend=-2) != 0)
    of_near, column = np.nonzero(is_other)
    kind = np.full(len(xy), OWN, np.uint8)
    kind[near] |= SHARED
    row = np.concatenate([np.arange(len(xy)), near[of_near]])
    tile = np.concatenate([own, found[of_near, column]])
    kind = np.concatenate([kind, np.full(len(of_near), SHARED, np.uint8)])
    order = np.argsort(row, kind="stable")
    return row[order], tile[order], kind[order]


def _records(
    points: LasPoints,
    row: npt.NDArray[np.int64],
    kind: npt.NDArray[np.uint8],
    first: int,
    corner: npt.NDArray[np.float64],
    colored: bool,
) -> npt.NDArray[Any]:
    records = np.empty(len(row), point_type(colored))
    records["number"] = first + row
    records["xyz"] = points.xyz[row] - corner  # in float64, then rounded
    records["kind"] = kind
    if colored and points.rgb is not None:
        records["rgb"] = points.rgb[row]
    return records
