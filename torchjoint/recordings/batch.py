"""Segments many recordings on many workers. Each gets its own result folder; a failure does not affect the others."""

import csv
import hashlib
import io
import time
import warnings
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml
from tqdm import tqdm

from torchjoint.config import Config, read_yaml
from torchjoint.engine import EngineLike, WorkerDied, open_engine
from torchjoint.recordings.one_scene import Job, SceneReport, check_origin, is_done, report_of, run_scene
from torchjoint.recordings.scene_list import FAILURES, RECORD, SUMMARY, find_recordings, possible_names
from torchjoint.recordings.segment import RecordingOptions
from torchjoint.results.folder import read_origin
from torchjoint.runtime.files import file_checksum, remove_partial_files, write_text
from torchjoint.runtime.foreign_files import csv_text, has_file, or_unreadable, read_text
from torchjoint.runtime.messages import in_one_line, is_out_of_memory
from torchjoint.runtime.outputs import lock

#: Least time between two writes, seconds, and largest share of the time that writes may take.
INTERVAL, SHARE_OF_TIME = 5.0, 0.05

_COLUMNS = ("scene", "points", "frames", "segments", "seconds", "peak_memory_mb", "warnings")


class Tables:
    """Reports and failures by scene. They are written to a folder from time to time, each file atomically.

    Args:
        folder: of the batch.
        names: of all its scenes, in their order.
        record: the parameters, for the batch's own file, which also tells what was written here.
        written: checksums of the tables that an earlier batch wrote.
    """

    def __init__(self, folder: Path, names: list[str], record: dict[str, Any], written: dict[str, list[str]]) -> None:
        self.folder, self._record, self._written = folder, record, written
        self.reports: dict[str, SceneReport] = {}
        self.others: dict[str, SceneReport] = {}  #: of results that earlier batches of other scenes wrote here
        self.failures: dict[str, str] = {}
        self.lost: dict[str, str] = {}  #: of other scenes, in earlier batches
        self._names, self._next = names, 0.0

    def earlier(self, name: str) -> dict[str, dict[str, str]]:
        """Reads a table of earlier batches: a row by scene. Results hold neither memory nor warnings."""
        file = self.folder / name
        rows = csv.DictReader(io.StringIO(read_text(file, "a table"))) if has_file(file) else ()
        try:
            return {row["scene"].removeprefix("'"): row for row in rows}
        except csv.Error:  # a cell of more than 131,072 characters
            return {}

    def save(self, *, now: bool = False) -> None:
        """Writes both tables if `now` is True or if it is time. A failed write, as on a full disk, raises no error.

        Warns:
            UserWarning: `now` is True, and the write failed.
        """
        start = time.monotonic()
        if not now and start < self._next:
            return
        try:
            self._write()
        except OSError as error:
            if now:
                reason = in_one_line(error)
                warnings.warn(f"{self.folder}: {SUMMARY} and {FAILURES} could not be written: {reason}", stacklevel=2)
        end = time.monotonic()
        self._next = end + max(INTERVAL, (end - start) / SHARE_OF_TIME)

    def _write(self) -> None:
        """Writes both tables; without failures it removes failures.csv."""
        rows = [*self.lost.items(), *((name, self.failures[name]) for name in self._names if name in self.failures)]
        texts = {SUMMARY: self._summary(), FAILURES: csv_text([("scene", "reason"), *rows]) if rows else None}
        for name, text in texts.items():
            _check_table(self.folder / name, self._written)
            known = [file_checksum(self.folder / name)] if has_file(self.folder / name) else []
            self._written[name] = [*known, *([] if text is None else [hashlib.sha256(text.encode()).hexdigest()])]
        # First: after a kill each table is still known to be a batch's.
        write_text(self.folder / RECORD, _text(self._record | {"tables": self._written}))
        for name, text in texts.items():
            if text is not None:
                write_text(self.folder / name, text)
            else:
                (self.folder / name).unlink(missing_ok=True)

    def _summary(self) -> str:
        reports = [*self.others.items(), *((name, self.reports[name]) for name in self._names if name in self.reports)]
        parts = list(dict.fromkeys(part for _, report in reports for part in report.seconds))
        header = (*_COLUMNS[:5], *(f"seconds: {part}" for part in parts), *_COLUMNS[5:])
        return csv_text([header, *(_row(name, report, parts) for name, report in reports)])


