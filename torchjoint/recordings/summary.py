"""The tables of a batch: summary.csv has a row for each result, failures.csv a row for each failed recording."""

from __future__ import annotations

import csv
import io
import time
import warnings
from pathlib import Path

from torchjoint.recordings.one_scene import SceneReport
from torchjoint.recordings.scene_list import FAILURES, SUMMARY
from torchjoint.runtime.csv_tables import csv_text
from torchjoint.runtime.files import write_text
from torchjoint.runtime.foreign_files import read_text
from torchjoint.runtime.messages import in_one_line

#: Least time between two writes, seconds, and largest share of the time that writes may take.
INTERVAL, SHARE = 5.0, 0.05

_COLUMNS = ("scene", "points", "frames", "segments", "seconds", "peak_memory_mb", "warnings")


class Tables:
    """Reports and failures by scene. They are written to a folder from time to time, each file atomically.

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
        """Reads the peak memory by scene from the summary of an earlier run; the results do not contain it."""
        try:
            text = read_text(self.folder / SUMMARY, "a table")
            rows = list(csv.DictReader(io.StringIO(text)))
            return {
                row["scene"].removeprefix("'"): float(row["peak_memory_mb"]) for row in rows if row["peak_memory_mb"]
            }
        except (OSError, ValueError, KeyError, TypeError, csv.Error):
            return {}  # there is no summary, or somebody has edited it

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
        self._next = end + max(INTERVAL, (end - start) / SHARE)

    def _write(self) -> None:
        """Writes both tables; without failures it removes failures.csv."""
        write_text(self.folder / SUMMARY, self._summary())
        if self.failures:
            rows = [(name, self.failures[name]) for name in self._names if name in self.failures]
            write_text(self.folder / FAILURES, csv_text([("scene", "reason"), *rows]))
        else:
            (self.folder / FAILURES).unlink(missing_ok=True)

    def _summary(self) -> str:
        reports = [(name, self.reports[name]) for name in self._names if name in self.reports]
        parts = list(dict.fromkeys(part for _, report in reports for part in report.seconds))
        header = (*_COLUMNS[:5], *(f"seconds: {part}" for part in parts), *_COLUMNS[5:])
        return csv_text([header, *(_row(name, report, parts) for name, report in reports)])


def _row(name: str, report: SceneReport, parts: list[str]) -> tuple[object, ...]:
    memory = "" if report.peak_memory is None else round(report.peak_memory)
    seconds = [report.seconds.get(part, "") for part in parts]
    total = round(sum(report.seconds.values()), 3)
    counts = (report.points, report.frames, report.segments)
    return (name, *counts, total, *seconds, memory, "; ".join(report.warnings))
