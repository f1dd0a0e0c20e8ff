"""The base of all engines: tasks go to workers, results come back in any order, and no failure stops other tasks.

The engines' own futures are used, not ``joblib.Parallel``. With joblib 1.6, a task whose worker dies four times on dask
disappears without an error, and on ray the death of one worker ends all tasks. Here, a task whose worker dies runs once
more; if its worker dies again, the task is reported as failed.
"""

from __future__ import annotations

import abc
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, Self, TypeVar

from torchjoint.engine.worker import Answer, Shared, answer

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

#: A task fails when its workers have died this many times.
MOST_DEATHS = 2

#: A task whose connection was cut this many times in a row ends the run.
MOST_CUTS = 3


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


class Engine(abc.ABC):
    """A set of workers; each runs one task at a time. Close it, or use it in a ``with`` block, to end its processes.

    Args:
        name: as the user gave it.
        threads: threads of one task; the number of workers times `threads` is at most the number of cores.
        on_machine: how many tasks a machine runs at a time; None: unknown, so as many as its cores allow.
    """

    def __init__(self, name: str, threads: int, on_machine: int | None = None) -> None:
        self.name = name
        self.threads = threads
        self.on_machine = on_machine

    @abc.abstractmethod
    def slots(self) -> int:
        """How many tasks can run at once; at least 1 if none is running."""

    @abc.abstractmethod
    def _share(self, value: Any) -> Shared:
        """Wraps a value that all tasks use; the result is an argument for :meth:`_submit`."""

    @abc.abstractmethod
    def _submit(self, call: Callable[..., Answer], *arguments: Any) -> Future[Answer]:
        """Starts a call on a worker. If the worker dies, the future gets an error that :meth:`_death` recognises."""

    @abc.abstractmethod
    def _death(self, error: BaseException) -> str | None:
        """Why a worker died; None if the error is of another kind."""

    def _reconnect(self) -> None:
        """Connects again, and ends all futures. Called if the connection was lost, which cancels futures."""
        raise ConnectionError(f"engine {self.name}: the connection was cut")

    @abc.abstractmethod
    def close(self) -> None:
        """Ends the workers that this engine has started, without waiting for tasks; may be called twice."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(self, function: Callable[[S, T], R], tasks: Iterable[T], shared: S) -> Iterator[Outcome[R]]:
        """Yields the outcome of ``function(shared, task)`` for each task, in the order in which they end.

        Function, tasks, `shared` and values are pickled (with cloudpickle, so functions may be local). `shared` is sent
        once to each worker, not once for each task; a task must not change it. At a time, only as many tasks are
        submitted as there are workers. A task whose worker dies runs once more.
        """
        waiting: deque[_Task[T]] = deque()
        source = (_Task(index, item) for index, item in enumerate(tasks))
        running: dict[Future[Answer], _Task[T]] = {}
        handle = self._share(shared)
        try:
            while True:
                while len(running) < self.slots():
                    task = waiting.popleft() if waiting else next(source, None)
                    if task is None:
                        break
                    running[self._submit(answer, function, handle, task.item, self.threads, self.on_machine)] = task
                if not running:
                    return
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                ended = [(running.pop(future), future) for future in done]
                if any(_is_cut(future) for _, future in ended):
                    self._reconnect()
                    ended += [(task, future) for future, task in running.items()]
                    running.clear()
                    handle.close()
                    handle = self._share(shared)
                for task, future in sorted(ended, key=lambda pair: pair[0].index):
                    outcome = self._outcome(task, future)
                    if outcome is None:
                        waiting.append(task)
                    else:
                        yield outcome
        finally:
            for future in running:
                future.cancel()
            handle.close()

    def _outcome(self, task: _Task[T], future: Future[Answer]) -> Outcome[Any] | None:
        """How a task ended; None if it has to run again."""
        if _is_cut(future):
            task.cuts += 1
            if task.cuts < MOST_CUTS:
                return None
            raise ConnectionError(f"engine {self.name}: the connection was cut {MOST_CUTS} times; is it overloaded?")
        error = future.exception()
        if error is None:
            result = future.result()
            return Outcome(task.index, result.value, result.error)
        reason = self._death(error)
        if reason is None:
            if not isinstance(error, Exception):
                raise error  # an interrupt
            return Outcome(task.index, error=error)  # for example, arguments that cannot be pickled
        task.deaths += 1
        if task.deaths < MOST_DEATHS:
            return None
        return Outcome(task.index, error=WorkerDied(f"its worker died {MOST_DEATHS} times: {reason}"))


def _is_cut(future: Future[Answer]) -> bool:
    return future.cancelled() or isinstance(future.exception(), CancelledError | ConnectionError)


@contextmanager
def variable(name: str, value: str) -> Iterator[None]:
    """Inside the block, new processes have a variable of the environment."""
    before = {key: old for key, old in os.environ.items() if key == name}
    os.environ[name] = value
    try:
        yield
    finally:
        del os.environ[name]
        os.environ.update(before)
