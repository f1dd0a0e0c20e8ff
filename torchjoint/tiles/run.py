"""Superpoints of LAS or LAZ files of any size: cuts tiles, segments, stitches, writes; resumable after each tile.

Temporary files are in OUT.tiles beside the result. `source.txt` identifies cloud and settings. `points/` has a file for
each tile that is not yet segmented. `cut.npz` exists when all of them are written. `labels/` has a file for each
segmented tile. The folder is deleted when the result is complete.
"""

import os
import shutil
import warnings
from collections import Counter
from collections.abc import Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from torchjoint.config import SuperpointsConfig
from torchjoint.datasets.files import clouds
from torchjoint.datasets.files.las import COPC, SUFFIXES, check_header, check_no_copc
from torchjoint.datasets.files.readers import fingerprint, unchanged
from torchjoint.engine import EngineLike, open_engine
from torchjoint.results.labelled_file import check_dimension, write_labelled
from torchjoint.runtime import outputs
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import damage_is, has_file
from torchjoint.runtime.outputs import SOURCE, check_no_input, lock, put, read_sealed, seen, settle, work_folder
from torchjoint.tiles.plan import NARROWEST, plan_tiles, survey
from torchjoint.tiles.stitching import stitch
from torchjoint.tiles.tile import TileTask, point_type, read_own, read_shared, segment_tile, split_points, tile_file

Labels = npt.NDArray[np.unsignedinteger]
#: The name of the new dimension.
DIMENSION = "superpoint"
#: Most points of a tile with its buffer: segmenting them takes about 0.7 GB.
MOST_POINTS = 2_000_000
#: So many tiles of a given size are told.
MANY = 1000
#: The name of the engine that starts no worker.
HERE = "loky:1"
#: The default buffer, in typical distances of neighbouring points.
BUFFER_SPACINGS = 60


class TiledCloud(NamedTuple):
    """The numbers of points, superpoints and tiles of a cloud."""

    num_points: int
    num_superpoints: int
    num_tiles: int


class _Cut(NamedTuple):
    """The tiles of a cloud, after their points were written."""

    num_points: int
    white: int | None
    neighbors: list[tuple[int, int]]
    checksums: list[int]  #: of the points of each tile


def superpoints_of_files(
    cloud: str | Path,
    out: str | Path,
    *,
    tile: float | None = None,
    buffer: float | None = None,
    preset: str | SuperpointsConfig = "default",
    engine: EngineLike = "loky",
    overwrite: bool = False,
    progress: bool | None = None,
) -> TiledCloud:
    """Writes LAS or LAZ files with the superpoint of each point, in bounded memory.

    The result has all dimensions and records of the cloud and the order of its points, and also a dimension
    `superpoint`. A cloud that fits in one tile gets the labels of :func:`torchjoint.superpoints`. In a larger cloud,
    superpoints that cross the edges of tiles are stitched, so labels near the edges may differ from those. Labels do
    not depend on the engine, the order in which tiles are segmented, or interruptions.

    Args:
        cloud: a .las, .laz or .copc.laz file, or a folder of such files, which together are one cloud.
        out: the file to write, .las or .laz. It cannot be .copc.laz, because COPC prescribes another order of points.
            For a folder of clouds it is a folder, in which X.copc.laz becomes X.laz.
        tile: side of a tile, metres; default: the largest tile with at most 2 million points. A tile with more points
            is always halved.
        buffer: width of the rim that a tile shares with its neighbours, metres; default: 60 x the typical distance of
            neighbouring points.
        preset: as in :func:`torchjoint.superpoints`.
        engine: where the tiles are segmented: any executor, or a name; see :func:`torchjoint.engine.open_engine`. The
            workers must be able to access the folder of `out`. "loky:1" is this process.
        overwrite: replace an earlier result.
        progress: show progress bars; None: if there is a terminal.

    Returns:
        the numbers of points, superpoints and tiles.

    Raises:
        FileNotFoundError, FileExistsError, ValueError, TypeError: the message names the file or argument and the error.
        ModuleNotFoundError: laspy, lazrs or the engine is not installed.
        ConnectionError, WorkerDied: the engine failed. The same call resumes the run.
    """
    cloud, out = Path(cloud), Path(os.path.abspath(out))
    config = preset if isinstance(preset, SuperpointsConfig) else SuperpointsConfig.from_preset(preset)
    files = _files(cloud)
    _check_sizes(tile, buffer)
    _check_output(cloud, files, out, overwrite)
    for file in (files := _with_points(files)):
        check_dimension(file, DIMENSION)
    work = out.with_name(f"{out.name}.tiles")
    busy = f"{out}: another run is writing this result; wait for it, or choose another output"
    with lock(out.with_name(f".{out.name}.lock"), busy) as held:
        if read_sealed(work / SOURCE) is not None:
            settle(work / "result", out, work / "replaced")
        before = seen(out)
        _check_output(cloud, files, out, overwrite)  # again, because another run may have made it in the meantime
        now = [fingerprint(file, changed=True) for file in files]
        work_folder(work, repr((now, tile, buffer, config, MOST_POINTS, version("torchjoint"))))
        hidden = None if progress is None else not progress  # None: if there is no terminal
        with unchanged(*files):
            cut = _cut(files, work, tile, buffer, hidden)
            _segment(cut, work, config, engine, hidden)
            num_superpoints, labels = _stitch(cut, work)
            _write(cloud, files, out, work, labels, hidden)
        held.check()
        made = work / "result" if cloud.is_dir() else work / "result" / out.name
        put(made, out, before, work / "replaced")  # all of them in one step
        shutil.rmtree(work)
    return TiledCloud(cut.num_points, num_superpoints, len(cut.checksums))


