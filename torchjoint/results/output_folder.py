"""The folder that a run writes its result to. One run at a time writes it, and it is replaced as a whole.

A run writes to a partial folder, OUT.partial. After the last file it writes a marker, `complete.txt`. From then on the
partial folder is the result: a later run that finds the marker finishes the following steps. An earlier result is
moved into the partial folder, as `.replaced`, then the partial folder is renamed to OUT, then the earlier result is
deleted. OUT cannot be renamed if a file system is mounted there (a container's volume), or if its parent folder is
read-only. Then the partial folder is inside OUT, and the contents of OUT are moved one by one.

Markers count only in the folder that the run made (:mod:`torchjoint.runtime.outputs`). What the run did not see at
OUT when it began is not replaced (:mod:`torchjoint.runtime.outputs`): the result then waits in the partial folder.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

from torchjoint.config import Config
from torchjoint.results.edits import FILE as EDITS
from torchjoint.results.folder import PARTS, is_part, read_result, write_result
from torchjoint.results.manifest import listed_files
from torchjoint.results.parts import Parts
from torchjoint.results.result import Result
from torchjoint.runtime import outputs
from torchjoint.runtime.files import FULL, PARTIAL, no_link
from torchjoint.runtime.foreign_files import damage_is
from torchjoint.runtime.messages import printable
from torchjoint.runtime.threads import on_cpu

#: Files in a partial folder: the marker that it is complete; the marker that the earlier result has moved.
COMPLETE, PLACING = "complete.txt", "placing.txt"

#: The folder in a partial folder that the earlier result moves to.
REPLACED = ".replaced"

#: A folder in a partial folder, with the files that only resuming needs. It is no part of the result.
STATE = "state"


class _Marker(NamedTuple):
    """What the marker of a complete result says."""

    key: str  #: of the run
    before: outputs.Seen  #: what stood at OUT when the run began, and may be replaced

    def write(self, file: Path) -> None:
        outputs.write_sealed(file, json.dumps([self.key, sorted(self.before)]))

    @classmethod
    def read(cls, file: Path) -> _Marker | None:
        """None if there is no marker, or one that no run wrote there."""
        if (text := outputs.read_sealed(file)) is None:
            return None
        with damage_is(f"{file}: damaged; move its folder, then start again"):
            key, before = json.loads(text)
            return cls(str(key), frozenset((str(name), int(time), int(size)) for name, time, size in before))


@dataclass(frozen=True)
class _Places:
    """The paths that a run uses while it writes a result."""

    out: Path
    partial: Path
    lock: Path
    inside: bool  #: whether partial and lock are inside OUT

    @classmethod
    def of(cls, out: Path) -> _Places:
        if outputs.is_fixed(out):
            return cls(out, out / ".partial", out / ".lock", True)
        return cls(out, out.with_name(f"{out.name}.partial"), out.with_name(f".{out.name}.lock"), False)

    @property
    def own(self) -> set[Path]:
        return {self.partial, self.lock}

    def seen(self) -> outputs.Seen:
        """What stands at OUT, without the files of this module."""
        return outputs.seen(self.out, {path.name for path in self.own} if self.inside else ())


def own_files(out: Path) -> set[Path]:
    """OUT, and all paths that a run writes beside it."""
    out = Path(os.path.abspath(out))
    return {out, *_Places.of(out).own}


@contextmanager
def output_folder(
    out: Path, source: str, *, key: str = "", overwrite: bool = False, inputs: Sequence[Path | None] = ()
) -> Iterator[Path | None]:
    """Yields a temporary folder, which becomes `out` on success. After an error it stays if it has a `key`, to resume.

    Args:
        out: the result's folder.
        source: describes the input of the result; a partial result of another source is deleted.
        key: describes input and parameters. If an earlier run with this key was killed after its last file, its result
            becomes `out`. Then nothing is left to do, and None is yielded.
        overwrite: replace an earlier result; only a result is replaced: an empty folder, or one with a run.yaml and
            nothing else than results have.
        inputs: what the run reads; `out` must not contain it.
    """
    outputs.check_no_input(out, inputs)
    if is_part(out):
        raise ValueError(f"-o: expected a path outside of the parts of a result, got {out}")
    out = Path(os.path.abspath(out))
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise FileExistsError(f"{out}: exists and is not a folder; choose another name for the output")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise type(error)(f"-o: {out}: its folder cannot be made: {error.strerror}") from error
    places = _Places.of(out)
    for path in places.own:
        no_link(path)
    if not os.access(places.lock.parent, os.W_OK | os.X_OK):
        raise PermissionError(f"{out}: the folder {places.lock.parent} cannot be written; choose another output")
    busy = f"{out}: another run is writing this result; wait for it, or choose another output"
    with outputs.lock(places.lock, busy) as held:
        finished = _finish_earlier(places, overwrite)
        if key and finished == key:
            yield None
            return
        before = places.seen()  # first: what comes after the check is not replaced, either
        _check_replaceable(places, overwrite)
        outputs.work_folder(places.partial, source)
        try:
            yield places.partial
        except BaseException as error:
            if isinstance(error, OSError) and error.errno in FULL:  # which name no file
                error.filename = error.filename or str(places.partial)
            is_ours = held.is_held() and places.partial.is_dir()
            if is_ours and (not key or [path.name for path in places.partial.iterdir()] == [outputs.SOURCE]):
                shutil.rmtree(places.partial)  # nothing to resume
            raise
        held.check()
        _Marker(key, before).write(places.partial / COMPLETE)
        _place(places, before)


def _finish_earlier(places: _Places, overwrite: bool) -> str | None:
    """Finishes the steps of a killed run; returns the key of its result, or None if there is nothing to finish."""
    partial, out = places.partial, places.out
    if (marker := _Marker.read(partial / PLACING)) is not None:
        _place(places, marker.before)
    elif (marker := _Marker.read(partial / COMPLETE)) is not None:
        before = places.seen()
        if overwrite or before - marker.before:
            _check_replaceable(places, overwrite)
        _place(places, before | marker.before)
    elif (marker := _Marker.read(out / COMPLETE)) is not None:
        _tidy(out, COMPLETE)
    return None if marker is None else marker.key


def _place(places: _Places, before: outputs.Seen) -> None:
    """Turns the complete partial folder into the result; can be repeated after a kill at any step."""
    partial = places.partial
    shutil.rmtree(partial / STATE, ignore_errors=True)
    (partial / outputs.SOURCE).unlink(missing_ok=True)
    if places.inside:
        _fill(places, before)
    else:
        outputs.put(partial, places.out, before, partial / REPLACED)
        _tidy(places.out, COMPLETE)


def _fill(places: _Places, before: outputs.Seen) -> None:
    """Moves the contents of OUT into the partial folder, and those of the partial folder to OUT."""
    out, partial, replaced = places.out, places.partial, places.partial / REPLACED
    if not (partial / PLACING).is_file():
        outputs.check_unchanged(out, before, {path.name for path in places.own})
        replaced.mkdir(exist_ok=True)
        for name in outputs.entries(before):
            if os.path.lexists(out / name):
                os.replace(out / name, replaced / name)
        os.replace(partial / COMPLETE, partial / PLACING)
    for path in sorted(partial.iterdir()):
        if path.name not in (PLACING, REPLACED):
            outputs.move_new(path, out / path.name)
    _tidy(partial, PLACING)
    partial.rmdir()


def _tidy(folder: Path, marker: str) -> None:
    """Deletes the earlier result, and then the marker."""
    if (folder / REPLACED).is_dir():
        shutil.rmtree(folder / REPLACED)
    (folder / marker).unlink()


#: Hidden files that systems and writers leave in any folder.
_LEFT = (".DS_Store", "._*", ".directory", ".nfs*", ".fuse_hidden*", f"{PARTIAL}*", ".*.lock")


def _is_left(path: Path) -> bool:
    is_filled_lock = path.suffix == ".lock" and path.lstat().st_size > 0  # ours are empty
    return any(fnmatch(path.name, name) for name in _LEFT) and not (path.is_dir() or is_filled_lock)


def _others(path: Path, frames: set[str]) -> Iterator[Path]:
    """What is in a part of a result, and not of one of its frames, if they are known."""
    for one in path.iterdir() if path.is_dir() and not path.is_symlink() else ():
        is_own = one.suffix in (".png", ".jpg") and not one.is_dir() and (not frames or one.stem in frames)
        if not is_own and not _is_left(one):
            yield one


def _check_replaceable(places: _Places, overwrite: bool) -> None:
    out = places.out
    if not out.exists():
        return
    if not overwrite:
        raise FileExistsError(f"{out}: exists already; choose another folder, or --overwrite")
    if (out / EDITS).exists():
        raise FileExistsError(f"{out / EDITS}: has corrections by hand; move or delete it, then start again")
    if outputs.entries(places.seen()) and not (out / "run.yaml").is_file():
        raise FileExistsError(f"{out}: expected a result of torchjoint, which has a run.yaml; it is not overwritten")
    frames = {Path(name).stem for name in listed_files(out)}
    for path in (out / name for name in outputs.entries(places.seen())):
        is_part = _is_left(path) or any(fnmatch(path.name, part) for part in (*PARTS, COMPLETE))
        if other := next(_others(path, frames), None) if is_part else path:
            raise FileExistsError(f"{other}: is of no result of torchjoint; move or delete it, then start again")
    for folder in (out, *filter(Path.is_dir, out.iterdir())):
        if not os.access(folder, os.W_OK | os.X_OK):  # else the earlier result could not be moved, or not be deleted
            raise PermissionError(f"{folder}: is read-only; its files cannot be replaced")


@on_cpu()
def save_result(folder: Path, result: Result, overwrite: bool) -> None:
    """See :meth:`torchjoint.Result.save`."""
    Result.of(result, result.scene)  # raises if others took the place of its points or frames
    parts = Parts(result)
    same = (one / 100 for one in (50, *range(101)) if (parts.level(one / 100) == parts.level(None)).all())
    for one, name in result.segment_names.items():
        if type(one) is not int or not isinstance(name, str):
            raise TypeError(f"segment_names: expected texts by ids, got {one!r}: {name!r}")
    there = {*result.points.unique().tolist()}
    made = {"names": {one: printable(name) for one, name in result.segment_names.items() if one in there and name}}
    source, config = f"a result {os.urandom(8).hex()}", result.config or Config()
    with output_folder(folder, source, overwrite=overwrite) as partial:
        assert partial is not None  # only runs with a key can be finished
        write_result(partial, result.scene, result, config, str(folder), next(same, None), made=made)
        read_result(partial)  # what could not be read again, such as ids above the number of points, is an error now
        if result.embeddings is not None:
            result.embeddings.save(partial)
