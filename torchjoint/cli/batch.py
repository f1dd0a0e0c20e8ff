"""torchjoint batch: segments any number of recordings over many workers."""

import sys
from typing import Any

import tyro

from torchjoint.cli.arguments import AS_IT_IS, DEFAULTS, Flat, FlatReading, OptionalOut
from torchjoint.recordings import BatchReport
from torchjoint.recordings import batch as run_batch
from torchjoint.recordings.scene_list import FAILURES, SUMMARY
from torchjoint.runtime.messages import say

#: Most failures that are printed, and most characters of each; failures.csv has all.
MOST_PRINTED, MOST_CHARACTERS = 20, 160


def batch(
    scenes: tyro.conf.Positional[tuple[str, ...]],
    out: OptionalOut = None,
    parameters: Flat = DEFAULTS,
    reading: FlatReading = AS_IT_IS,
    engine: str = "loky",
    threads: int = 1,
    overwrite: bool = False,
) -> None:
    """Segments any number of recordings over many workers; each gets a result folder OUT/NAME.

    If it is started again, it skips finished recordings. A recording that fails does not stop the others; the exit
    status is then 1.

    Args:
        scenes: recordings, patterns ('scans/*'), the folder of a data set, or a .txt file that lists any of these.
        out: folder for the results, summary.csv and failures.csv; default: results.
        parameters: parameters of the method.
        reading: how recordings are read.
        engine: loky, dask or ray for this machine (loky:4: with 4 workers), dask://HOST:PORT or ray://HOST:PORT for a
            cluster. dask and ray need `pip install 'torchjoint[dask]'` or `[ray]`.
        threads: threads of one recording; workers on this machine never have more threads than there are cores.
        overwrite: replace earlier results.
    """
    more: dict[str, Any] = {"engine": engine, "threads": threads, "overwrite": overwrite, "allow_import": True}
    more |= {"config": parameters.config(), "options": reading.options(), "progress": sys.stderr.isatty()}
    report = run_batch(scenes, out or "results", **more)
    _print(report)
    if report.failures:
        sys.exit(1)


def _print(report: BatchReport) -> None:
    new = len(report.reports) - len(report.skipped)
    say(f"{new} segmented, {len(report.skipped)} were done before, {len(report.failures)} failed")
    if warned := sum(bool(one.warnings) for one in report.reports.values()):
        say(f"{warned} with warnings: see {report.out / SUMMARY}")
    width = max((len(name) for name in report.failures), default=0)
    for name, reason in list(report.failures.items())[:MOST_PRINTED]:
        say(f"  {name:{width}}  {reason if len(reason) <= MOST_CHARACTERS else reason[:MOST_CHARACTERS] + '...'}")
    if len(report.failures) > MOST_PRINTED:
        say(f"  and {len(report.failures) - MOST_PRINTED} more in {report.out / FAILURES}")
    tables = f"{SUMMARY}, {FAILURES}" if report.failures else SUMMARY
    say(f"written to {report.out}: a folder for each recording, {tables}")
