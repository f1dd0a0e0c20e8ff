"""The state of a long run on disk (results of steps 1-5), so that an interrupted run can resume."""

from __future__ import annotations

import hashlib
import shutil
import time
import warnings
from importlib.metadata import version
from pathlib import Path

import torch
import yaml

from torchjoint.config import Config
from torchjoint.runtime.files import atomic_write
from torchjoint.views.observation import Observation
from torchjoint.views.state import JointState

#: Smallest time between two saves, seconds.
INTERVAL = 20.0


class Checkpoint:
    """Saves a :class:`JointState` from time to time: one file per observation, then the sums over these observations.

    Args:
        directory: created if it does not exist; emptied if it belongs to another run.
        key: identifies the run, see :func:`run_key`.
    """

    def __init__(self, directory: Path, key: str) -> None:
        self.directory = directory
        key_file = directory / "key.txt"
        if not key_file.is_file() or key_file.read_text(encoding="utf-8") != key:
            shutil.rmtree(directory, ignore_errors=True)
            directory.mkdir(parents=True)
            key_file.write_text(key, encoding="utf-8")
        self._saved = 0
        self._last_save = time.monotonic()

    def load(self) -> JointState | None:
        """The last saved state; None if there is none, or (with a warning) if its files are damaged."""
        if not (self.directory / "sums.pt").is_file():
            return None
        try:
            values = torch.load(self.directory / "sums.pt", weights_only=True)
            count = values.pop("count")
            observations = [torch.load(self._file(i), weights_only=True) for i in range(count)]
            state = JointState(**values, observations=[Observation.from_dict(o) for o in observations])
        except Exception as error:  # a damaged file can raise anything
            warnings.warn(f"{self.directory}: damaged, starting over ({error})", stacklevel=2)
            return None
        self._saved = count
        return state

    def save(self, state: JointState, *, now: bool = False) -> None:
        """Saves the state if `now` is True or the last save was at least `INTERVAL` seconds ago."""
        if not now and time.monotonic() - self._last_save < INTERVAL:
            return
        for i in range(self._saved, len(state.observations)):
            torch.save(state.observations[i].to_dict(), self._file(i))
        self._saved = len(state.observations)
        sums = {"views": state.views, "overlap_sum": state.overlap_sum, "facing": state.facing, "count": self._saved}
        with atomic_write(self.directory / "sums.pt") as partial:
            torch.save(sums, partial)
        self._last_save = time.monotonic()

    def _file(self, index: int) -> Path:
        return self.directory / f"observation-{index:06d}.pt"


def run_key(source: str, config: Config) -> str:
    """Identifies a run: a hash of its source, its parameters and the package's version.

    Args:
        source: describes the run's input (for a recording: its files and their modification times).
        config: the parameters.
    """
    record = yaml.safe_dump([version("torchjoint"), source, config.to_dict()])
    return hashlib.sha256(record.encode()).hexdigest()