def is_las(path: Path) -> bool:
    """Whether a path is a LAS or LAZ file by its name, or a folder that has one."""
    return path.suffix.lower() in SUFFIXES or (path.is_dir() and bool(_in_folder(path)))


def _in_folder(path: Path) -> list[Path]:
    return sorted(file for file in path.glob("[!.]*") if file.suffix.lower() in SUFFIXES and has_file(file))


def _files(cloud: Path) -> list[Path]:
    if not cloud.exists():
        raise FileNotFoundError(f"{cloud}: missing; expected a .las or .laz file, or a folder of them")
    if not is_las(cloud):
        raise ValueError(f"{cloud}: expected a .las or .laz file, or a folder of them")
    if not cloud.is_dir():
        return [cloud]
    below = [file for file in cloud.glob("*/*") if file.suffix.lower() in SUFFIXES]
    others = [file for file in cloud.iterdir() if file.suffix.lower() in (".ply", ".pcd", ".e57")]
    if others or below:
        told = "only the .las and .laz files in it are read, not those in folders, nor other clouds, such as"
        warnings.warn(f"{cloud}: {told} {min(below + others)}", stacklevel=3)
    return _in_folder(cloud)


def _with_points(files: list[Path]) -> list[Path]:
    kept = [file for file in files if check_header(file).num_points]
    if 0 < len(kept) < len(files):
        told = f"{len(files) - len(kept)} of {len(files)} files have no points, and are left out"
        warnings.warn(f"{told}: {', '.join(file.name for file in files if file not in kept)[:200]}", stacklevel=3)
    return kept or files


def _check_sizes(tile: float | None, buffer: float | None) -> None:
    for name, value in (("tile", tile), ("buffer", buffer)):
        if value is not None and not 0 < value < float("inf"):
            raise ValueError(f"{name}: expected more than 0 metres, got {value}")
    if tile is not None and buffer is not None and tile < NARROWEST * buffer:
        raise ValueError(f"tile: expected at least {NARROWEST} buffers of {buffer} m, got {tile} m")


def _check_output(cloud: Path, files: Sequence[Path], out: Path, overwrite: bool) -> None:
    if not cloud.is_dir() and out.suffix.lower() not in SUFFIXES:
        raise ValueError(f"out: expected a file that ends in .las or .laz, got {out}")
    if cloud.is_dir() and out.suffix.lower() in clouds.SUFFIXES and not out.is_dir():
        raise ValueError(f"out: a folder of clouds gives a folder: expected its name, got that of a file, {out}")
    check_no_copc(out)
    if not out.parent.is_dir():
        raise FileNotFoundError(f"out: expected an existing folder, got {out.parent}")
    check_no_input(out, (cloud, *files), "out")
    if out.is_symlink() or (out.exists() and out.is_dir() != cloud.is_dir()):
        kind = "folder" if cloud.is_dir() else "file"
        raise FileExistsError(f"{out}: expected no link, and a {kind}; choose another name")
    if out.exists() and not overwrite:
        raise FileExistsError(f"{out}: exists already; choose another name, or --overwrite")
    names = Counter(_result_name(file) for file in files)
    if twice := [name for name, count in names.items() if count > 1]:
        raise ValueError(f"{cloud}: a .laz and a .copc.laz would both become {twice[0]}; rename one of them")
    if out.is_dir() and not outputs.is_as_written(out):  # surveys may have the same names
        raise FileExistsError(f"{out}: holds more than files of an earlier result, or changed ones; choose another")


def _result_name(file: Path) -> str:
    """The name of a file in a folder of results; X.copc.laz becomes X.laz, because the result is not COPC."""
    return f"{file.name[: -len(COPC)]}.laz" if file.name.lower().endswith(COPC) else file.name


