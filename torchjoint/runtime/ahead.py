"""Computes the next item of a sequence while the caller still works on the last one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

from torchjoint.runtime.threads import one_thread_per_operation

T = TypeVar("T")
R = TypeVar("R")


def ahead(function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    """Yields ``function(item)`` for each item, in order; one thread computes the next while the caller works on one.

    At most two results exist at a time: the caller's, and the next. An error of `function` is raised where its result
    would have been yielded.

    Example:
        >>> list(ahead(lambda number: number**2, range(4)))
        [0, 1, 4, 9]
    """

    def on_one_thread(item: T) -> R:
        with one_thread_per_operation():
            return function(item)

    with ThreadPoolExecutor(1) as pool:
        pending: list[Future[R]] = []
        for item in items:
            ready = [future.result() for future in pending]
            pending = [pool.submit(copy_context().run, on_one_thread, item)]
            yield from ready
        yield from (future.result() for future in pending)
