"""torchjoint batch: segments any number of recordings over many workers."""

from __future__ import annotations

import sys

import tyro

from torchjoint.cli._log import printed_log
from torchjoint.cli.arguments import DEFAULTS, Flat, Out, read_topics
from torchjoint.recordings import BatchReport, RecordingOptions
from torchjoint.recordings import batch as run_batch
from torchjoint.recordings.scene_list import FAILURES, SUMMARY

#: Most failures that are printed, and most characters of each; failures.csv has all.
MOST_PRINTED, MOST_CHARACTERS = 20, 160


def batch(
    scenes: tyro.conf.Positional[tuple[str, ...]],
    out: Out,
    parameters: Flat = DEFAULTS,
    engine: str = "loky",
    threads: int = 1,
    overwrite: bool = False,
    voxel_size: float = 0.02,
    topics: tuple[str, ...] = (),
    time_limit: float = 0.02,
    max_frames: int | None = None,
    in_view: bool = False,
    thin: float | None = None,
    merge_within: float = 0.0,
    granularity: float | None = None,
    ignore_poses: bool = False,
    drop_invalid: bool = False,
    least_opacity: float = 0.1,
) -> None:
    """Segments any number of recordings over many workers; each gets a result folder OUT/NAME.

    If it is started again, it skips finished recordings. A recording that fails does not stop the others; the exit
    status is then 1.

    Args:
        scenes: recordings, patterns ('scans/*'), the folder of a data set, or a .txt file that lists any of these.
        out: folder for the results, summary.csv and failures.csv.
        parameters: parameters of the method.
        engine: loky, dask or ray for this machine (loky:4: with 4 workers), dask://HOST:PORT or ray://HOST:PORT for a
            cluster. dask and ray need `pip install 'torchjoint[dask]'` or `[ray]`.
        threads: threads of one recording; workers on this machine never have more threads than there are cores.
        overwrite: replace earlier results.
        voxel_size: metres, for fusing a cloud from depth if a recording has no cloud.
        topics: for ROS recordings, if several topics fit a role: --topics color=/front/image_raw. The roles are color,
            info, depth, points and odometry.
        time_limit: for ROS recordings: largest time from an image to its depth image and its pose, seconds.
        max_frames: number of frames to use, evenly spread over a recording.
        in_view: leave out the points that no frame has in its view.
        thin: keep one point per voxel of this size, metres.
        merge_within: metres; all points in a cube with this side are treated as one point and get the same label.
        ignore_poses: go on if the poses look wrong; else this is an error.
        drop_invalid: leave out the points of the cloud that are NaN or infinite, and tell their number; else they are
            an error.
        least_opacity: of Gaussian splats (a .ply), 0 to 1: fainter ones are no part of the cloud. `torchjoint label`
            gives them labels.
        granularity: level of the labels, 0 (coarse) to 1 (fine); the default is 0.5.
    """
    options = RecordingOptions(
        voxel_size,
        max_frames,
        in_view,
        thin,
        merge_within,
        granularity,
        read_topics(topics),
        time_limit,
        ignore_poses,
        drop_invalid,
        least_opacity,
    )
    with printed_log():
        report = run_batch(
            scenes,
            out,
            engine=engine,
            threads=threads,
            config=parameters.config(),
            options=options,
            overwrite=overwrite,
            progress=sys.stderr.isatty(),
            allow_import=True,
        )
    _print(report)
    if report.failures:
        sys.exit(1)


def _print(report: BatchReport) -> None:
    new = len(report.reports) - len(report.skipped)
    print(f"{new} segmented, {len(report.skipped)} were done before, {len(report.failures)} failed")
    warned = sum(bool(one.warnings) for one in report.reports.values())
    if warned:
        print(f"{warned} with warnings: see {report.out / SUMMARY}")
    width = max((len(name) for name in report.failures), default=0)
    for name, reason in list(report.failures.items())[:MOST_PRINTED]:
        print(f"  {name:{width}}  {reason if len(reason) <= MOST_CHARACTERS else reason[:MOST_CHARACTERS] + '...'}")
    if len(report.failures) > MOST_PRINTED:
        print(f"  and {len(report.failures) - MOST_PRINTED} more in {report.out / FAILURES}")
    tables = f"{SUMMARY}, {FAILURES}" if report.failures else SUMMARY
    print(f"written to {report.out}: a folder for each recording, {tables}")
