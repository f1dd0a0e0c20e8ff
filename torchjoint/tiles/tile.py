"""Segments one tile: an independent task, which reads one file and writes one."""

import math
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.ndimage import maximum_filter, minimum_filter

from torchjoint.config import SuperpointsConfig
from torchjoint.oversegmentation import superpoints
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import read_file
from torchjoint.tiles.plan import Plan, Survey, read_points

Array = npt.NDArray[Any]
#: Bits of `kind`: the point belongs to this tile; it is also in other tiles; it is in the outer part of the buffer.
OWN, SHARED, AT_RIM = 1, 2, 4
#: Width of that part, in buffers. A superpoint that reaches it may continue outside of the buffer.
RIM = 0.1


def point_type(colored: bool) -> np.dtype[Any]:
    """The type of a point in a tile's file: number in the cloud, coordinates of the cloud, bits, colour."""
    fields: list[Any] = [("number", "<i8"), ("xyz", "<f8", 3), ("kind", "u1")]
    return np.dtype([*fields, ("rgb", "<u2", 3)] if colored else fields)


def tile_file(folder: Path, number: int) -> Path:
    """The file of a tile's points."""
    return folder / f"{number:06d}.points"


def split_points(
    files: Sequence[Path], survey: Survey, plan: Plan, folder: Path, progress: Callable[[int], object]
) -> list[int]:
    """Writes the points of all tiles, and returns their checksums; only one part of the cloud is in memory at a time.

    Args:
        files: of the cloud.
        survey, plan: of the cloud.
        folder: an empty folder.
        progress: is called with the number of points of each part.
    """
    inside = (1 - RIM) * plan.buffer  # a superpoint is whole if it reaches at most so far outside of the tile
    low = np.array([tile.first for tile in plan.tiles]) * survey.side + survey.origin[:2] - inside
    high = np.array([tile.end for tile in plan.tiles]) * survey.side + survey.origin[:2] + inside
    alone, checksums = _cells_of_one_tile(survey, plan), [0] * len(plan.tiles)
    for first, points in read_points(files, survey.whites):
        xy = points.xyz[:, :2]
        row, tile, kind = _copies(xy, survey, plan, alone)
        kind[((xy[row] < low[tile]) | (xy[row] > high[tile])).any(1)] |= AT_RIM
        records = np.empty(len(row), point_type(survey.whites is not None))
        records["number"], records["xyz"], records["kind"] = first + row, points.xyz[row], kind
        if survey.whites is not None and points.rgb is not None:
            records["rgb"] = points.rgb[row]
        starts = np.flatnonzero(np.diff(tile, prepend=-1))
        for start, end in zip(starts, [*starts[1:], len(tile)], strict=True):
            number, data = int(tile[start]), records[start:end].tobytes()
            checksums[number] = zlib.crc32(data, checksums[number])
            with tile_file(folder, number).open("ab") as stream:
                stream.write(data)
        progress(len(points.xyz))
    return checksums


def _cells_of_one_tile(survey: Survey, plan: Plan) -> npt.NDArray[np.bool_]:
    """[columns, rows] whether the points of a cell are in one tile only: all cells within a buffer are of its tile."""
    width, none = 2 * math.ceil(plan.buffer / survey.side) + 1, np.iinfo(np.int32).max
    highest = maximum_filter(plan.of_cell, width, mode="nearest")
    return highest == minimum_filter(np.where(plan.of_cell < 0, none, plan.of_cell), width, mode="nearest")


def _copies(
    xy: npt.NDArray[np.float64], survey: Survey, plan: Plan, alone: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32], npt.NDArray[np.uint8]]:
    """Lists the copies of points in tiles: the point [c], the tile [c] and the bits [c], sorted by tile, then point.

    A tile is wider than two buffers. So if it intersects the square of side 2 x buffer around a point, it contains a
    corner of the square. Most points are far from the edges of tiles: their cells are `alone`.
    """
    cell = survey.cells(xy)
    own = plan.of_cell[cell[:, 0], cell[:, 1]]
    near = np.flatnonzero(~alone[cell[:, 0], cell[:, 1]])
    around = np.empty((len(near), 4), np.int32)
    for number, corner in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
        cell = survey.cells(xy[near] + plan.buffer * np.array(corner))
        around[:, number] = plan.of_cell[cell[:, 0], cell[:, 1]]
    around.sort(axis=1)  # each tile once
    is_other = (around >= 0) & (around != own[near, None]) & (np.diff(around, axis=1, prepend=-2) != 0)
    of_near, column = np.nonzero(is_other)
    kind = np.full(len(xy), OWN, np.uint8)
    kind[near[of_near]] |= SHARED
    row = np.concatenate([np.arange(len(xy)), near[of_near]])
    tile = np.concatenate([own, around[of_near, column]])
    kind = np.concatenate([kind, np.full(len(of_near), SHARED, np.uint8)])
    order = np.lexsort((row, tile)) if len(of_near) else np.argsort(tile, kind="stable")
    return row[order], tile[order], kind[order]


