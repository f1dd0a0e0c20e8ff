"""What a worker does with one recording of a batch."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path

from torchjoint.config import Config
from torchjoint.engine import tasks_on_machine
from torchjoint.recordings.options import RecordingOptions
from torchjoint.recordings.segment import segment_recording
from torchjoint.results.folder import read_record
from torchjoint.runtime.locks import BusyError
from torchjoint.runtime.memory import as_bytes
from torchjoint.runtime.peak_memory import peak_memory, reset_peak_memory

#: A result that another worker writes: how often to look whether it is done, and how long to wait, seconds. A worker
#: whose connection was cut goes on for a while, and its scene is given to another.
LOOK, PATIENCE = 1.0, 3600.0


@dataclass(frozen=True)
class SceneReport:
    """What a result holds, and what it cost.

    Attributes:
        points: number of points.
        frames: number of frames.
        segments: number of segments of the points.
        seconds: by stage; added up over threads.
        peak_memory: of the worker, megabytes; None if it is not known.
        warnings: what the run has warned of.
    """

    points: int
    frames: int
    segments: int
    seconds: dict[str, float]
    peak_memory: float | None = None
    warnings: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class Job:
    """What all recordings of a batch share."""

    out: Path
    config: Config
    options: RecordingOptions
    overwrite: bool

    def folder(self, name: str) -> Path:
        """The result folder of a recording."""
        return self.out / name


def run_scene(job: Job, scene: tuple[str, Path]) -> SceneReport:
    """Segments a recording, unless its result is there already; waits while another worker writes it.

    The workers of a machine share the default of the memory for frames.
    """
    name, path = scene
    out, memory = job.folder(name), as_bytes(None) // tasks_on_machine()
    end = time.monotonic() + PATIENCE
    reset_peak_memory()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        while job.overwrite or not is_done(out):
            try:
                segment_recording(path, out, job.config, job.options, overwrite=job.overwrite, memory=memory)
                break
            except BusyError:
                if time.monotonic() > end:
                    raise
                time.sleep(LOOK)
    told = tuple(dict.fromkeys(str(one.message) for one in caught if issubclass(one.category, UserWarning)))
    return report_of(out, peak_memory(), told)


def is_done(out: Path) -> bool:
    """Whether a folder holds a result: it has one as a whole, or not at all."""
    return (out / "run.yaml").is_file()


def report_of(out: Path, memory: float | None = None, told: tuple[str, ...] = ()) -> SceneReport:
    """The report of a result on disk.

    Raises:
        OSError, ValueError, TypeError: there is none, or it is damaged; the message names the file.
    """
    counts, seconds = read_record(out)
    return SceneReport(counts["points"], counts["frames"], counts["point_segments"], seconds, memory, told)
