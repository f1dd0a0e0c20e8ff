"""How a run puts its file or folder in its place: what the run did not see there when it began is never replaced.

A user, a viewer or another program may make or change OUT while a run works. So the run notes what stands at OUT when
it begins, and compares at the moment of replacing. An earlier folder is moved aside until the new one stands.
"""

import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from torchjoint.runtime.files import FULL, PARTIAL, no_link, remove_partial_files, write_text


class BusyError(FileExistsError):
    """Another run holds the lock."""


class LostError(OSError):
    """The file of the lock was removed while the lock was held, so that another run can hold one of the same name."""


class Lock(NamedTuple):
    """A lock that is held."""

    path: Path
    descriptor: int

    def is_held(self) -> bool:
        """Whether its file is still there: who removes it lets other runs in."""
        try:
            return os.path.samestat(os.stat(self.path), os.fstat(self.descriptor))
        except FileNotFoundError:
            return False

    def check(self) -> None:
        """Raises LostError unless it is held; comes before a step that must not meet that of another run."""
        if not self.is_held():
            told = "was removed while this run worked; another run may have taken its files; start again"
            raise LostError(f"{self.path}: {told}")


def _opened(path: Path) -> int:
    """Opens the file of a lock, which is empty; another one would be removed at the end."""
    with suppress(IsADirectoryError):
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        found = os.fstat(descriptor)
        if stat.S_ISREG(found.st_mode) and found.st_size == 0:
            return descriptor
        os.close(descriptor)
    raise FileExistsError(f"{path}: expected the empty file of a lock; move it, or choose another output")


@contextmanager
def lock(path: Path, busy: str, patience: float = 0.0) -> Iterator[Lock]:
    """Holds the lock of a file inside the block; then removes the file. Waits for it so many seconds."""
    end = time.monotonic() + patience
    while True:
        descriptor = _opened(no_link(path))
        try:
            _take(descriptor)
        except OSError as error:
            os.close(descriptor)
            if time.monotonic() < end:
                time.sleep(0.01)
                continue
            raise BusyError(busy) from error
        held = Lock(path, descriptor)
        if held.is_held():
            break
        os.close(descriptor)  # the run that held the lock has removed the file in the meantime
    try:
        yield held
    except FileNotFoundError:
        held.check()
        raise
    finally:
        if held.is_held():
            _release(path, descriptor)
        else:
            os.close(descriptor)  # the file is another run's


if sys.platform == "win32":
    import msvcrt

    def _take(descriptor: int) -> None:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)

    def _release(path: Path, descriptor: int) -> None:
        os.close(descriptor)  # Windows cannot remove an open file
        with suppress(PermissionError):  # another run has opened it in the meantime
            path.unlink(missing_ok=True)

