"""Opens engines by the names that users write: ``loky:4``, ``dask``, ``dask://host:port``, ``ray``, ``ray://...``."""

import logging
import os
import re
import secrets
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import joblib
from joblib.externals.loky.process_executor import ProcessPoolExecutor

from torchjoint.engine.engine import Engine, end_with
from torchjoint.runtime.messages import needed_for

logger = logging.getLogger(__name__)

EXPECTED = "expected loky, dask or ray for this machine (loky:4: with 4 workers), dask://HOST:PORT, or ray://HOST:PORT"

#: Most tasks at a time of an executor that does not tell its number of workers; it queues what is too much.
MAX_WORKERS = 64

#: Libraries read their number of threads from these when they start.
_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")

#: Longest waits for a scheduler of dask, and for its workers, seconds. A busy machine takes long to start a worker.
PATIENCE, WORKER_PATIENCE = 30.0, 180.0

#: The scheduler of a LocalCluster does not repeat tasks, because Engine.run does. It gives a worker no second task,
#: which would die with the first, and waits for a worker that restarts slowly, as on a busy machine.
_LOCAL_CLUSTER = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.deploy.lost-worker-timeout": "1 hour",
}


#: What :func:`open_engine` takes.
EngineLike = str | Executor | Engine


@contextmanager
def open_engine(engine: EngineLike = "loky", threads: int = 1) -> Iterator[Engine]:
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
        yield Engine(type(engine).__name__, engine, lambda: workers or MAX_WORKERS, threads, workers)
    elif not isinstance(engine, str):
        raise TypeError(f"engine: {EXPECTED}, or an executor, got {type(engine).__name__}")
    else:
        kind, workers, address = _parsed(engine, threads)
        with ExitStack() as closing:
            # Python would look for modules in the current folder first, which may be a stranger's recording.
            closing.enter_context(_variable("PYTHONSAFEPATH", "1"))
            # Loky's tracker removes what a killed run leaves, and need not tell.
            closing.enter_context(_variable("PYTHONWARNINGS", "ignore:resource_tracker"))
            yield _OPENERS[kind](closing, engine, threads, workers, address)


def _parsed(engine: str, threads: int) -> tuple[str, int | None, str | None]:
    """The kind of an engine, its workers on this machine, or its address.

    Together, the workers on this machine have at most as many threads as there are cores.
    """
    found = re.fullmatch(r"(loky|dask|ray)(?::([1-9]\d{0,3}))?|(dask|ray)://(.+)", engine)
    if found is None:
        raise ValueError(f"engine: {EXPECTED}, got {engine!r}")
    local, count, remote, address = found.groups()
    if remote is not None:
        if threads < 1:
            raise ValueError(f"threads: expected 1 or more, got {threads}")
        return remote, None, address
    cores = joblib.cpu_count()
    if not 1 <= threads <= cores:
        raise ValueError(f"threads: expected 1 to {cores}, the number of cores, got {threads}")
    most = cores // threads
    if count is not None and int(count) > most:
        logger.warning("engine: %s workers with %d threads each are too many for %d cores", count, threads, cores)
    return local, min(int(count or most), most), None


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


