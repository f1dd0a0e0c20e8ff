"""Tasks go to an executor, a few at a time; their outcomes come back, and no failure stops other tasks.

The last part of this module runs in the workers: it calls a task's function, and ends with the first process.

The executors' futures are used, not ``joblib.Parallel``. With joblib 1.6, a task whose worker dies four times on dask
disappears without an error, and on ray the death of one worker ends all tasks. Here, a task whose worker dies runs once
more; if its worker dies again, the task is reported as failed.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import cloudpickle
import torch

T = TypeVar("T")
R = TypeVar("R")

#: A task fails when its workers have died this many times.
MOST_DEATHS = 2

#: A task whose connection was cut this many times ends the run.
MOST_CUTS = 3

#: What dask and ray raise, whoever made the executor, where others raise BrokenExecutor.
_DEATHS = ("KilledWorker", "WorkerCrashedError", "NodeDiedError", "OutOfMemoryError")


class WorkerDied(BrokenExecutor):
    """The workers that ran a task died: they were killed, had too little memory, or crashed."""


@dataclass(frozen=True)
class Outcome(Generic[R]):
    """How a task ended: with a value, or with an error.

    Attributes:
        index: of the task.
        value: what the function returned; None after an error.
        error: what the function raised, :class:`WorkerDied` if its workers died twice; None if there is a value.
    """

    index: int
    value: R | None = None
    error: Exception | None = None


@dataclass
class _Task(Generic[T]):
    index: int
    item: T
    deaths: int = 0
    cuts: int = 0


@dataclass(frozen=True)
class Engine:
    """An executor, and what its tasks must know.

    Attributes:
        name: for messages.
        executor: any executor. Tasks whose worker has died are submitted to it again.
        slots: returns how many tasks can run at once; at least 1 if none is running.
        threads: threads of one task.
        on_machine: how many tasks a machine runs at a time; None: unknown, so as many as its cores allow.
        dashboard: address of a page for the browser, if there is one.
    """

    name: str
    executor: Executor
    slots: Callable[[], int]
    threads: int = 1
    on_machine: int | None = None
    dashboard: str | None = None

    def run(self, function: Callable[[T], R], tasks: Iterable[T], *, in_order: bool = False) -> Iterator[Outcome[R]]:
        """Yields the outcome of ``function(task)`` for each task.

        At a time, only as many tasks are submitted as can run, so that the death of a worker meets no other task.

        Args:
            function: is pickled with each task; a large value that all tasks use belongs in a :class:`SharedFile`.
            tasks: are taken when they are submitted.
            in_order: yield in the order of the tasks, not in the order in which they end. At most twice as many
                outcomes are in memory as tasks can run.
        """
        tasks_left = (_Task(index, item) for index, item in enumerate(tasks))
        again: deque[_Task[T]] = deque()
        running: dict[Future[Answer], _Task[T]] = {}
        ready: dict[int, Outcome[R]] = {}
        following = 0
        try:
            while True:
                slots = self.slots()
                while len(running) < slots:
                    may_begin = len(running) + len(ready) < 2 * slots
                    task = again.popleft() if again else next(tasks_left, None) if may_begin else None
                    if task is None:
                        break
                    running[self._submit(function, task.item)] = task
                if not running:
                    return
                ended = [(running.pop(future), future) for future in wait(running, None, FIRST_COMPLETED).done]
                for task, future in sorted(ended, key=lambda pair: pair[0].index):
                    outcome = self._outcome(task, future)
                    if outcome is None:
                        again.append(task)
                    else:
                        ready[task.index] = outcome
                while ready and (following in ready or not in_order):
                    yield ready.pop(following if in_order else min(ready))
                    following += 1
        finally:
            for future in running:
                future.cancel()

    def _submit(self, function: Callable[[T], R], item: T) -> Future[Answer]:
        try:
            return self.executor.submit(call, function, item, self.threads, version("torchjoint"))
        except BrokenExecutor as error:
            raise WorkerDied(f"engine {self.name}: a worker died, and it takes no more tasks; open another") from error

    def _outcome(self, task: _Task[T], future: Future[Answer]) -> Outcome[Any] | None:
        """How a task ended; None if it has to run again."""
        error = CancelledError() if future.cancelled() else future.exception()
        if error is None:
            return Outcome(task.index, *future.result())
        if isinstance(error, CancelledError | ConnectionError):
            task.cuts += 1
            if task.cuts < MOST_CUTS:
                return None
            raise ConnectionError(f"engine {self.name}: the connection was cut {MOST_CUTS} times; is it overloaded?")
        if isinstance(error, BrokenExecutor) or type(error).__name__ in _DEATHS:
            task.deaths += 1
            if task.deaths < MOST_DEATHS:
                return None
            return Outcome(task.index, error=WorkerDied(f"its worker died {MOST_DEATHS} times: {_reason(error)}"))
        if not isinstance(error, Exception):
            raise error  # an interrupt
        return Outcome(task.index, error=error)  # for example, a value that cannot be pickled


def _reason(death: BaseException) -> str:
    code = re.search(r"\{(.*?)\}", str(death))  # loky tells the exit code
    return f"{code[1] if code else type(death).__name__} (killed, out of memory, or a crash)"


#: Seconds between a worker's checks that the process that started it still runs.
INTERVAL = 0.5


class Answer(NamedTuple):
    """What a task's function returned or raised."""

    value: Any = None
    error: Exception | None = None


def call(function: Callable[[Any], Any], item: Any, threads: int, expected: str) -> Answer:
    """Runs a task on `threads` threads. Returns an error of the task, so that only errors of the engine are raised."""
    try:
        if (own := version("torchjoint")) != expected:
            raise ValueError(f"engine: expected a worker with torchjoint {expected}, got {own}")
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
            return _load(*self._key)

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
