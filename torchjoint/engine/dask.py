"""Workers of a dask.distributed scheduler: a cluster's, or a LocalCluster on this machine."""

from __future__ import annotations

import logging
import warnings
from collections import Counter
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, InvalidStateError
from contextlib import ExitStack, suppress
from typing import Any

import cloudpickle

from torchjoint.engine.engine import Engine
from torchjoint.engine.shared_file import SharedFile
from torchjoint.engine.worker import Answer, Shared

try:
    import dask
    from distributed import Client, LocalCluster
    from distributed import Future as DaskFuture
    from distributed.scheduler import KilledWorker
except ModuleNotFoundError as error:
    raise ModuleNotFoundError("engine dask needs dask.distributed: pip install 'torchjoint[dask]'") from error

logger = logging.getLogger(__name__)

#: Longest waits for a scheduler, and for its first worker, seconds. A busy machine takes long to start a worker.
PATIENCE, WORKER_PATIENCE = 30.0, 180.0

#: Settings of a LocalCluster. The scheduler does not repeat tasks, because Engine.run does. It waits for a worker that
#: restarts slowly, as on a busy machine.
_LOCAL = {"distributed.scheduler.allowed-failures": 0, "distributed.deploy.lost-worker-timeout": "1 hour"}

#: States of a future whose value must be computed again.
_GONE = ("error", "cancelled", "lost")


class SharedTask(Shared):
    """A value as a task of the scheduler. The scheduler repeats the task if the workers that hold its value die.

    Scattered data would be lost with these workers.
    """

    def __init__(self, value: Any) -> None:
        self._pickled = cloudpickle.dumps(value)
        self._future: DaskFuture | None = None

    def future(self, client: Client) -> DaskFuture:
        """The value on the cluster. Workers get the value in place of this argument, and keep it."""
        if self._future is None or self._future.client is not client or self._future.status in _GONE:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "Sending large graph")  # it is sent once
                self._future = client.submit(cloudpickle.loads, self._pickled, pure=False)
        return self._future

    def load(self) -> Any:
        """The value. A task of dask does not call this: it gets the value in place of this argument."""
        return cloudpickle.loads(self._pickled)

    def close(self) -> None:
        """Frees the value on the workers."""
        self._future = None


class DaskEngine(Engine):
    """The workers of a scheduler; a worker of `n` threads runs `n` tasks at a time.

    This class chooses the worker of each task. The scheduler may queue two tasks on one worker; both would die with it.

    Args:
        name, threads: as of :class:`Engine`.
        workers: number of processes on this machine, if there is no address.
        address: HOST:PORT of a scheduler, or None.
    """

    def __init__(self, name: str, threads: int, workers: int | None, address: str | None) -> None:
        super().__init__(name, threads, workers if address is None else None)
        self._cluster: LocalCluster | None = None
        self._slots: dict[str, int] = {}  # of each worker
        self._placed: dict[Future[Answer], str] = {}  # the workers of running tasks
        self._closing = ExitStack()
        if address is None:
            self._closing.enter_context(dask.config.set(_LOCAL))
            self._cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
        # By address: a client of a cluster object gets old information after workers have died.
        self._address = self._cluster.scheduler_address if self._cluster is not None else f"tcp://{address}"
        try:
            self._client = self._connect()
        except ConnectionError:
            self._closing.close()
            raise
        if self._client.dashboard_link:
            logger.info("dask: dashboard at %s", self._client.dashboard_link)

    @property
    def dashboard(self) -> str:
        """Address of the scheduler's page for the browser."""
        return str(self._client.dashboard_link)

    def _connect(self) -> Client:
        try:
            client = Client(self._address, timeout=PATIENCE, set_as_default=False)
        except OSError as error:
            raise ConnectionError(
                f"engine {self.name}: no scheduler answers at {self._address} within {PATIENCE:g} s"
            ) from error
        try:
            self._wait_for_workers(client)
        except ConnectionError:
            client.close(timeout=1)
            raise
        return client

    def _wait_for_workers(self, client: Client) -> None:
        try:
            client.wait_for_workers(1, timeout=WORKER_PATIENCE)
        except OSError as error:  # TimeoutError is one
            raise ConnectionError(
                f"engine {self.name}: the scheduler has no worker within {WORKER_PATIENCE:g} s"
            ) from error

    def slots(self) -> int:
        """The workers' threads at this moment, divided by the threads of a task; waits for the first worker."""
        try:
            self._slots = self._slots_of_workers()
        except OSError:
            if self._placed:
                self._end_all()  # Engine.run notices it, and connects again
                return 0
            self._reconnect()
            self._slots = self._slots_of_workers()
        if not self._slots and not self._placed:
            self._wait_for_workers(self._client)
            self._slots = self._slots_of_workers()
        return sum(self._slots.values())

    def _slots_of_workers(self) -> dict[str, int]:
        each = 1 if self._cluster is not None else self.threads
        return {address: max(1, count // each) for address, count in self._client.nthreads().items()}

    def _share(self, value: Any) -> SharedFile | SharedTask:
        return SharedTask(value) if self._cluster is None else SharedFile(value)

    def _submit(self, call: Callable[..., Answer], *arguments: Any) -> Future[Answer]:
        answer: Future[Answer] = Future()
        taken = Counter(self._placed.values())
        free = [worker for worker, slots in self._slots.items() if taken[worker] < slots]
        on_cluster = [one.future(self._client) if isinstance(one, SharedTask) else one for one in arguments]

        def pass_on(ended: DaskFuture) -> None:
            try:
                _end(answer, result=ended.result())
            except BaseException as error:
                _end(answer, error=error)

        place = {"workers": free[:1], "allow_other_workers": True} if free else {}
        future = self._client.submit(call, *on_cluster, pure=False, **place)
        self._placed[answer] = free[0] if free else ""
        answer.add_done_callback(lambda ended: self._placed.pop(ended, None))
        future.add_done_callback(pass_on)
        return answer

    def _death(self, error: BaseException) -> str | None:
        return "killed, out of memory, or a crash" if isinstance(error, KilledWorker) else None

    def _reconnect(self) -> None:
        self._end_all()
        logger.warning("engine %s: the connection was cut; connecting again", self.name)
        with suppress(Exception):  # a client that lost its connection may raise anything
            self._client.close(timeout=1)
        self._client = self._connect()

    def _end_all(self) -> None:
        """Ends the futures that wait for a client: a closed client would never end them."""
        for answer in list(self._placed):
            _end(answer, error=CancelledError())

    def close(self) -> None:
        """Ends the workers if this engine started them; workers of a cluster finish their tasks."""
        with suppress(Exception):
            self._client.close(timeout=5)
        if self._cluster is not None:
            with suppress(KeyError):  # distributed 2026.8 raises it when it closes after a worker died
                self._cluster.close(timeout=60)
        self._closing.close()


def _end(answer: Future[Answer], result: Answer | None = None, error: BaseException | None = None) -> None:
    """Gives a future its result or error, unless it has one."""
    with suppress(InvalidStateError):
        if error is not None:
            answer.set_exception(error)
        elif result is not None:
            answer.set_result(result)
