"""The folder that a run writes its result to. One run at a time writes it, and it is replaced as a whole.

A run writes to a partial folder, OUT.partial. After the last file it writes a marker, `complete.txt`. From then on the
partial folder is the result: a later run that finds the marker finishes the following steps. An earlier result is
renamed to .OUT.replaced, then the partial folder is renamed to OUT, then the earlier result is deleted. OUT cannot be
renamed if a file system is mounted there (a container's volume), or if its parent folder is read-only. Then both
folders are inside OUT, and the contents of OUT are moved one by one.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from torchjoint.results.edits import FILE as EDITS
from torchjoint.runtime.files import no_link, write_text
from torchjoint.runtime.locks import lock

#: Files in a partial folder: its source; the marker that it is complete; the marker that the old result has moved.
SOURCE, COMPLETE, PLACING = "source.txt", "complete.txt", "placing.txt"

#: A folder in a partial folder, with the files that only resuming needs. It is no part of the result.
STATE = "state"

_OVERWRITE = "overwrite "  # the marker's first word if an earlier result may be replaced; the key follows


@dataclass(frozen=True)
class _Places:
    """The paths that a run uses while it writes a result."""

    out: Path
    partial: Path
    replaced: Path
    lock: Path
    inside: bool  #: whether partial, replaced and lock are inside OUT

    @classmethod
    def of(cls, out: Path) -> _Places:
        if is_fixed(out):
            return cls(out, out / ".partial", out / ".replaced", out / ".lock", True)
        partial, replaced, lock = (
            out.with_name(name) for name in (f"{out.name}.partial", f".{out.name}.replaced", f".{out.name}.lock")
        )
        return cls(out, partial, replaced, lock, False)

    @property
    def own(self) -> set[Path]:
        return {self.partial, self.replaced, self.lock}

    def content(self) -> list[Path]:
        """The content of OUT, without the files of this module."""
        return [path for path in sorted(self.out.iterdir()) if path not in self.own] if self.out.is_dir() else []


def is_fixed(out: Path) -> bool:
    """Whether a folder exists and cannot be renamed: a mount point, or in a read-only folder."""
    return out.is_dir() and (_is_mount_point(out) or not os.access(out.parent, os.W_OK | os.X_OK))


def _is_mount_point(path: Path) -> bool:
    if os.path.ismount(path):
        return True
    mounts = Path("/proc/self/mountinfo")  # also lists bind mounts within one file system
    lines = mounts.read_text(encoding="utf-8", errors="replace").splitlines() if mounts.is_file() else []
    escaped = str(path).replace("\\", "\\134").replace(" ", "\\040").replace("\t", "\\011")
    return any(line.split(" ")[4:5] == [escaped] for line in lines)


def own_files(out: Path) -> set[Path]:
    """OUT, and all paths that a run writes beside it."""
    out = Path(os.path.abspath(out))
    return {out, *_Places.of(out).own}


@contextmanager
def output_folder(out: Path, source: str, *, key: str = "", overwrite: bool = False) -> Iterator[Path | None]:
    """Yields a temporary folder, which becomes `out` on success. After an error it stays, so that the run can resume.

    Args:
        out: the result's folder.
        source: describes the input of the result; a partial result of another source is deleted.
        key: describes input and parameters. If an earlier run with this key was killed after its last file, its result
            becomes `out`. Then nothing is left to do, and None is yielded.
        overwrite: replace an earlier result; only a result (an empty folder, or one with a run.yaml) is replaced.

    Raises:
        FileExistsError: `out` exists and `overwrite` is False; `out` is not a result; the path of the partial result is
            used by something else; or another run is writing to `out`.
        PermissionError: nothing can be written there.
    """
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
    with lock(places.lock, f"{out}: another run is writing this result; wait for it, or choose another output"):
        finished = _finish_earlier(places, overwrite)
        if key and finished == key:
            yield None
            return
        _check_replaceable(places, overwrite)
        _prepare(places.partial, source)
        try:
            yield places.partial
        except BaseException:
            if [path.name for path in places.partial.iterdir()] == [SOURCE]:  # nothing to resume: remove the folder
                shutil.rmtree(places.partial)
            raise
        write_text(places.partial / COMPLETE, _OVERWRITE * overwrite + key)
        _place(places)


def _prepare(partial: Path, source: str) -> None:
    """Makes the partial folder, or uses that of an earlier run with the same source."""
    for path in partial.rglob("*"):
        no_link(path)
    source_file = partial / SOURCE
    # A run may be killed after it made the folder and before it wrote the first file.
    is_new = not partial.exists() or {path.name for path in partial.iterdir()} <= {f".{SOURCE[:-4]}.partial.txt"}
    if not is_new and not source_file.is_file():
        raise FileExistsError(f"{partial}: expected the folder of an earlier run; move it, or choose another output")
    if not is_new and source_file.read_text(encoding="utf-8") != source:
        _remove(partial, SOURCE)
    partial.mkdir(parents=True, exist_ok=True)
    write_text(source_file, source)


def _finish_earlier(places: _Places, overwrite: bool) -> str | None:
    """Finishes the steps of a killed run; returns the key of its result, or None if there is nothing to finish."""
    partial, out = places.partial, places.out
    found = next((path for path in (partial / PLACING, partial / COMPLETE, out / COMPLETE) if path.is_file()), None)
    marker = "" if found is None else found.read_text(encoding="utf-8")
    if found is not None and found.parent == partial:
        if found.name == COMPLETE:
            _check_replaceable(places, overwrite or marker.startswith(_OVERWRITE))
        _place(places)
    elif found is not None:
        found.unlink()
    _remove(places.replaced, "run.yaml")
    return None if found is None else marker.removeprefix(_OVERWRITE)


def _place(places: _Places) -> None:
    """Turns the complete partial folder into the result; can be repeated after a kill at any step."""
    out, partial, replaced = places.out, places.partial, places.replaced
    shutil.rmtree(partial / STATE, ignore_errors=True)
    (partial / SOURCE).unlink(missing_ok=True)
    if places.inside:
        if not (partial / PLACING).is_file():
            replaced.mkdir(exist_ok=True)
            for path in places.content():
                os.replace(path, replaced / path.name)
            os.replace(partial / COMPLETE, partial / PLACING)
        for path in sorted(partial.iterdir()):
            if path.name != PLACING:
                os.replace(path, out / path.name)
        (partial / PLACING).unlink()
        partial.rmdir()
    else:
        if out.exists():
            _remove(replaced, "run.yaml")
            os.replace(out, replaced)
        os.replace(partial, out)
        (out / COMPLETE).unlink()
    _remove(replaced, "run.yaml")


def _remove(folder: Path, last: str) -> None:
    """Deletes a folder; file `last`, which identifies it, goes last, so that a killed deletion can be repeated."""
    if not folder.is_dir():
        return
    for path in folder.iterdir():
        if path.name != last:
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    shutil.rmtree(folder)


def _check_replaceable(places: _Places, overwrite: bool) -> None:
    out, content = places.out, places.content()
    if not out.exists():
        return
    if not overwrite:
        raise FileExistsError(f"{out}: exists already; choose another folder, or --overwrite")
    if (out / EDITS).exists():
        raise FileExistsError(f"{out / EDITS}: has corrections by hand; move or delete it, then start again")
    if content and not (out / "run.yaml").is_file():
        raise FileExistsError(f"{out}: expected a result of torchjoint, which has a run.yaml; it is not overwritten")
    if places.inside and not os.access(out, os.W_OK | os.X_OK):
        raise PermissionError(f"{out}: is read-only")
