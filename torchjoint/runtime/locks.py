"""A lock that one process holds at a time, by a file that is there only while it is held."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def exclusive_lock(path: Path, busy: str) -> Iterator[None]:
    """Holds a lock; the system releases it when a process ends, however it ends.

    Args:
        path: of the lock's file; it is removed in the end.
        busy: what to say if another process holds it.

    Raises:
        FileExistsError: `busy`.
    """
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            raise FileExistsError(busy) from error
        try:
            current = os.stat(path).st_ino
        except FileNotFoundError:
            current = None
        if current == os.fstat(descriptor).st_ino:
            break
        os.close(descriptor)  # the process that held the lock has removed its file meanwhile
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(descriptor)
