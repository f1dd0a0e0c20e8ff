"""Workers of ray: those of a cluster, or new ones on this machine."""

from __future__ import annotations

import logging
import os
import sys
import uuid
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any
from unittest.mock import patch

from torchjoint.engine.engine import Engine, variable
from torchjoint.engine.worker import Answer, Shared

try:
    import ray
    from ray._private import ray_constants
    from ray.exceptions import NodeDiedError, OutOfMemoryError, WorkerCrashedError
    from ray.job_config import JobConfig
except ModuleNotFoundError as error:
    raise ModuleNotFoundError("engine ray needs ray: pip install 'torchjoint[ray]'") from error


class SharedObject(Shared):
    """A value in ray's object store. Ray would unpickle a plain argument again for each task."""

    def __init__(self, value: Any) -> None:
        self.key = uuid.uuid4().hex
        self._reference = ray.put(value)

    def load(self) -> Any:
        """The value."""
        return ray.get(self._reference)

    def close(self) -> None:
        """Frees the value in ray."""
        del self._reference


class RayEngine(Engine):
    """Workers of ray; a task takes as many of ray's CPUs as it has threads.

    Args:
        name, threads: as of :class:`Engine`.
        workers: number of processes on this machine, if there is no address.
        address: HOST:PORT of a cluster's client server, or None.
    """

    def __init__(self, name: str, threads: int, workers: int | None, address: str | None) -> None:
        super().__init__(name, threads, workers if address is None else None)
        quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
        if address is not None:
            ray.init(f"ray://{address}", **quiet)
        else:
            assert workers is not None
            # Ray's workers import tasks by name, and find the modules that this process finds.
            paths = os.pathsep.join(os.path.abspath(path) for path in sys.path)
            with (
                variable("PYTHONPATH", paths),
                # Ray listens on all interfaces, except where it thinks that there are no clusters (Windows, macOS).
                patch.object(ray_constants, "ENABLE_RAY_CLUSTER", False),
                # Ray would put the current folder in front of the paths, except where it thinks that it sends it.
                patch.object(JobConfig, "_runtime_env_has_working_dir", return_value=True),
            ):
                ray.init("local", num_cpus=workers * threads, include_dashboard=False, **quiet)
        # Ray must not repeat tasks, because Engine.run does.
        self._options = {"num_cpus": threads, "max_retries": 0}

    def slots(self) -> int:
        """The cluster's CPUs at this moment, divided by the threads of a task."""
        return max(1, int(ray.cluster_resources().get("CPU", 0)) // self.threads)

    def _share(self, value: Any) -> SharedObject:
        return SharedObject(value)

    def _submit(self, call: Callable[..., Answer], *arguments: Any) -> Future[Answer]:
        future: Future[Answer] = ray.remote(call).options(**self._options).remote(*arguments).future()
        return future

    def _death(self, error: BaseException) -> str | None:
        if isinstance(error, OutOfMemoryError):
            return "ray ended it because the machine's memory was nearly full"
        is_death = isinstance(error, WorkerCrashedError | NodeDiedError)
        return "killed, out of memory, or a crash" if is_death else None

    def close(self) -> None:
        """Ends the workers if this engine started them; otherwise disconnects from the cluster."""
        ray.shutdown()