def _cut(files: Sequence[Path], work: Path, tile: float | None, buffer: float | None, hidden: bool | None) -> _Cut:
    """Writes the points of all tiles, unless an earlier run has."""
    marker, folder = work / "cut.npz", work / "points"
    if not marker.is_file():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        found = survey(files, tile)
        width = BUFFER_SPACINGS * found.spacing() if buffer is None else buffer
        most = np.inf if tile is None or buffer is not None else tile / NARROWEST
        width = min(width, most, 2 * found.side * max(found.counts.shape))  # more is the same
        plan = plan_tiles(found, tile, width, MOST_POINTS)
        if len(plan.tiles) > 1 and width < (least := 5 * found.spacing()):
            told = f"a buffer of {width:.3g} m is little; below {least:.3g} m the edges of tiles show"
            warnings.warn(f"{told}: give a larger {'tile' if buffer is None else 'buffer'}", stacklevel=3)
        if tile is not None and len(plan.tiles) > MANY:
            told = f"{len(plan.tiles)} tiles for {found.num_points} points, each a file and a task of its own"
            warnings.warn(f"{told}: a larger tile, or none, is faster", stacklevel=3)
        _check_disk(work, found.num_points, found.whites is not None)
        with tqdm(total=found.num_points, desc="cut", unit="points", unit_scale=True, disable=hidden) as bar:
            checksums = split_points(files, found, plan, folder, bar.update)
        with atomic_write(marker) as partial:
            np.savez(
                partial,
                numbers=np.array([found.num_points, 65535 if found.whites else 0]),
                checksums=np.array(checksums),
                neighbors=np.array(plan.neighbors(found), np.int64).reshape(-1, 2),
            )
    with damage_is(f"{work}: damaged; remove it and start again"):
        arrays = read_archive(marker)
        num_points, white = arrays["numbers"].tolist()
        neighbors = [(one, other) for one, other in arrays["neighbors"].tolist()]
        return _Cut(num_points, white or None, neighbors, arrays["checksums"].tolist())


def _check_disk(work: Path, num_points: int, colored: bool) -> None:
    """Checks the free disk space for points and labels; buffers add at most a third, unless tiles are very narrow."""
    needed, free = int(num_points * (point_type(colored).itemsize * 1.3 + 16)), shutil.disk_usage(work).free
    if needed > free:
        raise ValueError(f"out: expected about {needed / 1e6:.1f} MB free in {work.parent}, got {free / 1e6:.1f} MB")


def _segment(cut: _Cut, work: Path, config: SuperpointsConfig, engine: EngineLike, hidden: bool | None) -> None:
    """Segments the tiles without labels, several at a time; a single tile is segmented in this process."""
    (work / "labels").mkdir(exist_ok=True)
    tasks = [
        TileTask(tile_file(work / "points", number), _labels_file(work, number), checksum)
        for number, checksum in enumerate(cut.checksums)
        if not _labels_file(work, number).is_file()
    ]
    with tqdm(total=len(cut.checksums), desc="segment", unit="tile", disable=hidden) as bar:
        bar.update(len(cut.checksums) - len(tasks))
        if len(tasks) <= 1 or engine == HERE:
            for task in tasks:
                segment_tile(cut.white, config, task)
                bar.update()
            return
        with open_engine(engine) as opened:
            for outcome in opened.run(partial(segment_tile, cut.white, config), tasks):
                if outcome.error is not None:
                    raise outcome.error
                bar.update()


def _stitch(cut: _Cut, work: Path) -> tuple[int, Labels]:
    """Stitches the tiles; returns the number of superpoints and the labels [N], mapped from disk."""
    with damage_is(f"{work}: damaged; remove it and start again"):
        of = [(_labels_file(work, number), checksum) for number, checksum in enumerate(cut.checksums)]
        counts = [len(read_shared(*one).whole_size) for one in of]
        path, dtype = work / "labels.npy", np.dtype(np.uint32 if sum(counts) <= 1 << 32 else np.uint64)
        labels = np.lib.format.open_memmap(path, "w+", dtype, (cut.num_points,))
        count = stitch(cut.neighbors, counts, lambda i: read_own(*of[i]), lambda i: read_shared(*of[i]), labels)
    del labels
    return count, np.load(path, mmap_mode="r")


def _write(cloud: Path, files: Sequence[Path], out: Path, work: Path, labels: Labels, hidden: bool | None) -> None:
    """Writes copies of the files with labels."""
    made = work / "result"
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir()
    first = 0
    with tqdm(total=len(labels), desc="write", unit="points", unit_scale=True, disable=hidden) as bar:
        for file in files:
            name = _result_name(file) if cloud.is_dir() else out.name
            first += write_labelled(file, made / name, {DIMENSION: labels[first:]}, bar.update)
    outputs.seal_files(made)


def _labels_file(work: Path, number: int) -> Path:
    return work / "labels" / f"{number:06d}.npz"