class Processes(Executor):
    """Processes of loky with so many threads each. A call starts one if all are busy.

    Each has an executor of its own, so that the death of a process breaks no other.
    """

    def __init__(self, threads: int) -> None:
        environment = dict.fromkeys(_VARIABLES, str(threads))
        self._options = {"initializer": end_with, "initargs": (os.getpid(),), "env": environment}
        self._idle: list[ProcessPoolExecutor] = []
        self._all: set[ProcessPoolExecutor] = set()

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        """Starts a call."""
        executor = self._idle.pop() if self._idle else ProcessPoolExecutor(1, **self._options)
        self._all.add(executor)
        future: Future[Any] = executor.submit(function, *arguments, **options)

        def release(ended: Future[Any]) -> None:
            if not ended.cancelled() and isinstance(ended.exception(), BrokenExecutor):
                self._all.discard(executor)
            else:
                self._idle.append(executor)

        future.add_done_callback(release)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes; if `cancel_futures`, without waiting for tasks."""
        executors, idle, self._all, self._idle = self._all, self._idle, set(), []
        for executor in executors:
            executor.shutdown(wait, kill_workers=cancel_futures and executor not in idle)


def _loky(closing: ExitStack, name: str, threads: int, workers: int, _: None) -> Engine:
    # Loky replaces a worker that has grown by 300 MB, after its task. Large recordings cause this; nothing is lost.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given to the executor")
    processes = Processes(threads)
    closing.callback(processes.shutdown, cancel_futures=True)
    return Engine(name, processes, lambda: workers, threads, workers)


def _dask(closing: ExitStack, name: str, threads: int, workers: int | None, address: str | None) -> Engine:
    """The workers of a scheduler: a cluster's, or a LocalCluster on this machine. A thread runs a task at a time."""
    with needed_for("engine dask", "dask.distributed", "torchjoint[dask]"):
        import dask
        from distributed import Client, LocalCluster
    if address is None:
        closing.enter_context(dask.config.set(_LOCAL_CLUSTER))
        page = {"dashboard_address": "127.0.0.1:0", "silence_logs": logging.CRITICAL}
        cluster = LocalCluster(n_workers=workers, threads_per_worker=1, **page)
        closing.callback(_close, cluster, 60)
        # By address: a client of a cluster object gets old information after workers have died.
        address = cluster.scheduler_address.removeprefix("tcp://")
    try:
        client = Client(f"tcp://{address}", timeout=PATIENCE, set_as_default=False)
    except OSError as error:
        raise ConnectionError(f"engine {name}: no scheduler answers at tcp://{address} in {PATIENCE:g} s") from error
    closing.callback(_close, client, 5)
    if client.dashboard_link:
        logger.info("dask: dashboard at %s", client.dashboard_link)
    each = threads if workers is None else 1

    def slots() -> int:
        return sum(max(1, count // each) for count in _threads_of_workers(client, name).values())

    return Engine(name, client.get_executor(pure=False), slots, threads, workers, client.dashboard_link)


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
    """Calls on ray's workers, each on so many of its CPUs. Ray must not repeat them, because Engine.run does."""

    def __init__(self, ray: Any, threads: int) -> None:
        call = ray.remote(num_cpus=threads, max_retries=0)
        self._remote = call(lambda function, *arguments, **options: function(*arguments, **options))

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        """Starts a call."""
        return self._remote.remote(function, *arguments, **options).future()


def _ray(closing: ExitStack, name: str, threads: int, workers: int | None, address: str | None) -> Engine:
    """Workers of ray: those of a cluster, or new ones on this machine."""
    # Ray listens on all interfaces, except where it thinks that there are no clusters (Windows, macOS).
    with needed_for("engine ray", "ray", "torchjoint[ray]"), _variable("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0"):
        import ray
        from ray.job_config import JobConfig

    class Job(JobConfig):
        """Ray would put the current folder in front of the paths, except where it thinks that it sends it."""

        def _runtime_env_has_working_dir(self) -> bool:
            return True

    if workers is None:
        _connect(ray, name, f"ray://{address}")
    else:
        _make_token()
        # Ray's workers import tasks by name, and find the modules that this process finds.
        with _variable("PYTHONPATH", os.pathsep.join(map(os.path.abspath, sys.path))):
            _connect(ray, name, "local", num_cpus=workers * threads, include_dashboard=False, job_config=Job())
    closing.callback(ray.shutdown)
    if workers is not None and ray.util.get_node_ip_address() != "127.0.0.1":
        raise RuntimeError(f"engine {name}: expected to import ray first, so that no other machine reaches it")

    def slots() -> int:
        return max(1, int(ray.cluster_resources().get("CPU", 0)) // threads)

    return Engine(name, RayExecutor(ray, threads), slots, threads, workers)


def _make_token() -> None:
    """Makes the token that ray's processes read, if there is none.

    Ray would let all users read it. And two programs that start at once would each make one, so that some processes
    of ray read the one, some the other, or half of it; then they wait for each other in vain.
    """
    with suppress(OSError, RuntimeError):  # ray makes one, or tells why it cannot; it may need none
        path = Path.home() / ".ray" / "auth_token"
        path.parent.mkdir(exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent) as file:
            file.write(secrets.token_hex(32))
            file.flush()
            os.link(file.name, path)  # fails if there is one


def _connect(ray: Any, name: str, address: str, **options: Any) -> None:
    """Connects to a cluster of ray, or starts one here. Both start processes, which can fail on a busy machine."""
    for others_left in (2, 1, 0):
        try:
            ray.init(address, log_to_driver=False, logging_level=logging.ERROR, **options)
            return
        except Exception as error:
            is_late = isinstance(error, ConnectionAbortedError) or re.match("Timed out|The current node", str(error))
            if not is_late and not isinstance(error, ConnectionError):
                raise  # such as of a ray that the caller has started
            ray.shutdown()  # it would still send the calls of this process to the cluster, also those of another engine
            if others_left == 0 or not is_late:
                raise ConnectionError(f"engine {name}: ray does not answer: {error}") from error


_OPENERS: dict[str, Callable[..., Engine]] = {"loky": _loky, "dask": _dask, "ray": _ray}