def _row(name: str, report: SceneReport, parts: list[str]) -> tuple[object, ...]:
    memory = "" if report.peak_memory is None else round(report.peak_memory)
    seconds = [report.seconds.get(part, "") for part in parts]
    total = round(sum(report.seconds.values()), 3)
    return name, report.points, report.frames, report.segments, total, *seconds, memory, "; ".join(report.warnings)


_LOCK = ".batch.lock"


@dataclass(frozen=True)
class BatchReport:
    """The outcome of a batch.

    Attributes:
        out: folder of the batch; the result of scene NAME is in OUT/NAME, see :func:`torchjoint.load_result`.
        reports: a report of each result, by scene.
        skipped: scenes whose results existed before.
        failures: the reason of each failure, by scene.
    """

    out: Path
    reports: dict[str, SceneReport]
    skipped: tuple[str, ...]
    failures: dict[str, str]


def batch(
    scenes: str | Path | Iterable[str | Path],
    out: str | Path,
    *,
    engine: EngineLike = "loky",
    threads: int = 1,
    config: Config | None = None,
    options: RecordingOptions | None = None,
    overwrite: bool = False,
    progress: bool = False,
    allow_import: bool = False,
) -> BatchReport:
    """Segments any number of recordings, each into a result folder OUT/NAME, which is written completely or not at all.

    A batch that is run again skips finished recordings and resumes interrupted ones. A folder with the result of
    another recording, other files, other parameters or another version is a failure. A recording that fails does not
    stop the others. OUT/summary.csv has a row for each result, OUT/failures.csv the reason of each failure.

    Args:
        scenes: recordings, folders of data sets, patterns, and files that list them; see
            :func:`torchjoint.recordings.find_recordings`.
        out: folder for the results; workers on other machines must see it and the recordings at the same paths.
        engine: the workers: any executor, or a name; see :func:`torchjoint.engine.open_engine`. A script that uses dask
            on this machine must call this function below ``if __name__ == "__main__":``.
        threads: threads of one recording. Workers on this machine never have more threads than there are cores.
        config: parameters of the method; default ``Config()``.
        options: how recordings are read; default ``RecordingOptions()``.
        overwrite: replace earlier results.
        progress: show a progress bar.
        allow_import: import the code that the config names, see :class:`torchjoint.JointSegmenter`.

    Returns:
        reports and failures by scene.

    Raises:
        ValueError, TypeError: an argument is invalid, or OUT holds results of other parameters.
        FileExistsError: another batch is writing to OUT, or OUT is in use for something else.
        ConnectionError, WorkerDied: the engine cannot be reached, or takes no more tasks. Start the batch again; it
            skips finished recordings.

    Warns:
        UserWarning: the last write of the tables failed, for example because the disk is full.
    """
    config, options = config or Config(), options or RecordingOptions()
    options.check(config)
    named = find_recordings(scenes)  # first: a new folder for results is no recording
    job = Job(_prepared(Path(out).absolute()), config, options, overwrite, allow_import)
    found = {_folder(job.out, name, path, named): path for name, path in named.items()}
    with lock(job.out / _LOCK, f"{out}: another batch is writing its results here; wait for it, or choose another"):
        record, written = _check_record(job)
        remove_partial_files(job.out)
        tables = Tables(job.out, list(found), record, written)
        todo, skipped = _sorted_out(job, tables, found)
        try:
            _run(job, todo, tables, engine, threads, progress)
        finally:
            tables.save(now=True)
    return BatchReport(job.out, tables.reports, skipped, tables.failures)


def _run(job: Job, todo: dict[str, Path], tables: Tables, engine: EngineLike, threads: int, progress: bool) -> None:
    """Segments the recordings `todo`. The bar counts all recordings, and estimates the time of the remaining ones."""
    if not todo:
        return
    names, done = list(todo), len(tables.reports)
    with (
        tqdm(total=done + len(todo), initial=done, desc="recordings", unit="scene", disable=not progress) as bar,
        open_engine(engine, threads) as workers,
    ):
        task = partial(run_scene, replace(job, tasks_on_machine=workers.on_machine))
        for outcome in workers.run(task, [(name, path.absolute()) for name, path in todo.items()]):
            name = names[outcome.index]
            if outcome.value is not None:
                tables.reports[name] = outcome.value
            elif outcome.error is not None:
                tables.failures[name] = _reason(outcome.error)
            bar.update()
            if tables.failures:
                bar.set_postfix(failed=len(tables.failures))
            tables.save()


