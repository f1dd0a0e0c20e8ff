"""A value that the workers on this machine read from a file."""

from __future__ import annotations

import os
import tempfile
import uuid
from typing import Any

import cloudpickle

from torchjoint.engine.worker import Shared


class SharedFile(Shared):
    """A pickled value in a file of the main process. The file is already deleted: it disappears with the process."""

    def __init__(self, value: Any) -> None:
        self.key = uuid.uuid4().hex
        self._file = tempfile.TemporaryFile()  # noqa: SIM115
        cloudpickle.dump(value, self._file)
        self._file.flush()
        self._path = f"/proc/{os.getpid()}/fd/{self._file.fileno()}"

    def __getstate__(self) -> dict[str, Any]:
        return {"key": self.key, "_path": self._path}

    def load(self) -> Any:
        """The value."""
        with open(self._path, "rb") as stream:
            return cloudpickle.load(stream)

    def close(self) -> None:
        """Removes the file."""
        self._file.close()
