"""torchjoint segment: segments a recording and writes the result to a folder."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Literal

import tyro

from torchjoint.cli._log import printed_log
from torchjoint.cli._summary import summarize
from torchjoint.cli.arguments import DEFAULTS, Flat, Out, read_topics
from torchjoint.cli.show import live_view, show_result
from torchjoint.engine import open_engine
from torchjoint.recordings import RecordingOptions, segment_recording


def segment(
    scene: tyro.conf.Positional[Path],
    out: Out,
    parameters: Flat = DEFAULTS,
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
    masks: Path | None = None,
    without_masks: Literal["segment", "leave-out"] = "segment",
    memory: str | None = None,
    engine: str | None = None,
    threads: int = 1,
    show: bool = False,
) -> None:
    """Segments a recording: a folder of posed frames, with or without a point cloud.

    An interrupted run continues when it is started again with the same arguments.

    Args:
        scene: folder of frames; docs/your_data.md lists the layouts.
        out: folder for the result: points.ply, points.npz, images/, overview.png, run.yaml; with method learned also
            hierarchy.npz and pieces/.
        parameters: parameters of the method.
        overwrite: replace OUT if it is an earlier result.
        voxel_size: metres, for fusing a cloud from depth if the recording has no cloud.
        topics: for a ROS recording, if several topics fit a role: --topics color=/front/image_raw. The roles are color,
            info, depth, points and odometry.
        time_limit: for a ROS recording: largest time from an image to its depth image and its pose, seconds.
        max_frames: number of frames to use, evenly spread over the recording.
        thin: keep one point per voxel of this size, metres; for clouds that are denser than their noise, or too large.
        merge_within: metres; all points in a cube with this side are treated as one point and get the same label.
        in_view: leave out the points that no frame has in its view (a LiDAR sees all around, a camera does not).
        ignore_poses: go on if the poses look wrong; else this is an error.
        drop_invalid: leave out the points of the cloud that are NaN or infinite, and tell their number; else they are
            an error.
        least_opacity: of Gaussian splats (a .ply), 0 to 1: fainter ones are no part of the cloud. `torchjoint label`
            gives them labels.
        granularity: level of the labels, 0 (coarse) to 1 (fine); the default is 0.5. All levels are always saved. Only
            point_segments.method learned has levels; auto chooses it unless the cloud is a scan.
        masks: masks of a network: a folder with NAME.png (labels, 0 = none), NAME.npz, NAME.json (SAM) or a folder NAME
            of binary PNGs for each frame NAME; or a COCO file. docs/masks.md shows how to make them.
        without_masks: whether frames without masks are segmented without masks, or left out.
        memory: memory for the data of the frames, such as 2GB; the rest goes to the disk of OUT. The labels do not
            change. Default: a quarter of the memory of the machine or container.
        engine: workers for the frames of a long recording: loky, dask or ray on this machine (loky:4: with 4 workers),
            dask://HOST:PORT or ray://HOST:PORT for a cluster. The labels do not change.
        threads: threads of each of these workers.
        show: show the run in the browser: first the labels so far, which change with each frame, then the result, as
            `torchjoint show` does.
    """
    config = parameters.config()
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
    view = live_view(show)
    with printed_log(), nullcontext() if engine is None else open_engine(engine, threads) as workers:
        segmented = segment_recording(
            scene,
            out,
            config,
            options,
            masks=masks,
            without_masks=without_masks,
            overwrite=overwrite,
            memory=memory,
            engine=workers,
            progress=sys.stderr.isatty(),
            on_frames=view,
            allow_import=True,
        )
    if segmented is None:
        print(f"{out}: an earlier run was killed after it wrote the result; this result is now in its place")
        return
    summarize(segmented.result, out)
    show_result(out, view, segmented.segmenter, segmented.scene)