def _reason(error: Exception) -> str:
    """The reason of a failure; it names the error's type if the error is not one that users can cause."""
    is_own = isinstance(error, RuntimeError) and not isinstance(error, WorkerDied) and not is_out_of_memory(error)
    return f"{type(error).__name__}: {in_one_line(error)}" if is_own else in_one_line(error)


def _prepared(out: Path) -> Path:
    if out.exists() and not out.is_dir():
        raise FileExistsError(f"-o: {out} exists and is not a folder")
    if (out / "run.yaml").is_file():
        raise FileExistsError(f"-o: {out} is the result of one recording; choose another folder")
    out.mkdir(parents=True, exist_ok=True)
    return out


def _folder(out: Path, name: str, path: Path, named: dict[str, Path]) -> str:
    """The folder of a recording: its name, or another one that an earlier batch of other recordings gave it."""
    for one in (name, *(other for other in possible_names(path) if other not in named)):
        with suppress(OSError, ValueError, TypeError):  # a damaged result is not its
            if read_origin(out / one).scene == str(path.absolute()):
                return one
    return name


def _check_record(job: Job) -> tuple[dict[str, Any], dict[str, list[str]]]:
    """Writes the parameters of the batch, which one that is resumed must have, too; returns them, and known checksums.

    A user's own files of the names of a batch's are errors, also with `overwrite`.
    """
    file = job.out / RECORD
    record = {"torchjoint": version("torchjoint"), **job.options.record(job.config), "config": job.config.to_dict()}
    earlier, written = read_yaml(file, _parsed, "the parameters of a batch") if has_file(file) else ({}, {})
    if earlier and not record.keys() - {"models"} <= earlier.keys():
        raise FileExistsError(f"{file}: is of no batch; move it, or choose another folder")
    for name in (SUMMARY, FAILURES):
        _check_table(job.out / name, written)
    if earlier and earlier != yaml.safe_load(_text(record)) and not job.overwrite:
        raise ValueError(f"{job.out}: expected the parameters of {file}; choose another folder, or --overwrite")
    write_text(file, _text(record | {"tables": written}))
    return record, written


def _parsed(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, list[str]]]:
    tables = {str(name): [*map(str, checksums)] for name, checksums in dict(values.get("tables", {})).items()}
    return {name: value for name, value in values.items() if name != "tables"}, tables


def _check_table(file: Path, written: dict[str, list[str]]) -> None:
    """Checks that a table is as a batch wrote it: a user's own is not replaced, nor what a user wrote into it."""
    if has_file(file) and file_checksum(file) not in written.get(file.name, ()):
        raise FileExistsError(f"{file}: is not as a batch wrote it, and is kept; move it, or choose another folder")


def _text(record: dict[str, Any]) -> str:
    return yaml.safe_dump(record, sort_keys=False)


def _sorted_out(job: Job, tables: Tables, found: dict[str, Path]) -> tuple[dict[str, Path], tuple[str, ...]]:
    """The recordings without a result, and the names of those that have one; a damaged or other result is a failure."""
    skipped = [name for name in found if not job.overwrite and or_unreadable(is_done, job.out / name)]
    earlier = tables.earlier(SUMMARY)
    tables.lost = {name: row["reason"] for name, row in tables.earlier(FAILURES).items() if name not in found}

    def report(name: str, told: tuple[str, ...] = ()) -> SceneReport:
        row = {"peak_memory_mb": "", "warnings": "", **earlier.get(name, {})}
        told = (*filter(None, row["warnings"].split("; ")), *told)
        return report_of(job.out / name, float(row["peak_memory_mb"] or 0) or None, tuple(dict.fromkeys(told)))

    for name in skipped:
        try:
            tables.reports[name] = report(name, check_origin(job, name, found[name]))
        except (OSError, ValueError, TypeError) as error:
            tables.failures[name] = in_one_line(error)
    for name in sorted(earlier.keys() & {one.name for one in job.out.iterdir()} - found.keys()):
        with suppress(OSError, ValueError, TypeError):  # its result is damaged
            tables.others[name] = report(name)
    return {name: path for name, path in found.items() if name not in skipped}, tuple(tables.reports)
