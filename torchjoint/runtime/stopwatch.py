"""Wall-clock seconds per stage."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
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

    def __getstate__(self) -> dict[str, dict[str, float]]:
        return {"seconds": dict(self.seconds)}

    def __setstate__(self, state: dict[str, dict[str, float]]) -> None:
        self.seconds, self._lock = state["seconds"], Lock()

    def add(self, seconds: Mapping[str, float]) -> None:
        """Adds the seconds by name of another stopwatch."""
        with self._lock:
            for name, value in seconds.items():
                self.seconds[name] = self.seconds.get(name, 0.0) + value

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Adds the duration of the block, in seconds, to the sum of `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            with self._lock:
                self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
