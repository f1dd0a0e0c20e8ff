"""Runs independent tasks on any ``concurrent.futures.Executor``; makes one from the names that users write.

::

    with open_engine("loky:2") as engine:
        for outcome in engine.run(divmod, [5, 0], shared=7):
            print(outcome.index, outcome.value, outcome.error)
    # 0 (1, 2) None
    # 1 None integer division or modulo by zero
"""

from __future__ import annotations

import logging
import os
import re
import sys
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

import joblib

from torchjoint.recordings.tasks import Outcome, WorkerDied, answer, end_with

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

logger = logging.getLogger(__name__)

EXPECTED = (
    "expected loky, dask or ray for this machine (loky:4: with 4 workers), dask://HOST:PORT, ray://HOST:PORT, "
    "or a concurrent.futures.Executor"
)
#: Longest waits for a scheduler of dask, and for its first worker, seconds.
PATIENCE, WORKER_PATIENCE = 30.0, 180.0


class Engine:
    """Runs tasks on an executor, at most `slots` at a time.

    Args:
        name: for messages.
        executor: runs the tasks.
        slots: how many tasks run at once.
        threads: of one task.
        on_machine: how many tasks one machine may run at a time.
        deaths: the errors that mean that the worker of a task died.
        renew: makes a new executor after the death of a worker; None: the executor survives it, or is the caller's.
    """

    def __init__(
        self,
        name: str,
        executor: Executor,
        slots: Callable[[], int],
        threads: int,
        on_machine: int,
        deaths: tuple[type[BaseException], ...] = (BrokenExecutor,),
        renew: Callable[[], Executor] | None = None,
    ) -> None:
        self.name, self.threads, self.slots = name, threads, slots
        self._executor, self._on_machine, self._deaths, self._renew = executor, on_machine, deaths, renew

    def run(self, function: Callable[[S, T], R], tasks: Iterable[T], shared: S) -> Iterator[Outcome[R]]:
        """Yields the outcome of ``function(shared, task)`` for each task, in the order in which they end.

        If an executor that can be renewed breaks, the tasks that were running run once more, each alone, after the
        others: a worker that dies again died of its task.

        Raises:
            ConnectionError: the connection to the workers was cut. Outcomes that were yielded stay valid.
        """
        waiting, suspects = deque(enumerate(tasks)), deque[tuple[int, T]]()
        running: dict[Future[Outcome[R]], tuple[int, T]] = {}
        alone = False
        try:
            while waiting or suspects or running:
                while waiting and len(running) < max(1, self.slots()):
                    task = waiting.popleft()
                    running[self._submit(function, shared, task)] = task
                if not running:
                    alone, task = True, suspects.popleft()
                    running[self._submit(function, shared, task)] = task
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                broke = self._renew is not None and any(self._died(future) for future in done)
                if broke:
                    done, _ = wait(running)  # a broken executor ends them all
                for future in sorted(done, key=lambda one: running[one][0]):
                    task = running.pop(future)
                    if self._died(future) and self._renew is not None and not alone:
                        suspects.append(task)
                    else:
                        yield self._outcome(future, task[0])
                if broke and self._renew is not None:
                    self._executor = self._renew()
        finally:
            for future in running:
                future.cancel()

    def _submit(self, function: Callable[[S, T], R], shared: S, task: tuple[int, T]) -> Future[Outcome[R]]:
        try:
            return self._executor.submit(answer, task[0], function, shared, task[1], self.threads, self._on_machine)
        except BrokenExecutor as error:  # it broke before
            future: Future[Outcome[R]] = Future()
            future.set_exception(error)
            return future

    def _died(self, future: Future[Outcome[R]]) -> bool:
        return not future.cancelled() and isinstance(future.exception(), self._deaths)

    def _outcome(self, future: Future[Outcome[R]], index: int) -> Outcome[R]:
        if future.cancelled() or isinstance(future.exception(), CancelledError | ConnectionError):
            raise ConnectionError(f"engine {self.name}: the connection was cut; give the same command again")
        error = future.exception()
        if error is None:
            return future.result()
        if self._died(future):
            code = re.search(r"\{(.*?)\}", str(error))  # of loky: the signal
            reason = f"{code[1] if code else type(error).__name__} (killed, out of memory, or a crash)"
            return Outcome(index, error=WorkerDied(f"its worker died: {reason}"))
        if not isinstance(error, Exception):
            raise error  # an interrupt
        return Outcome(index, error=error)  # for example, arguments that cannot be pickled


