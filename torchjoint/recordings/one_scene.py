"""The task of a worker: segments one recording of a batch."""

import time
import warnings
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path

import joblib
import torch

from torchjoint.config import Config
from torchjoint.datasets.files.readers import fingerprint
from torchjoint.recordings.segment import RecordingOptions, segment_recording
from torchjoint.results.folder import Origin, read_origin, read_record
from torchjoint.results.manifest import check_sizes
from torchjoint.results.output_folder import own_files
from torchjoint.runtime.foreign_files import has_file, is_there
from torchjoint.runtime.memory import as_bytes, peak_memory, reset_peak_memory
from torchjoint.runtime.outputs import BusyError
from torchjoint.runtime.threads import one_at_a_time

#: If another worker writes the result: seconds between checks whether it is done, and longest wait, seconds. A worker
#: that lost its connection continues for a while, although its scene was given to another worker.
POLL_INTERVAL, PATIENCE = 1.0, 3600.0


@dataclass(frozen=True)
class SceneReport:
    """The size of a result, and the time and memory of its run.

    Attributes:
        points: number of points.
        frames: number of frames.
        segments: number of segments of the points.
        seconds: of each part of the run by the clock; they add up to the whole.
        peak_memory: of the worker, megabytes; None if it is unknown.
        warnings: the warnings of the run.
    """

    points: int
    frames: int
    segments: int
    seconds: dict[str, float]
    peak_memory: float | None = None
    warnings: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class Job:
    """The settings of a batch, for all its recordings."""

    out: Path  #: has a folder for each recording, by its name
    config: Config
    options: RecordingOptions
    overwrite: bool
    allow_import: bool = False
    tasks_on_machine: int | None = None  #: how many recordings a machine works on; None: what its cores allow


def run_scene(job: Job, scene: tuple[str, Path]) -> SceneReport:
    """Segments a recording, unless its result exists already; waits while another worker writes the result.

    Threads of one process work one after another. The tasks that a machine runs at a time share the default memory for
    frames.
    """
    name, path = scene
    memory = as_bytes(None) // (job.tasks_on_machine or max(1, joblib.cpu_count() // torch.get_num_threads()))
    out = job.out / name
    with one_at_a_time, warnings.catch_warnings(record=True, action="always") as caught:
        end = time.monotonic() + PATIENCE
        reset_peak_memory()
        while job.overwrite or not is_done(out):
            try:
                segment = partial(segment_recording, path, out, job.config, job.options, memory=memory)
                segment(overwrite=job.overwrite, allow_import=job.allow_import)
                break
            except BusyError:
                if time.monotonic() > end:
                    raise
                time.sleep(POLL_INTERVAL)
        else:
            check_origin(job, name, path)  # the result of another worker, or of another program
    told = tuple(dict.fromkeys(str(one.message) for one in caught if issubclass(one.category, UserWarning)))
    return report_of(out, peak_memory(), told)


def is_done(out: Path) -> bool:
    """Whether a folder holds a result; results are written completely or not at all."""
    return has_file(out / "run.yaml")


def check_origin(job: Job, name: str, path: Path) -> tuple[str, ...]:
    """Compares where a result came from with what the batch would make, and checks that it is whole; what is told."""
    out = job.out / name
    origin = read_origin(out)
    files = fingerprint(path, own_files(out)) if is_there(path) and origin.fingerprint else origin.fingerprint
    asked = Origin(str(path.absolute()), files, version("torchjoint"), job.config, job.options.record(job.config))
    pairs = zip(Origin._fields, asked, origin, strict=True)
    if other := ["options or models" if field == "made" else field for field, one, two in pairs if one != two]:
        told = f"{out}: expected the result of {asked.scene}, got that of {origin.scene}"
        raise ValueError(f"{told}; other {', '.join(other)}; choose another folder, or --overwrite")
    return check_sizes(out)


def report_of(out: Path, memory: float | None = None, told: tuple[str, ...] = ()) -> SceneReport:
    """The report of a result on disk."""
    counts, seconds = read_record(out)
    return SceneReport(counts["points"], counts["frames"], counts["point_segments"], seconds, memory, told)
