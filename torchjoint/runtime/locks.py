"""A lock that one process holds. The system releases it when the process ends, also when it is killed."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from torchjoint.runtime.files import no_link


class BusyError(FileExistsError):
    """Another run holds the lock."""


@contextmanager
def lock(path: Path, busy: str) -> Iterator[None]:
    """Holds the lock of a file inside the block; then removes the file.

    Raises:
        BusyError: another process holds it; `busy` is the message.
    """
    while True:
        descriptor = os.open(no_link(path), os.O_RDWR | os.O_CREAT, 0o644)
        try:
            _take(descriptor)
        except OSError as error:
            os.close(descriptor)
            raise BusyError(busy) from error
        try:
            current = os.stat(path).st_ino
        except FileNotFoundError:
            current = None
        if current == os.fstat(descriptor).st_ino:
            break
        os.close(descriptor)  # the run that held the lock has removed the file in the meantime
    try:
        yield
    finally:
        _release(path, descriptor)


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
