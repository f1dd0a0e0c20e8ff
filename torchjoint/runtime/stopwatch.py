"""Wall-clock seconds per stage."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock


class Stopwatch:
    """Sums wall-clock seconds by name; the times of parallel threads are added.

    >>> watch = Stopwatch()
    >>> with watch("step"):
    ...     pass
    >>> list(watch.seconds)
    ['step']
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._lock = Lock()

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Adds the duration of the block, in seconds, to the sum of `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            with self._lock:
                self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
