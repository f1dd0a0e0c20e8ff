"""Opens engines by the names that users write: ``loky:4``, ``dask``, ``dask://host:port``, ``ray``, ``ray://...``."""

from __future__ import annotations

import logging
import os
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import joblib
from joblib.externals.loky.process_executor import ProcessPoolExecutor

from torchjoint.engine.engine import Engine
from torchjoint.engine.worker import end_with

logger = logging.getLogger(__name__)

EXPECTED = (
    "expected loky, dask or ray for this machine (loky:4: with 4 workers), dask://HOST:PORT, ray://HOST:PORT, or a "
    "concurrent.futures.Executor"
)

#: Most tasks at a time of an executor that does not tell its number of workers; it queues what is too much.
MANY = 64

#: Libraries read their number of threads from these when they start.
_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")

#: Longest waits for a scheduler of dask, and for its workers, seconds. A busy machine takes long to start a worker.
PATIENCE, WORKER_PATIENCE = 30.0, 180.0

#: Settings of a LocalCluster. The scheduler does not repeat tasks, because Engine.run does. It gives a worker no second
#: task, which would die with the first, and waits for a worker that restarts slowly, as on a busy machine.
_LOCAL_CLUSTER = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.deploy.lost-worker-timeout": "1 hour",
}


@contextmanager
def open_engine(engine: str | Executor | Engine = "loky", threads: int = 1) -> Iterator[Engine]:
    """Starts the workers of an engine on this machine, or connects to a cluster; ends what it started.

    Args:
        engine: ``loky``, ``dask`` or ``ray``: workers on this machine, one per core. ``loky:4``, ``dask:4``, ``ray:4``:
            four workers, or fewer if there are fewer cores. ``dask://HOST:PORT``: a running scheduler.
            ``ray://HOST:PORT``: a running cluster. Any other executor is used as it is, and stays open.
        threads: threads of each task.
    """
    if isinstance(engine, Engine):
        yield engine
    elif isinstance(engine, Executor):
        workers = getattr(engine, "_max_workers", None)
        yield Engine(type(engine).__name__, engine, lambda: workers or MANY, threads, workers)
    else:
        kind, workers, address = _parsed(engine, threads)
        # Python would look for modules in the current folder first, which may be a stranger's recording.
        with _variable("PYTHONSAFEPATH", "1"), _OPENERS[kind](engine, threads, workers, address) as started:
            yield started


def _parsed(engine: str, threads: int) -> tuple[str, int | None, str | None]:
    """The kind of an engine, its workers on this machine, or its address."""
    if not isinstance(engine, str):
        raise TypeError(f"engine: {EXPECTED}, got {type(engine).__name__}")
    found = re.fullmatch(r"(loky|dask|ray)(?::([1-9]\d{0,3}))?|(dask|ray)://(.+)", engine)
    if found is None:
        raise ValueError(f"engine: {EXPECTED}, got {engine!r}")
    local, count, remote, address = found.groups()
    if local is not None:
        return local, _workers(None if count is None else int(count), threads), None
    if threads < 1:
        raise ValueError(f"threads: expected 1 or more, got {threads}")
    return remote, None, address


def _workers(count: int | None, threads: int) -> int:
    """Number of workers on this machine; together they have at most as many threads as there are cores."""
    cores = joblib.cpu_count()
    if not 1 <= threads <= cores:
        raise ValueError(f"threads: expected 1 to {cores}, the number of cores, got {threads}")
    most = cores // threads
    if count is not None and count > most:
        logger.warning("engine: %d workers with %d threads each are too many for %d cores", count, threads, cores)
    return most if count is None else min(count, most)


@contextmanager
def _variable(name: str, value: str) -> Iterator[None]:
    """Inside the block, new processes have a variable of the environment."""
    before = {key: old for key, old in os.environ.items() if key == name}
    os.environ[name] = value
    try:
        yield
    finally:
        del os.environ[name]
        os.environ.update(before)


@contextmanager
def _needed(name: str, package: str) -> Iterator[None]:
    try:
        yield
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"engine {name} needs {package}: pip install 'torchjoint[{name}]'") from error