else:
    import fcntl

    def _take(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def _release(path: Path, descriptor: int) -> None:
        path.unlink(missing_ok=True)
        os.close(descriptor)


#: The file that says what a work folder is for.
SOURCE = "source.txt"


def _seal(file: Path) -> bytes:
    return f"torchjoint {file.parent.stat().st_ino}\n".encode()


def write_sealed(file: Path, text: str) -> None:
    """Writes a file that counts only in the folder in which it is."""
    write_text(file, _seal(file).decode() + text.encode(errors="backslashreplace").decode())  # a path may be no text


def read_sealed(file: Path) -> str | None:
    """Reads what :func:`write_sealed` wrote; None if there is no such file, or not of this folder."""
    if file.is_symlink() or not file.is_file():
        return None
    with file.open("rb") as stream:
        seal = _seal(file)
        return stream.read().decode(errors="replace") if stream.read(len(seal)) == seal else None


#: The file in a folder of exports that says what was written there.
WRITTEN = ".torchjoint"


def _files_in(folder: Path) -> str:
    """What stands in a folder and the folders in it, but :data:`WRITTEN`."""
    folders = [folder, *(path for path in sorted(folder.rglob("*")) if path.is_dir())]
    return repr([sorted(one for one in seen(each, {WRITTEN}) if "/" not in one[0]) for each in folders])


def seal_files(folder: Path) -> None:
    """Notes what stands in a new folder, for :func:`is_as_written`."""
    write_sealed(folder / WRITTEN, _files_in(folder))


def is_as_written(folder: Path) -> bool:
    """Whether a folder is empty, or all in it is as a command wrote it: a user's files may have such names."""
    return folder.is_dir() and (not any(folder.iterdir()) or read_sealed(folder / WRITTEN) == _files_in(folder))


def work_folder(folder: Path, source: str) -> Path:
    """Makes the folder of a run, or finds that of an interrupted run with the same source; others are emptied.

    Args:
        folder: its path.
        source: all on which its content depends.
    """
    for path in (folder, *folder.rglob("*")):
        no_link(path)
    folder.mkdir(parents=True, exist_ok=True)
    known = read_sealed(folder / SOURCE)
    # A run may be killed after it made the folder, and before it wrote the first file.
    if known is None and any(not path.name.startswith(PARTIAL) for path in folder.iterdir()):
        raise FileExistsError(f"{folder}: expected the folder of an earlier run; move it, or choose another output")
    with tempfile.TemporaryFile(dir=folder, prefix=PARTIAL) as own:  # some file systems give all files one owner
        if os.fstat(own.fileno()).st_uid != folder.stat().st_uid:  # who may put a link into it while the run works
            raise FileExistsError(f"{folder}: belongs to another user; move it, or choose another output")
    for path in (folder, *folder.rglob("*")):
        remove_partial_files(path)
    if known is not None and known != source:
        for path in folder.iterdir():
            if path.name != SOURCE:  # it goes last, so that a killed deletion can be repeated
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    if known != source:
        write_sealed(folder / SOURCE, source)
    return folder


#: What stands at a path: name, time of the last change, and size of a file, or of all entries of a folder and of those
#: in it; "" is the path itself. Empty: nothing. Inodes are left out, because some network file systems change them.
Seen = frozenset[tuple[str, int, int]]


class ChangedError(FileExistsError):
    """What stands at OUT is not what the run saw when it began."""


def seen(path: Path, without: Collection[str] = ()) -> Seen:
    """What stands at a path, without the entries of these names."""
    try:
        own = path.lstat()
    except FileNotFoundError:
        return frozenset()
    if not stat.S_ISDIR(own.st_mode):
        return frozenset({("", own.st_mtime_ns, own.st_size)})
    found = {("", 0, 0)}
    for entry in (*path.iterdir(), *path.glob("*/*")):  # a file that is written in place leaves its folder as it was
        with suppress(FileNotFoundError):  # it has just gone, such as a viewer's temporary file
            known, name = entry.lstat(), entry.relative_to(path).as_posix()
            found.add((name, known.st_mtime_ns, 0 if stat.S_ISDIR(known.st_mode) else known.st_size))
    return frozenset(one for one in found if one[0].partition("/")[0] not in without)


def entries(found: Seen) -> list[str]:
    """The names of what stands in a folder itself, sorted."""
    return sorted({name for name, _, _ in found if name and "/" not in name})


def check_unchanged(out: Path, before: Seen, without: Collection[str] = (), at: Path | None = None) -> None:
    """Checks that nothing stands at a path that was not there before; `at`: what stood there has moved there."""
    if new := seen(out if at is None else at, without) - before:
        raise _changed(out / min(new)[0])


def _changed(path: Path) -> ChangedError:
    return ChangedError(f"{path}: was made or changed while this run worked, and is kept; move it, then start again")


def move_new(source: Path, target: Path) -> None:
    """Renames a file or folder to a path where nothing is, or an empty folder. Can be repeated after a kill."""
    if source.is_dir():
        try:
            os.rename(source, target)  # the system refuses to replace a file, or a folder that is not empty
        except OSError as error:
            if os.path.lexists(target):
                raise _changed(target) from error
            raise
        return
    try:
        os.link(source, target)  # unlike a rename, it never replaces a file
    except OSError as error:
        if not os.path.lexists(target):  # a file system without hard links
            os.rename(source, target)
            return
        if not source.samefile(target):  # not of a killed run
            raise _changed(target) from error
    source.unlink()


def put(new: Path, out: Path, before: Seen, aside: Path) -> None:
    """Puts a new file or folder in the place of what stood at `out`.

    Args:
        new: the file or folder, in the same file system.
        out: its place.
        before: what stood there when the run began.
        aside: where an earlier folder goes; the caller deletes it afterwards.
    """
    check_unchanged(out, before)
    if not before:
        move_new(new, out)
    elif not new.is_dir():
        os.replace(new, out)
    else:
        if os.path.lexists(out) and not os.path.lexists(aside):
            os.rename(out, aside)
        try:
            check_unchanged(out, before, at=aside)
            move_new(new, out)
        except BaseException:
            with suppress(OSError):  # something stands at `out` already
                move_new(aside, out)
            raise


def settle(new: Path, out: Path, aside: Path) -> None:
    """Ends a :func:`put` of a folder that was killed: gives back what stood at `out`, unless `new` has replaced it."""
    if not os.path.lexists(aside):
        return
    if not os.path.lexists(new):
        shutil.rmtree(aside)
    elif os.path.lexists(out):
        raise FileExistsError(f"{aside}: holds what stood at {out} before the last run; move it, then start again")
    else:
        os.rename(aside, out)


def check_no_input(out: Path, inputs: Iterable[Path | None], option: str = "-o") -> None:
    """Checks that an output replaces no input, also by way of links."""
    real = Path(os.path.realpath(out))
    for given in (one for one in inputs if one is not None and one.exists()):
        known = Path(os.path.realpath(given))
        if out.exists() and (out.samefile(given) or (real.is_file() and known in real.parents)):
            raise ValueError(f"{option}: expected another path than the input's, {given}, got {out}")
        if real in known.parents:
            raise ValueError(f"{option}: expected a folder that does not contain the input, {given}, got {out}")


def check_apart(out: Path, other: Path, option: str) -> None:
    """Checks that of two outputs of one command none is the other, or in it; `option`: of the other."""
    one, two = Path(os.path.realpath(out)), Path(os.path.realpath(other))
    if one == two or one in two.parents or two in one.parents:
        raise ValueError(f"{option}: expected a path outside of the output, {out}, got {other}")


def is_fixed(out: Path) -> bool:
    """Whether a folder exists and cannot be renamed: a mount point, or in a read-only folder."""
    return out.is_dir() and (_is_mount_point(out) or not os.access(out.parent, os.W_OK | os.X_OK))


def _is_mount_point(path: Path) -> bool:
    if os.path.ismount(path):
        return True
    mounts = Path("/proc/self/mountinfo")  # also lists bind mounts within one file system
    lines = mounts.read_text(encoding="utf-8", errors="replace").splitlines() if mounts.is_file() else []
    escaped = os.path.abspath(path).replace("\\", "\\134").replace(" ", "\\040").replace("\t", "\\011")
    return any(line.split(" ")[4:5] == [escaped] for line in lines)


class Output:
    """A file or folder that a command writes when its work is done.

    Args:
        path: of the file or folder.
        overwrite: replace what stands there now.
        inputs: what the command reads.
        option: the name of `path` for messages.

    Raises:
        FileExistsError: something stands there, and `overwrite` is False, or it cannot be replaced.
        ValueError: it is an input.
    """

    def __init__(self, path: Path, *, overwrite: bool, inputs: Sequence[Path | None] = (), option: str = "-o") -> None:
        check_no_input(path, inputs, option)
        self.path, self._before = path, seen(path)
        if self._before and not overwrite:
            raise FileExistsError(f"{path}: exists already; choose another name with {option}, or --overwrite")
        if self._before and not (path.is_symlink() or path.is_file() or path.is_dir()):
            raise FileExistsError(f"{option}: {path} is a device, a pipe or a socket; choose a new name")
        if is_fixed(path):
            where = "is a mount point, or in a read-only folder"
            raise FileExistsError(f"{option}: {path} {where}, and cannot be replaced; choose a new folder, also inside")

    @contextmanager
    def written(self) -> Iterator[Path]:
        """Yields a path of the same name in a new folder beside it. What is there at the end takes its place.

        Messages of errors name the path itself in place of the one beside it, which users do not know.
        """
        beside = Path(tempfile.mkdtemp(dir=self.path.parent, prefix=PARTIAL))
        new = beside / self.path.name
        try:
            yield new
            if new.is_dir():
                seal_files(new)
            put(new, self.path, self._before, beside / f"{PARTIAL}replaced")
        except BaseException as error:
            known = (one.replace(str(new), str(self.path)) if isinstance(one, str) else one for one in error.args)
            error.args = tuple(known)
            if isinstance(error, OSError) and (error.filename or error.errno in FULL):  # which name no file
                error.filename = str(error.filename or new).replace(str(new), str(self.path))
            if type(error) is OSError and not error.errno and str(self.path) not in str(error):  # of NumPy
                error.args = (f"{self.path}: cannot be written ({error}); is the disk full?",)
            shutil.rmtree(new, ignore_errors=True) if new.is_dir() else new.unlink(missing_ok=True)
            with suppress(OSError):  # it holds what could not be put back
                beside.rmdir()
            raise
        shutil.rmtree(beside)
        self._before = seen(self.path)

    def remove(self) -> None:
        """Deletes what stood there: it does not belong to what is written now."""
        check_unchanged(self.path, self._before)
        self.path.unlink(missing_ok=True)
