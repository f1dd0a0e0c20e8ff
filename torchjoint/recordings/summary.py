"""The tables of a batch: summary.csv, a row for each result, and failures.csv, a row for each that failed."""

from __future__ import annotations

import csv
import io
import time
import warnings
from pathlib import Path

from torchjoint.recordings.one_scene import SceneReport
from torchjoint.runtime.files import write_text
from torchjoint.runtime.messages import in_one_line

#: Longest time between two writes, seconds; a write may take a twentieth of the time.
INTERVAL, SHARE = 5.0, 0.05

SUMMARY, FAILURES = "summary.csv", "failures.csv"
_COLUMNS = ("scene", "points", "frames", "segments", "seconds", "peak_memory_mb", "warnings")


class Tables:
    """Reports and failures by scene, in a folder; written from time to time, each file as a whole.

    Args:
        folder: of the batch.
        names: of all its scenes, in their order.
    """

    def __init__(self, folder: Path, names: list[str]) -> None:
        self.folder = folder
        self.reports: dict[str, SceneReport] = {}
        self.failures: dict[str, str] = {}
        self._names = names
        self._next = 0.0

    def earlier_memory(self) -> dict[str, float]:
        """Peak memory by scene, from the summary of an earlier run: the results do not hold it."""
        try:
            text = (self.folder / SUMMARY).read_text(encoding="utf-8")
            rows = list(csv.DictReader(io.StringIO(text)))
            return {row["scene"]: float(row["peak_memory_mb"]) for row in rows if row["peak_memory_mb"]}
        except (OSError, ValueError, KeyError, TypeError, csv.Error):
            return {}  # there is none, or somebody has edited it

    def save(self, *, now: bool = False) -> None:
        """Writes both tables, if `now` is True or if it is time; a disk that is full then does not end the batch.

        Warns:
            UserWarning: they could not be written although `now` is True.
        """
        start = time.monotonic()
        if not now and start < self._next:
            return
        try:
            self._write()
        except OSError as error:
            if now:
                reason = in_one_line(error)
                warnings.warn(f"{self.folder}: {SUMMARY} and {FAILURES} are not up to date: {reason}", stacklevel=2)
        end = time.monotonic()
        self._next = end + max(INTERVAL, (end - start) / SHARE)

    def _write(self) -> None:
        """Without failures there is no failures.csv."""
        write_text(self.folder / SUMMARY, self._summary())
        if self.failures:
            rows = [(name, self.failures[name]) for name in self._names if name in self.failures]
            write_text(self.folder / FAILURES, _csv([("scene", "reason"), *rows]))
        else:
            (self.folder / FAILURES).unlink(missing_ok=True)

    def _summary(self) -> str:
        reports = [(name, self.reports[name]) for name in self._names if name in self.reports]
        stages = list(dict.fromkeys(stage for _, report in reports for stage in report.seconds))
        header = (*_COLUMNS[:5], *(f"seconds: {stage}" for stage in stages), *_COLUMNS[5:])
        return _csv([header, *(_row(name, report, stages) for name, report in reports)])


def _row(name: str, report: SceneReport, stages: list[str]) -> tuple[object, ...]:
    memory = "" if report.peak_memory is None else round(report.peak_memory)
    seconds = [report.seconds.get(stage, "") for stage in stages]
    total = round(sum(report.seconds.values()), 3)
    counts = (report.points, report.frames, report.segments)
    return (name, *counts, total, *seconds, memory, "; ".join(report.warnings))


def _csv(rows: list[tuple[object, ...]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
