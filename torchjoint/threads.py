"""How work is spread over processors so that results never depend on how many there are.

A torch operation splits its tensor over threads, and the vectorised and the scalar code that handle the middle and
the end of each part may round differently: `atan2` of one element can change with the number of threads. So inside
this package one operation always runs on one thread, and parallelism comes from *frames*: several are worked on at
once, each by one Python thread (torch releases the GIL).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

import torch

T = TypeVar("T")
R = TypeVar("R")

_workers: ContextVar[int | None] = ContextVar("torchjoint_workers", default=None)


@contextmanager
def one_thread_per_operation() -> Iterator[None]:
    """Within: a torch operation runs on one thread, and :func:`map_frames` on as many as torch had before."""
    threads = torch.get_num_threads()
    token = _workers.set(num_threads())
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        _workers.reset(token)


def num_threads() -> int:
    """How many threads the package may use here: as many as torch may; one inside :func:`map_frames`."""
    return _workers.get() or torch.get_num_threads()


@contextmanager
def all_threads() -> Iterator[None]:
    """Within: compiled operators use all threads again. For those only whose result does not depend on how many."""
    before = torch.get_num_threads()
    torch.set_num_threads(num_threads())
    try:
        yield
    finally:
        torch.set_num_threads(before)


def map_frames(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """``[function(item) for item in items]`` on several Python threads, in the order of the items."""
    items = list(items)
    workers = min(num_threads(), len(items))
    if workers <= 1:
        with one_thread_per_operation():
            return [function(item) for item in items]

    def on_one_thread(item: T) -> R:
        # A new Python thread starts with torch's global setting; nested calls must not spread any further.
        _workers.set(1)
        if torch.get_num_threads() != 1:
            torch.set_num_threads(1)
        with torch.no_grad():  # gradient mode, too, is a setting of each thread
            return function(item)

    with one_thread_per_operation(), ThreadPoolExecutor(workers) as pool:
        return list(pool.map(on_one_thread, items))
