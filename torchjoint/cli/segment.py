"""torchjoint segment: segments a recording and writes the result to a folder."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Any, Literal

import tyro

from torchjoint.cli.arguments import AS_IT_IS, DEFAULTS, Flat, FlatReading, OptionalOut, Parameters
from torchjoint.cli.output import summarize
from torchjoint.cli.show import live_view, show_result
from torchjoint.datasets.files import las, text_clouds
from torchjoint.engine import open_engine
from torchjoint.recordings import RecordingOptions, segment_recording
from torchjoint.recordings.segment import Segmented
from torchjoint.runtime.messages import say

if TYPE_CHECKING:
    from torchjoint.viewer.live import LiveView


def segment(
    scene: tyro.conf.Positional[Path],
    out: OptionalOut = None,
    parameters: Flat = DEFAULTS,
    reading: FlatReading = AS_IT_IS,
    overwrite: bool = False,
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
        scene: folder of frames, or a cloud (.ply, .laz, a mesh, ...); docs/your_data.md lists all.
        out: folder for the result: points.ply, points.npz, images/, overview.png, run.yaml; but for method paper also
            hierarchy.npz and pieces/. Default: SCENE-result in the current folder.
        parameters: parameters of the method.
        reading: how recordings are read.
        overwrite: replace OUT if it is an earlier result.
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
    out, view = out or Path(f"{scene.resolve().stem}-result"), live_view() if show else None
    with nullcontext() if engine is None else open_engine(engine, threads) as workers:
        more = {"masks": masks, "without_masks": without_masks, "overwrite": overwrite, "memory": memory}
        segmented = segmented_and_told(scene, out, parameters, reading.options(), engine=workers, view=view, **more)
    if segmented is not None:
        show_result(out, view, segmented.segmenter, segmented.scene)
        labelled = ".ply", *las.SUFFIXES, *text_clouds.SUFFIXES
        file = scene if scene.suffix.lower() in labelled else next(out.glob("cloud-*mm.ply"), None)
        if view is None and file is not None:
            say(f"torchjoint label {join(map(str, (out, file)))} -o labelled{file.suffix}: its labels in that file")


def segmented_and_told(
    scene: Path, out: Path, parameters: Parameters, options: RecordingOptions, view: LiveView | None, **more: Any
) -> Segmented | None:
    """Segments a recording and prints what came out; `more`: of :func:`~torchjoint.recordings.segment_recording`."""
    more |= {"progress": sys.stderr.isatty(), "begin": str if view is None else view.open, "watch": view}
    segmented = segment_recording(scene, out, parameters.config(out), options, allow_import=True, **more)
    if segmented is None:
        say(f"{out}: an earlier run was killed after it wrote the result; this result is now in its place")
    else:
        summarize(segmented.result, out)
    return segmented
