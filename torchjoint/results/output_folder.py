"""The folder that a run writes its result to: one run at a time, and the result is there as a whole, or not at all.

A run writes to a partial folder, OUT.partial. When all is written, a marker says so (`complete`), and from then on the
partial folder is the result: whoever finds the marker finishes what was begun. An earlier result is first renamed to
.OUT.replaced, then the partial folder to OUT, then the earlier result is deleted. If OUT cannot be renamed, because a
file system is mounted there (a container's volume) or its parent folder is read-only, both folders are inside OUT, and
the contents of OUT are moved one by one.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from torchjoint.runtime.files import write_text
from torchjoint.runtime.locks import lock

#: Files in a partial folder: the source of its content; that it is complete; that also the old result has moved.
SOURCE, COMPLETE, PLACING = "source.txt", "complete.txt", "placing.txt"

#: A folder in a partial folder, for what only resuming needs: it is no part of the result.
STATE = "state"

_OVERWRITE = "overwrite "  # the marker's first word if an earlier result may be replaced; the key follows


@dataclass(frozen=True)
class _Places:
    """Where the parts of a result are while it is made."""

    out: Path
    partial: Path
    replaced: Path
    lock: Path
    inside: bool  #: of OUT

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
        """What OUT holds, without our own files."""
        return [path for path in sorted(self.out.iterdir()) if path not in self.own] if self.out.is_dir() else []


def is_fixed(out: Path) -> bool:
    """Whether a folder exists and cannot be renamed: a mount point, or in a read-only folder."""
    return out.is_dir() and (_is_mount_point(out) or not os.access(out.parent, os.W_OK | os.X_OK))


def _is_mount_point(path: Path) -> bool:
    if os.path.ismount(path):
        return True
    mounts = Path("/proc/self/mountinfo")  # has the bind mounts of one file system, too
    lines = mounts.read_text(encoding="utf-8", errors="replace").splitlines() if mounts.is_file() else []
    escaped = str(path).replace("\\", "\\134").replace(" ", "\\040").replace("\t", "\\011")
    return any(line.split(" ")[4:5] == [escaped] for line in lines)


def own_files(out: Path) -> set[Path]:
    """OUT and all that a run writes beside it."""
    out = Path(os.path.abspath(out))
    return {out, *_Places.of(out).own}


@contextmanager
def output_folder(out: Path, source: str, *, key: str = "", overwrite: bool = False) -> Iterator[Path | None]:
    """A temporary folder to write into; it becomes `out` on success. After an error it stays, so the run can resume.

    Args:
        out: the result's folder.
        source: describes the input of the result; a partial result of another source is deleted.
        key: describes input and parameters. If an earlier run with this key was killed after it had written all, its
            result is put in its place, and there is nothing left to do: the folder is then None.
        overwrite: replace an earlier result; only a result (an empty folder, or one with a run.yaml) is replaced.

    Raises:
        FileExistsError: `out` exists and `overwrite` is False, or `out` is not a result; or the path of the partial
            result is used by something else; or another run is writing to `out`.
    """
    out = Path(os.path.abspath(out))
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise FileExistsError(f"{out}: exists and is not a folder; choose another name for the output")
    out.parent.mkdir(parents=True, exist_ok=True)
    places = _Places.of(out)
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
    """Makes the partial folder, or takes that of an earlier run with the same source."""
    source_file = partial / SOURCE
    # A run may be killed between the making of the folder and of its first file.
    is_new = not partial.exists() or {path.name for path in partial.iterdir()} <= {f".{SOURCE[:-4]}.partial.txt"}
    if not is_new and not source_file.is_file():
        raise FileExistsError(f"{partial}: is in the way and not of an earlier run; move it, or choose another output")
    if not is_new and source_file.read_text(encoding="utf-8") != source:
        _remove(partial, SOURCE)
    partial.mkdir(parents=True, exist_ok=True)
    write_text(source_file, source)


def _finish_earlier(places: _Places, overwrite: bool) -> str | None:
    """Finishes what a killed run had begun; returns the key of the result that it put in its place."""
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
    """Makes the partial folder, which is complete, the result; can be repeated after each of its steps."""
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
    """Deletes a folder; the file that says whose it is goes last, so that a killed deletion can be repeated."""
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
    if content and not (out / "run.yaml").is_file():
        raise FileExistsError(f"{out}: is no result of torchjoint (it has no run.yaml) and will not be overwritten")
    if places.inside and not os.access(out, os.W_OK | os.X_OK):
        raise PermissionError(f"{out}: is read-only")
