"""Segments one tile: an independent task, which reads one file and writes one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.config import SuperpointsConfig
from torchjoint.oversegmentation import superpoints
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.files import atomic_write
from torchjoint.tiles.spill import OWN, SHARED, point_type

#: Width of the outer part of the buffer, in buffers. A superpoint that reaches it may continue outside of the buffer.
RIM = 0.1


class TileTask(NamedTuple):
    """The files and sizes that a worker needs; can be pickled."""

    points: Path  #: the file of the tile's points
    labels: Path  #: the file to write
    size: tuple[float, float]  #: metres, of the tile without its buffer
    buffer: float  #: metres


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
    records = np.fromfile(task.points, point_type(white is not None))
    points = torch.from_numpy(np.ascontiguousarray(records["xyz"]))
    colors = None if white is None else torch.from_numpy(records["rgb"].astype(np.float32) / white)
    number, kind = records["number"].copy(), records["kind"].copy()
    inside = (1 - RIM) * task.buffer  # a superpoint is whole if it reaches at most so far outside of the tile
    xy = records["xyz"][:, :2]
    at_rim = ((xy < -inside) | (xy > np.array(task.size) + inside)).any(1)
    del records
    label = superpoints(points, colors, preset=config).numpy().astype(np.int32)
    whole_size = np.bincount(label).astype(np.int32)
    whole_size[label[at_rim]] = 0
    own, shared = (kind & OWN) > 0, (kind & SHARED) > 0
    arrays: dict[str, npt.NDArray[Any]] = {
        **_prefixed("own", OwnLabels(number[own], label[own])),
        **_prefixed("shared", SharedLabels(number[shared], label[shared], own[shared], whole_size)),
    }
    with atomic_write(task.labels) as partial:
        np.savez(partial, **arrays)  # type: ignore[arg-type]
    task.points.unlink()


def _prefixed(name: str, arrays: OwnLabels | SharedLabels) -> dict[str, npt.NDArray[Any]]:
    return {f"{name}_{field}": array for field, array in arrays._asdict().items()}


def read_own(path: Path) -> OwnLabels:
    """Reads the labels of a tile's own points from the file that :func:`segment_tile` wrote.

    Raises:
        ValueError: the file is damaged; the message names it.
    """
    return OwnLabels(*_read(path, "own", OwnLabels._fields))


def read_shared(path: Path) -> SharedLabels:
    """Reads the labels of the points that are also in other tiles from the same file.

    Raises:
        ValueError: as :func:`read_own`.
    """
    return SharedLabels(*_read(path, "shared", SharedLabels._fields))


def _read(path: Path, prefix: str, fields: Sequence[str]) -> list[npt.NDArray[Any]]:
    names = [f"{prefix}_{field}" for field in fields]
    arrays = read_archive(path, names)
    if missing := set(names) - set(arrays):
        raise ValueError(f"{path}: expected the arrays {', '.join(names)}, got no {min(missing)}")
    return [arrays[name] for name in names]
