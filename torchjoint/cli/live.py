"""torchjoint live: plays a recording, and segments what has been seen so far."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, NamedTuple

import tyro

from torchjoint.cli.arguments import DEFAULTS, Flat, OptionalOut, output_file, read_topics
from torchjoint.cli.output import summarize
from torchjoint.cli.show import growing_view, serve_until_interrupted
from torchjoint.datasets import find_format, load_scene
from torchjoint.datasets.formats import FORMATS
from torchjoint.datasets.fusion import warn_of_poses
from torchjoint.live import LiveResult, LiveSegmenter, RerunLog
from torchjoint.recordings.playing import Played, computed_beside, play
from torchjoint.recordings.segment import fingerprints, tell_if_changed
from torchjoint.results.checkpoint import model_checksums
from torchjoint.results.folder import write_result
from torchjoint.results.objects import add_to_segments
from torchjoint.results.output_folder import output_folder
from torchjoint.runtime.messages import counted, say
from torchjoint.runtime.outputs import Output, check_apart
from torchjoint.scene import Frame, Scene
from torchjoint.scene.frame import PoseWarning

if TYPE_CHECKING:
    from torchjoint.viewer.live import GrowingView


def live(
    scene: tyro.conf.Positional[Path],
    out: OptionalOut = None,
    parameters: Flat = DEFAULTS,
    rate: float | None = None,
    every: int = 0,
    show: bool = False,
    rerun: Path | None = None,
    voxel_size: float = 0.02,
    step: float = 0.1,
    turn: float = 10.0,
    views: int = 40,
    memory: str | None = None,
    topics: tuple[str, ...] = (),
    time_limit: float = 0.02,
    overwrite: bool = False,
) -> None:
    """Plays a recording with depth, segments what has been seen, and writes the last result.

    The cloud grows with the frames; a cloud of the recording is not used. What becomes of things is printed.

    Args:
        scene: folder of frames with depth, or a ROS recording; docs/your_data.md lists the layouts.
        out: folder for the last result, as of `torchjoint segment`, with the keyframes; default: NAME-live.
        parameters: parameters of the method.
        rate: frames a second, such as 30, to try what a camera would get: frames for which there is no time are
            dropped. Default: all frames, as fast as possible.
        every: compute the things after so many frames, besides after the last one; 0: only then, with --show one time
            after the other. It takes seconds, while frames go on.
        show: open a page in the browser in which the things appear, keep their colours, and can be clicked, named and
            exported; at the end it shows OUT, which has these names.
        rerun: write this file, too, which the viewer of Rerun plays: things, camera, images, changes. Needs
            `pip install 'torchjoint[rerun]'`.
        voxel_size: metres, the distance of the points.
        step: metres; a frame is a keyframe if its camera has moved at least so far since the last one.
        turn: degrees; or if it has turned by at least this angle.
        views: a frame is no keyframe if at least half of its surface is in so many already; 0: no limit.
        memory: memory for the data of the keyframes, such as 2GB; the rest goes to a temporary file. Default: a quarter
            of the memory of the machine or container.
        topics: for a ROS recording, if several topics fit a role: --topics color=/front/image_raw.
        time_limit: for a ROS recording: largest time from an image to its depth image and its pose, seconds.
        overwrite: replace OUT if it is an earlier result, and the file of --rerun.
    """
    _check(rate, every)
    out = out or Path(f"{scene.resolve().stem}-live")
    if rerun is not None:
        check_apart(out, rerun, "--rerun")
    log_file = None if rerun is None else output_file(rerun, overwrite, (scene,), "--rerun")
    config = parameters.config(out)
    segmenter = LiveSegmenter(config, voxel_size=voxel_size, step=step, turn=turn, views=views, memory=memory)
    logged = nullcontext() if log_file is None else _logged(log_file)
    key, inputs = f"live {scene.absolute()}", (scene, *map(Path, model_checksums(config)))
    with logged as log, output_folder(out, key, overwrite=overwrite, inputs=inputs) as partial:
        assert partial is not None  # only runs with a key can be finished
        # A cloud alone is an error below, which opens no page.
        view = growing_view() if show and find_format(scene, None) is not FORMATS["cloud_alone"] else None
        before = fingerprints(scene, None, out)
        recording = load_scene(scene, topics=dict(read_topics(topics)), time_limit=time_limit, fuse=False)
        if not len(recording.frames):
            raise ValueError(f"scene: {scene}: expected frames with depth, got a cloud without frames")
        warn_of_poses(recording.frames, str(scene))
        results = _Results(segmenter, recording, view, log)
        with warnings.catch_warnings(action="ignore", category=PoseWarning):  # the segmenter would say it again
            played = _play(results, rate, every or int(show))
        result = results.compute(len(recording.frames), is_last=True)
        seen = recording.select_frames(played.keyframes)
        things = Scene(result.cloud.points, seen.frames, result.cloud.colors, name=recording.name, up=recording.up)
        write_result(partial, things, result.segmentation, config, str(scene), seconds=segmenter.stopwatch.seconds)
        tell_if_changed(scene, None, out, before)
        add_to_segments(partial, {"lasting_ids": result.ids.tolist()})
    summarize(result.segmentation, out)
    if view is None:
        say(f"torchjoint show {quote(str(out))}: look at it in the browser")
    elif view.viewer is not None:
        view.finish(out, result)
        serve_until_interrupted(view.viewer)


@contextmanager
def _logged(file: Output) -> Iterator[RerunLog]:
    with file.written() as path, RerunLog.to_file(path) as log:
        yield log


def _check(rate: float | None, every: int) -> None:
    if rate is not None and not 0 < rate <= 1000:
        raise ValueError(f"--rate: expected more than 0 and up to 1000 frames a second, or None, got {rate}")
    if every < 0:
        raise ValueError(f"--every: expected a number of frames of at least 0, got {every}")


def _play(results: _Results, rate: float | None, every: int) -> Played:
    """Plays the frames. Beside it, computes a result after `every` frames if none is being computed; 0: no result."""
    with computed_beside(results.compute, every) as due:

        def tell(count: int, frame: Frame | None) -> None:
            if frame is not None:
                results.show_camera(frame, count)
            if results.segmenter.names:
                due(count)

        played = play(results.recording.frames, results.segmenter, rate, tell)
    told = f"{counted(len(played.seconds), 'frame')}, the slowest in {max(played.seconds):.2f} seconds"
    say(f"{told}; {played.told_dropped()}; {counted(len(played.keyframes), 'keyframe')}")
    return played


class _Results(NamedTuple):
    """Computes the things so far, tells what has become of them, and shows them."""

    segmenter: LiveSegmenter
    recording: Scene
    view: GrowingView | None
    log: RerunLog | None

    def show_camera(self, frame: Frame, count: int) -> None:
        """Of the frame that came as number `count`."""
        if self.view is not None:
            self.view.camera(frame)
        if self.log is not None:
            self.log.camera(frame, count)

    def compute(self, count: int, is_last: bool = False) -> LiveResult:
        """Of the first `count` frames."""
        result = self.segmenter.result(images=is_last)
        when = "at the end" if is_last else f"after {counted(count, 'frame')}"
        say(f"{when}: {_described(result)}", flush=True)
        if self.log is not None:
            self.log.show(result, count)
        if self.view is not None:
            note = f"{when}: {counted(len(result.ids), 'thing')}"
            self.view.show(result, self.recording.select_frames(range(count)), note)
        return result


def _described(result: LiveResult) -> str:
    born, gone, merged, split = map(len, result.changes)
    what = f"{counted(len(result.ids), 'thing')} in {len(result.cloud.points)} points"
    return f"{what}; new: {born}, parts of others before: {split}, merged: {merged}, gone: {gone}"
