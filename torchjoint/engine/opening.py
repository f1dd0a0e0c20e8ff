"""Opens engines by the names that users write: ``loky:4``, ``dask``, ``dask://host:port``, ``ray``, ``ray://...``."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager

import joblib

from torchjoint.engine.engine import Engine, variable

logger = logging.getLogger(__name__)

EXPECTED = "expected loky, dask or ray for this machine (loky:4: with 4 workers), dask://HOST:PORT, or ray://HOST:PORT"


@contextmanager
def open_engine(engine: str | Engine = "loky", threads: int = 1) -> Iterator[Engine]:
    """Starts the workers of an engine on this machine, or connects to a cluster; ends what it started.

    Args:
        engine: ``loky``, ``dask`` or ``ray``: workers on this machine, one per core. ``loky:4``, ``dask:4``, ``ray:4``:
            four workers, or fewer if there are fewer cores. ``dask://HOST:PORT``: a running scheduler.
            ``ray://HOST:PORT``: a running cluster. An :class:`Engine` is used as it is, and stays open.
        threads: threads of each task.
    """
    if isinstance(engine, Engine):
        yield engine
        return
    # Python would look for modules in the current folder first, which may be a stranger's recording.
    with variable("PYTHONSAFEPATH", "1"), _started(engine, threads) as started:
        yield started


def _started(engine: str, threads: int) -> Engine:
    if not isinstance(engine, str):
        raise TypeError(f"engine: {EXPECTED}, got {type(engine).__name__}")
    found = re.fullmatch(r"(loky|dask|ray)(?::([1-9]\d{0,3}))?|(dask|ray)://(.+)", engine)
    if found is None:
        raise ValueError(f"engine: {EXPECTED}, got {engine!r}")
    local, count, remote, address = found.groups()
    if remote is None:
        workers = _workers(None if count is None else int(count), threads)
    elif threads < 1:
        raise ValueError(f"threads: expected 1 or more, got {threads}")
    else:
        workers = None
    kind = local or remote
    if kind == "loky":
        from torchjoint.engine.loky import LokyEngine

        assert workers is not None
        return LokyEngine(engine, threads, workers)
    if kind == "dask":
        from torchjoint.engine.dask import DaskEngine

        return DaskEngine(engine, threads, workers, address)
    from torchjoint.engine.ray import RayEngine

    return RayEngine(engine, threads, workers, address)


def _workers(count: int | None, threads: int) -> int:
    """Number of workers on this machine; together they have at most as many threads as there are cores."""
    cores = joblib.cpu_count()
    if not 1 <= threads <= cores:
        raise ValueError(f"threads: expected 1 to {cores}, the number of cores, got {threads}")
    most = cores // threads
    if count is not None and count > most:
        logger.warning("engine: %d workers with %d threads each are too many for %d cores", count, threads, cores)
    return most if count is None else min(count, most)