class Processes(Executor):
    """Processes of loky. Each has an executor of its own, so that the death of a process breaks no other.

    Args:
        threads: of each process. A process is started whenever a task is submitted and all others are busy.
    """

    def __init__(self, threads: int) -> None:
        self._environment = dict.fromkeys(_VARIABLES, str(threads))
        self._idle: list[ProcessPoolExecutor] = []
        self._all: set[ProcessPoolExecutor] = set()

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        """Starts a call."""
        executor = self._idle.pop() if self._idle else self._new_process()
        future: Future[Any] = executor.submit(function, *arguments, **options)

        def release(ended: Future[Any]) -> None:
            if not ended.cancelled() and isinstance(ended.exception(), BrokenExecutor):
                self._all.discard(executor)
            else:
                self._idle.append(executor)

        future.add_done_callback(release)
        return future

    def _new_process(self) -> ProcessPoolExecutor:
        executor = ProcessPoolExecutor(1, initializer=end_with, initargs=(os.getpid(),), env=self._environment)
        self._all.add(executor)
        return executor

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes; if `cancel_futures`, without waiting for tasks."""
        executors, idle, self._all, self._idle = self._all, self._idle, set(), []
        for executor in executors:
            executor.shutdown(wait, kill_workers=cancel_futures and executor not in idle)


@contextmanager
def _loky(name: str, threads: int, workers: int, _: None) -> Iterator[Engine]:
    # Loky replaces a worker that has grown by 300 MB, after its task. Large recordings cause this; nothing is lost.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given to the executor")
    processes = Processes(threads)
    try:
        yield Engine(name, processes, lambda: workers, threads, workers)
    finally:
        processes.shutdown(cancel_futures=True)


@contextmanager
def _dask(name: str, threads: int, workers: int | None, address: str | None) -> Iterator[Engine]:
    """The workers of a scheduler: a cluster's, or a LocalCluster on this machine. A thread runs a task at a time."""
    with _needed("dask", "dask.distributed"):
        import dask
        from distributed import Client, LocalCluster
    with ExitStack() as closing:
        if address is None:
            closing.enter_context(dask.config.set(_LOCAL_CLUSTER))
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
            closing.callback(_close, cluster, 60)
            # By address: a client of a cluster object gets old information after workers have died.
            address = cluster.scheduler_address.removeprefix("tcp://")
        try:
            client = Client(f"tcp://{address}", timeout=PATIENCE, set_as_default=False)
        except OSError as error:
            raise ConnectionError(
                f"engine {name}: no scheduler answers at tcp://{address} within {PATIENCE:g} s"
            ) from error
        closing.callback(_close, client, 5)
        if client.dashboard_link:
            logger.info("dask: dashboard at %s", client.dashboard_link)
        each = 1 if workers is not None else threads
        yield Engine(
            name,
            client.get_executor(pure=False),
            lambda: sum(max(1, count // each) for count in _threads_of_workers(client, name).values()),
            threads,
            workers,
            client.dashboard_link,
        )


def _threads_of_workers(client: Any, name: str) -> dict[str, int]:
    """The threads of each worker of dask; waits for the first worker, and while a cut connection is made again."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            threads: dict[str, int] = client.nthreads()
            if threads:
                return threads
            client.wait_for_workers(1, timeout=WORKER_PATIENCE)
        except OSError as error:  # TimeoutError is one
            if time.monotonic() > end:
                raise ConnectionError(f"engine {name}: the scheduler does not answer, or has no worker") from error
            time.sleep(0.2)


def _close(client: Any, timeout: float) -> None:
    with suppress(Exception):  # anything may come if a worker has died, or the connection was lost
        client.close(timeout=timeout)


class RayExecutor(Executor):
    """Calls on ray's workers. A task takes as many of ray's CPUs as it has threads.

    Args:
        ray: the module, which has been connected to a cluster.
        threads: of a task.
    """

    def __init__(self, ray: Any, threads: int) -> None:
        # Ray must not repeat tasks, because Engine.run does.
        self._call = ray.remote(num_cpus=threads, max_retries=0)(_apply)

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        """Starts a call."""
        future: Future[Any] = self._call.remote(function, *arguments, **options).future()
        return future


def _apply(function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    return function(*arguments, **options)


@contextmanager
def _ray(name: str, threads: int, workers: int | None, address: str | None) -> Iterator[Engine]:
    """Workers of ray: those of a cluster, or new ones on this machine."""
    # Ray listens on all interfaces, except where it thinks that there are no clusters (Windows, macOS).
    with _needed("ray", "ray"), _variable("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0"):
        import ray
        from ray.job_config import JobConfig

    class Job(JobConfig):
        """Ray would put the current folder in front of the paths, except where it thinks that it sends it."""

        def _runtime_env_has_working_dir(self) -> bool:
            return True

    options = {"log_to_driver": False, "logging_level": logging.ERROR}
    # Ray's workers import tasks by name, and find the modules that this process finds.
    paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)
    with ExitStack() as closing:
        if workers is None:
            ray.init(f"ray://{address}", **options)
            closing.callback(ray.shutdown)
        else:
            with _variable("PYTHONPATH", paths):
                ray.init("local", num_cpus=workers * threads, include_dashboard=False, job_config=Job(), **options)
            closing.callback(ray.shutdown)
            if ray.util.get_node_ip_address() != "127.0.0.1":
                raise RuntimeError(
                    f"engine {name}: ray listens on all interfaces; set RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0 before "
                    "`import ray`, or import it after the engine was opened"
                )
        yield Engine(
            name,
            RayExecutor(ray, threads),
            lambda: max(1, int(ray.cluster_resources().get("CPU", 0)) // threads),
            threads,
            workers,
        )


_OPENERS: dict[str, Callable[..., Any]] = {"loky": _loky, "dask": _dask, "ray": _ray}
