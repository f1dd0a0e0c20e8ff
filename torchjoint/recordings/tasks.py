"""The worker's side of a task, and how a task ended."""

from __future__ import annotations

import os
import pickle
import threading
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import torch

R = TypeVar("R")

#: Seconds between a worker's checks that the process that started it still runs.
INTERVAL = 0.5

#: The result of :func:`tasks_on_machine` in the task of this thread.
_on_machine: ContextVar[int] = ContextVar("torchjoint_tasks_on_machine", default=1)


class WorkerDied(BrokenExecutor):
    """The worker that ran a task died: it was killed, had too little memory, or crashed."""


@dataclass(frozen=True)
class Outcome(Generic[R]):
    """How a task ended: with a value, or with an error.

    Attributes:
        index: of the task.
        value: what the function returned; None after an error.
        error: what the function raised, or :class:`WorkerDied`; None if there is a value.
    """

    index: int
    value: R | None = None
    error: Exception | None = None


def tasks_on_machine() -> int:
    """How many tasks this machine may run at a time, so that each takes its share of memory; 1 outside a task."""
    return _on_machine.get()


def answer(
    index: int, function: Callable[[Any, Any], R], shared: Any, task: Any, threads: int, on_machine: int
) -> Outcome[R]:
    """Runs a task on `threads` threads. Returns its error, so that only errors of the executor are raised."""
    before, sharing = torch.get_num_threads(), _on_machine.set(on_machine)
    try:
        torch.set_num_threads(threads)
        return Outcome(index, function(shared, task))
    except (Exception, SystemExit) as error:
        return Outcome(index, error=_portable(error))
    finally:
        torch.set_num_threads(before)
        _on_machine.reset(sharing)


def _portable(error: BaseException) -> Exception:
    """The error if it can be pickled; else a RuntimeError with its name and message."""
    if isinstance(error, Exception):
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # the error's own code may raise anything
            pass
        else:
            return error.with_traceback(None)
    return RuntimeError(f"{type(error).__name__}: {error}")


def end_with(parent: int) -> None:
    """Ends this process soon after its parent, whose process id is `parent`, has ended, even by SIGKILL."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(INTERVAL)
        os._exit(1)

    threading.Thread(target=watch, name="torchjoint-parent", daemon=True).start()
