"""The code that runs in a worker: it calls a task's function, and handles its errors."""

from __future__ import annotations

import os
import pickle
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextvars import ContextVar
from typing import Any, NamedTuple

import joblib
import torch

#: Seconds between a worker's checks that the process that started it still runs.
INTERVAL = 0.5


class Answer(NamedTuple):
    """What a task's function returned or raised."""

    value: Any = None
    error: Exception | None = None


class Shared(ABC):
    """A reference to a value that all tasks use; each worker loads it once."""

    key: str

    @abstractmethod
    def load(self) -> Any:
        """Loads the value in a worker."""

    @abstractmethod
    def close(self) -> None:
        """Frees the value; no task will use it any more."""


#: The shared value of this worker, by its key. It holds at most one, so that a long-lived worker does not fill memory.
_loaded: dict[str, Any] = {}
_lock = threading.Lock()  # a worker of dask may run several tasks at once
#: The result of :func:`tasks_on_machine` in the task of this thread.
_on_machine: ContextVar[int] = ContextVar("torchjoint_tasks_on_machine", default=1)


def tasks_on_machine() -> int:
    """How many tasks of the engine this machine may run at a time, so that each takes its share; 1 outside a task."""
    return _on_machine.get()


def answer(
    function: Callable[[Any, Any], Any], shared: Any, task: Any, threads: int, on_machine: int | None = None
) -> Answer:
    """Runs a task on `threads` threads. Returns an error of the task, so that only errors of the engine are raised."""
    sharing = _on_machine.set(max(1, joblib.cpu_count() // threads) if on_machine is None else on_machine)
    try:
        torch.set_num_threads(threads)
        return Answer(function(_value(shared), task))
    except (Exception, SystemExit) as error:
        return Answer(error=_portable(error))
    finally:
        _on_machine.reset(sharing)


def _value(shared: Any) -> Any:
    if not isinstance(shared, Shared):
        return shared
    with _lock:
        if shared.key not in _loaded:
            _loaded.clear()
            _loaded[shared.key] = shared.load()
        return _loaded[shared.key]


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
