"""A lock that one process holds. The system releases it when the process ends, also when it is killed."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from torchjoint.runtime.files import no_link


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
            raise LostError(
                f"{self.path}: was removed while this run worked; another run may have taken its files; start again"
            )


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
def lock(path: Path, busy: str) -> Iterator[Lock]:
    """Holds the lock of a file inside the block; then removes the file.

    Raises:
        BusyError: another process holds it; `busy` is the message.
        FileExistsError: there is a file of something else.
        LostError: the file was removed, and then a file of the run was missing.
    """
    while True:
        descriptor = _opened(no_link(path))
        try:
            _take(descriptor)
        except OSError as error:
            os.close(descriptor)
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