@contextmanager
def open_engine(engine: str | Executor | Engine = "loky", threads: int = 1) -> Iterator[Engine]:
    """Starts workers on this machine, or connects to a cluster; ends what it started.

    Args:
        engine: ``loky``, ``dask`` or ``ray``: workers on this machine, one per core. ``loky:4``, ``dask:4``, ``ray:4``:
            four workers, or fewer if there are fewer cores. ``dask://HOST:PORT``: a running scheduler.
            ``ray://HOST:PORT``: a running cluster. An executor is used as it is, and stays open.
        threads: threads of each task.

    Raises:
        ValueError, TypeError: an unknown engine, or more threads than cores.
        ModuleNotFoundError: the engine is not installed; the message says how.
        ConnectionError: there is no cluster at the address, or it has no workers.
    """
    if isinstance(engine, Engine):
        yield engine
        return
    cores = joblib.cpu_count()
    if not isinstance(engine, str):
        if not isinstance(engine, Executor):
            raise TypeError(f"engine: {EXPECTED}, got {type(engine).__name__}")
        most = max(1, cores // _checked(threads))
        yield Engine(type(engine).__name__, engine, lambda: most, threads, most)
        return
    found = re.fullmatch(r"(loky|dask|ray)(?::([1-9]\d{0,3}))?|(dask|ray)://(.+)", engine)
    if found is None:
        raise ValueError(f"engine: {EXPECTED}, got {engine!r}")
    local, count, remote, address = found.groups()
    workers = _workers(int(count) if count else None, threads) if local else max(1, cores // _checked(threads))
    with ExitStack() as stack:
        yield {"loky": _loky, "dask": _dask, "ray": _ray}[local or remote](stack, engine, workers, threads, address)


def _loky(stack: ExitStack, name: str, workers: int, threads: int, _: str | None) -> Engine:
    from joblib.externals.loky.process_executor import ProcessPoolExecutor

    # Loky replaces a worker that has grown by 300 MB, after its task. Large recordings cause this; nothing is lost.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given to the executor")
    libraries = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(threads))

    def start() -> Any:
        pool = ProcessPoolExecutor(workers, initializer=end_with, initargs=(os.getpid(),), env=libraries)
        stack.callback(pool.shutdown, kill_workers=True)
        return pool

    return Engine(name, start(), lambda: workers, threads, workers, renew=start)


def _dask(stack: ExitStack, name: str, workers: int, threads: int, address: str | None) -> Engine:
    try:
        from distributed import Client, LocalCluster
        from distributed.scheduler import KilledWorker
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("engine dask needs dask.distributed: pip install 'torchjoint[dask]'") from error
    if address is None:
        page = "127.0.0.1:0"
        cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=page, silence_logs=50)
        address = stack.enter_context(cluster).scheduler_address.removeprefix("tcp://")
        each = 1
    else:
        each = threads
    try:
        client = stack.enter_context(Client(f"tcp://{address}", timeout=PATIENCE, set_as_default=False))
    except OSError as error:
        raise ConnectionError(f"engine {name}: no scheduler answers at tcp://{address} in {PATIENCE:g} s") from error
    try:
        client.wait_for_workers(1, timeout=WORKER_PATIENCE)
    except OSError as error:  # TimeoutError is one
        raise ConnectionError(f"engine {name}: the scheduler has no worker within {WORKER_PATIENCE:g} s") from error
    warnings.filterwarnings("ignore", "Sending large graph")  # the cloud of a recording, with each chunk of its frames
    logger.info("dask: dashboard at %s", client.dashboard_link)

    def slots() -> int:
        return sum(max(1, count // each) for count in client.nthreads().values())

    return Engine(name, client.get_executor(pure=False), slots, threads, workers, (KilledWorker,))


def _ray(stack: ExitStack, name: str, workers: int, threads: int, address: str | None) -> Engine:
    try:
        import ray
        from ray.exceptions import NodeDiedError, OutOfMemoryError, WorkerCrashedError
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("engine ray needs ray: pip install 'torchjoint[ray]'") from error
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address is not None:
        ray.init(f"ray://{address}", **quiet)
    else:  # ray's workers import tasks by name
        paths = {"PYTHONPATH": os.pathsep.join(os.path.abspath(path) for path in sys.path)}
        here = {"num_cpus": workers * threads, "include_dashboard": False, "_node_ip_address": "127.0.0.1"}
        ray.init("local", runtime_env={"env_vars": paths}, **here, **quiet)
    stack.callback(ray.shutdown)
    options = {"num_cpus": threads, "max_retries": 1}  # a task whose worker dies runs once more

    class RayExecutor(Executor):
        def submit(self, call: Callable[..., R], /, *arguments: Any, **named: Any) -> Future[R]:
            future: Future[R] = ray.remote(call).options(**options).remote(*arguments, **named).future()
            return future

    def slots() -> int:
        return int(ray.cluster_resources().get("CPU", 0)) // threads

    return Engine(name, RayExecutor(), slots, threads, workers, (WorkerCrashedError, NodeDiedError, OutOfMemoryError))


def _checked(threads: int) -> int:
    if threads < 1:
        raise ValueError(f"threads: expected 1 or more, got {threads}")
    return threads


def _workers(count: int | None, threads: int) -> int:
    """Number of workers on this machine; together they have at most as many threads as there are cores."""
    cores = joblib.cpu_count()
    if not 1 <= threads <= cores:
        raise ValueError(f"threads: expected 1 to {cores}, the number of cores, got {threads}")
    most = cores // threads
    if count is not None and count > most:
        logger.warning("engine: %d workers with %d threads each are too many for %d cores", count, threads, cores)
    return most if count is None else min(count, most)
