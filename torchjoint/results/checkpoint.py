"""The state of a long run on disk (results of steps 1-5), so that an interrupted run can resume."""

import hashlib
import shutil
import time
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml

from torchjoint.config import Config
from torchjoint.runtime import bounds
from torchjoint.runtime.files import file_checksum, write_text
from torchjoint.runtime.foreign_files import has_file, read_text
from torchjoint.runtime.store import read_values, write_values
from torchjoint.views.evidence import Evidence
from torchjoint.views.observations import Observations, PackedObservation

#: Longest time between two saves, seconds.
INTERVAL = 20.0

#: Saves may take this share of the time: a small state is saved after each batch, a large one every INTERVAL seconds.
SHARE_OF_TIME = 0.05

#: Version of the files.
FORMAT = 6


class Checkpoint:
    """Saves a :class:`Evidence` from time to time: one file per observation, then the sums over these observations.

    Every file has a checksum and is first written under another name. So after a kill, or on a full disk, the state is
    that of the last save. Every file has the key, too, so files of another run are none of this state.

    Args:
        directory: is created if it does not exist, and emptied if it belongs to another run.
        key: identifies the run, see :func:`run_key`.
    """

    def __init__(self, directory: Path, key: str) -> None:
        self.directory = directory
        key_file, known = directory / "key.txt", f"{FORMAT} {key}"
        if not _is_of_run(key_file, known):
            shutil.rmtree(directory, ignore_errors=True)
            directory.mkdir(parents=True)
            write_text(key_file, known)
        self._key, self._saved, self._next_save = key, 0, 0.0

    def load(self, observations: Observations | None = None) -> Evidence | None:
        """Loads the last saved state; None if there is none, or, with a warning, if its files are damaged.

        Args:
            observations: an empty store, which the state will use; default: one that keeps all in memory.
        """
        try:
            if not has_file(self.directory / "sums.pt"):
                return None
            values = self._read(self.directory / "sums.pt")
            count = values.pop("count")
            observations = Observations() if observations is None else observations
            for i in range(count):
                observations.extend([PackedObservation.from_dict(self._read(self._file(i)))])
            state = Evidence(**values, observations=observations)
            state.check_types()
        except Exception as error:  # a damaged file can raise anything
            warnings.warn(f"{self.directory}: damaged, starting again ({error})", stacklevel=2)
            return None
        self._saved = count
        return state

    def save(self, state: Evidence, *, now: bool = False) -> None:
        """Saves the state if `now` is True, or if it is time: after INTERVAL seconds, or sooner if saving is quick."""
        start = time.monotonic()
        if not now and start < self._next_save:
            return
        for i in range(self._saved, len(state.observations)):
            write_values(self._file(i), state.observations.packed(i).to_dict() | {"run": self._key})
            self._saved = i + 1
        sums = {name: value for name, value in vars(state).items() if name != "observations"}
        write_values(self.directory / "sums.pt", sums | {"count": self._saved, "run": self._key})
        end = time.monotonic()
        self._next_save = end + min(INTERVAL, (end - start) / SHARE_OF_TIME)

    def _read(self, path: Path) -> dict[str, Any]:
        values = read_values(path)
        if values.pop("run") != self._key:
            raise ValueError(f"{path.name} is of another run")
        return values

    def _file(self, index: int) -> Path:
        return self.directory / f"observation-{index:06d}.pt"


def _is_of_run(key_file: Path, known: str) -> bool:
    """Whether a state is of this run; one whose key cannot be read is not."""
    try:
        return has_file(key_file) and read_text(key_file, "a key", bounds.LINE, errors="replace") == known
    except ValueError:
        return False


def run_key(source: str, config: Config) -> str:
    """Identifies a run: a hash of its source, its parameters, the models that they name, and the package's version.

    Args:
        source: describes the run's input (for a recording: its files and their modification times).
        config: the parameters.
    """
    record = yaml.safe_dump([version("torchjoint"), source, config.to_dict(), model_checksums(config)])
    return hashlib.sha256(record.encode()).hexdigest()


def model_checksums(config: Config) -> dict[str, str]:
    """The checksum of each file that the parameters name: a model may be trained anew under its old name."""
    method = config.point_segments.method
    named = (config.boundary.model, method if method.endswith(".npz") else None)
    return {name: file_checksum(Path(name)) for name in named if name is not None and has_file(Path(name))}