class TileTask(NamedTuple):
    """The files that a worker needs; can be pickled."""

    points: Path  #: the file of the tile's points
    labels: Path  #: the file to write
    checksum: int  #: of the file of the points


class OwnLabels(NamedTuple):
    """Superpoints of the points that a tile owns."""

    point: npt.NDArray[np.int64]  #: [n] ascending
    superpoint: npt.NDArray[np.int32]  #: [n] numbered in the tile


class SharedLabels(NamedTuple):
    """Superpoints of the points of a tile that are also in other tiles; the tile owns only some of them."""

    point: npt.NDArray[np.int64]  #: [m] ascending
    superpoint: npt.NDArray[np.int32]  #: [m] numbered in the tile
    is_own: npt.NDArray[np.bool_]  #: [m] whether the tile owns the point
    whole_size: npt.NDArray[np.int32]  #: [K] points of each superpoint; 0: it may continue beyond the buffer


def segment_tile(white: int | None, config: SuperpointsConfig, task: TileTask) -> None:
    """Segments the points of a tile and its buffer, writes the labels, and removes the file of the points.

    If a worker dies between these steps, another worker may get the tile; finished steps are not repeated.

    Args:
        white: the colour value of full brightness; None: there are no colours.
        config: parameters of the superpoints.
        task: the files.
    """
    if task.labels.is_file():
        task.points.unlink(missing_ok=True)
        return
    data = read_file(task.points, "points of a tile") if task.points.is_file() else b""
    if zlib.crc32(data) != task.checksum:
        raise ValueError(f"{task.points}: damaged or lost; remove {task.points.parents[1]} and start again")
    records = np.frombuffer(data, point_type(white is not None))
    points = torch.from_numpy(records["xyz"].copy())
    colors = None if white is None else torch.from_numpy(records["rgb"].astype(np.float32) / white)
    number, kind = records["number"].copy(), records["kind"].copy()
    del records, data
    label = superpoints(points, colors, preset=config).numpy().astype(np.int32)
    label[label < 0] = label.max() + 1  # beams without return: the dimension has no -1
    whole_size = np.bincount(label).astype(np.int32)
    whole_size[label[(kind & AT_RIM) > 0]] = 0
    own, shared = (kind & OWN) > 0, (kind & SHARED) > 0
    # The names of the arrays say of which points they are, so that another tile's file is none of this one.
    arrays = _prefixed(f"own_{task.checksum}", OwnLabels(number[own], label[own]))
    arrays |= _prefixed(f"shared_{task.checksum}", SharedLabels(number[shared], label[shared], own[shared], whole_size))
    with atomic_write(task.labels) as partial:
        np.savez(partial, **arrays)  # type: ignore[arg-type]
    task.points.unlink()


def _prefixed(name: str, arrays: OwnLabels | SharedLabels) -> dict[str, npt.NDArray[Any]]:
    return {f"{name}_{field}": array for field, array in arrays._asdict().items()}


def read_own(path: Path, checksum: int) -> OwnLabels:
    """Reads the labels of a tile's own points from the file that :func:`segment_tile` wrote."""
    return OwnLabels(*_read(path, f"own_{checksum}", OwnLabels._fields))


def read_shared(path: Path, checksum: int) -> SharedLabels:
    """Reads the labels of the points that are also in other tiles from the same file."""
    return SharedLabels(*_read(path, f"shared_{checksum}", SharedLabels._fields))


def _read(path: Path, prefix: str, fields: Sequence[str]) -> list[npt.NDArray[Any]]:
    names = [f"{prefix}_{field}" for field in fields]
    arrays = read_archive(path, names)
    if set(names) - set(arrays):
        raise ValueError(f"{path}: expected the labels of this tile, got others")
    return [arrays[name] for name in names]
