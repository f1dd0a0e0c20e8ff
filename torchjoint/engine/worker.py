"""The code that runs in a worker: it calls a task's function, handles its errors, and ends with the first process."""

from __future__ import annotations

import hashlib
import os
import pickle
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import cloudpickle
import torch

T = TypeVar("T")

#: Seconds between a worker's checks that the process that started it still runs.
INTERVAL = 0.5


class Answer(NamedTuple):
    """What a task's function returned or raised."""

    value: Any = None
    error: Exception | None = None


def call(function: Callable[[Any], Any], item: Any, threads: int) -> Answer:
    """Runs a task on `threads` threads. Returns an error of the task, so that only errors of the engine are raised."""
    try:
        torch.set_num_threads(threads)
        return Answer(function(item))
    except (Exception, SystemExit) as error:
        return Answer(error=_portable(error))


def _portable(error: BaseException) -> Exception:
    """The error if it can be pickled; else a RuntimeError with its name and message."""
    with suppress(Exception):  # the error's own code may raise anything
        pickle.loads(pickle.dumps(error))
        if isinstance(error, Exception):
            return error.with_traceback(None)
    return RuntimeError(f"{type(error).__name__}: {error}")


#: How the names of shared files begin.
SHARED = "shared-"
_lock = threading.Lock()  # a worker of dask may run several tasks at once


class SharedFile(Generic[T]):
    """A value that all tasks use, pickled to a temporary file once; each worker reads it once.

    Args:
        value: tasks must not change it.
        folder: of the file, for workers on other machines one that they see; default: that of temporary files.
    """

    def __init__(self, value: T, folder: Path | None = None) -> None:
        self._file = tempfile.NamedTemporaryFile(prefix=SHARED, dir=folder)  # noqa: SIM115
        cloudpickle.dump(value, self._file)
        self._file.seek(0)
        self._key = self._file.name, hashlib.file_digest(self._file, "sha256").digest()

    def __getstate__(self) -> dict[str, Any]:
        return {"_key": self._key}

    def load(self) -> T:
        """The value, in a worker."""
        with _lock:
            value: T = _load(*self._key)
            return value

    def close(self) -> None:
        """Deletes the file; no task will use it any more."""
        self._file.close()
        _load.cache_clear()  # tasks may have run in this process


@lru_cache(maxsize=1)  # one, so that a long-lived worker does not fill memory
def _load(path: str, checksum: bytes) -> Any:
    with open(path, "rb") as stream:
        if hashlib.file_digest(stream, "sha256").digest() != checksum:  # others may write to the folder
            raise ValueError(f"{path}: is not what the first process wrote")
        stream.seek(0)
        return cloudpickle.load(stream)


def end_with(parent: int) -> None:
    """Ends this process soon after its parent, whose process id is `parent`, has ended, even by SIGKILL."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(INTERVAL)
        os._exit(1)

    threading.Thread(target=watch, name="torchjoint-parent", daemon=True).start()
