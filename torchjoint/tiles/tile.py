"""Segments one tile: a task of its own, which reads one file and writes one."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.config import SuperpointsConfig
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.files import atomic_write
from torchjoint.superpoints import superpoints
from torchjoint.tiles.spill import OWN, SHARED, point_type


class TileTask(NamedTuple):
    """All that a worker needs; it can be pickled."""

    points: Path  #: the file of the tile's points
    labels: Path  #: the file to write


class TileLabels(NamedTuple):
    """Superpoints of a tile, numbered in the tile."""

    own: npt.NDArray[np.int64]  #: [n] the tile's own points, ascending
    own_label: npt.NDArray[np.int32]  #: [n]
    shared: npt.NDArray[np.int64]  #: [m] own and others' points that are in other tiles, too, ascending
    shared_label: npt.NDArray[np.int32]  #: [m]


def segment_tile(white: int | None, config: SuperpointsConfig, task: TileTask) -> None:
    """Segments the points of a tile and its buffer, writes the labels, and removes the file of the points.

    A worker may die between these steps, and the tile may be given to another: what is done is not done again.

    Args:
        white: as of a survey.
        config: of the superpoints.
        task: the files.
    """
    if task.labels.is_file():
        task.points.unlink(missing_ok=True)
        return
    records = np.fromfile(task.points, point_type(white is not None))
    points = torch.from_numpy(np.ascontiguousarray(records["xyz"]))
    colors = None if white is None else torch.from_numpy(records["rgb"].astype(np.float32) / white)
    number, kind = records["number"].copy(), records["kind"].copy()
    del records
    label = superpoints(points, colors, preset=config).numpy().astype(np.int32)
    own, shared = (kind & OWN) > 0, (kind & SHARED) > 0
    arrays: dict[str, npt.NDArray[Any]] = TileLabels(number[own], label[own], number[shared], label[shared])._asdict()
    with atomic_write(task.labels) as partial:
        np.savez(partial, **arrays)  # type: ignore[arg-type]
    task.points.unlink()


def read_labels(path: Path) -> TileLabels:
    """Reads what :func:`segment_tile` wrote.

    Raises:
        ValueError: the file is damaged; the message names it.
    """
    arrays = read_archive(path)
    if set(arrays) != set(TileLabels._fields):
        raise ValueError(f"{path}: expected the arrays {', '.join(TileLabels._fields)}, got {', '.join(arrays)}")
    return TileLabels(**arrays)
