"""What runs in a worker: a task's function, and what guards it."""

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

#: How often a worker looks whether the process that started it still runs, seconds.
INTERVAL = 0.5


class Answer(NamedTuple):
    """What a task's function returned or raised."""

    value: Any = None
    error: Exception | None = None


class Shared(ABC):
    """Stands for a value that is loaded once in each worker."""

    key: str

    @abstractmethod
    def load(self) -> Any:
        """The value, in a worker."""

    @abstractmethod
    def close(self) -> None:
        """No task will use it any more."""


#: The shared value of this worker, by its key: at most one, so that a long-lived worker does not fill its memory.
_loaded: dict[str, Any] = {}
_lock = threading.Lock()  # a worker of dask may run several tasks at once
#: Of the task that this thread runs.
_on_machine: ContextVar[int] = ContextVar("torchjoint_tasks_on_machine", default=1)


def tasks_on_machine() -> int:
    """How many tasks of the engine this machine may run at a time, so that a task takes its share; 1 outside a task."""
    return _on_machine.get()


def answer(
    function: Callable[[Any, Any], Any], shared: Any, task: Any, threads: int, on_machine: int | None = None
) -> Answer:
    """Runs a task on `threads` threads. An error is returned, not raised: what is raised is then the engine's own."""
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
    """The error, if it survives its way to another process; else one with its name and message."""
    if isinstance(error, Exception):
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # whatever its own code raises
            pass
        else:
            return error.with_traceback(None)
    return RuntimeError(f"{type(error).__name__}: {error}")


def end_with(parent: int) -> None:
    """Ends this process soon after its parent, the process with this id, has ended, even by SIGKILL."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(INTERVAL)
        os._exit(1)

    threading.Thread(target=watch, name="torchjoint-parent", daemon=True).start()
