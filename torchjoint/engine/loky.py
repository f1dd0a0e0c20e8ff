"""Processes on this machine, by joblib's loky."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from typing import Any

from joblib.externals.loky.process_executor import ProcessPoolExecutor

from torchjoint.engine.engine import Engine
from torchjoint.engine.shared_file import SharedFile
from torchjoint.engine.worker import Answer, end_with

#: Libraries read their number of threads from these when they start.
_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class LokyEngine(Engine):
    """Processes of loky. Each worker has its own executor, so that the death of a worker breaks no other worker.

    Args:
        name, threads: as of :class:`Engine`.
        workers: number of processes.
    """

    def __init__(self, name: str, threads: int, workers: int) -> None:
        super().__init__(name, threads, workers)
        # Loky replaces a worker that has grown by 300 MB, after its task. Large recordings cause this; nothing is lost.
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given to the executor")
        self._workers = workers
        self._idle: list[ProcessPoolExecutor] = []
        self._all: set[ProcessPoolExecutor] = set()

    def slots(self) -> int:
        """Number of worker processes."""
        return self._workers

    def _share(self, value: Any) -> SharedFile:
        return SharedFile(value)

    def _submit(self, call: Callable[..., Answer], *arguments: Any) -> Future[Answer]:
        executor = self._idle.pop() if self._idle else self._new_executor()
        future: Future[Answer] = executor.submit(call, *arguments)

        def release(ended: Future[Answer]) -> None:
            if not ended.cancelled() and isinstance(ended.exception(), BrokenExecutor):
                self._all.discard(executor)
            else:
                self._idle.append(executor)

        future.add_done_callback(release)
        return future

    def _new_executor(self) -> ProcessPoolExecutor:
        variables = dict.fromkeys(_VARIABLES, str(self.threads))
        executor = ProcessPoolExecutor(1, initializer=end_with, initargs=(os.getpid(),), env=variables)
        self._all.add(executor)
        return executor

    def _death(self, error: BaseException) -> str | None:
        if not isinstance(error, BrokenExecutor):
            return None
        code = re.search(r"\{(.*?)\}", str(error))
        return f"{code[1] if code else type(error).__name__} (killed, out of memory, or a crash)"

    def close(self) -> None:
        """Ends the workers without waiting for tasks."""
        executors, idle, self._all, self._idle = self._all, self._idle, set(), []
        for executor in executors:
            executor.shutdown(kill_workers=executor not in idle)
