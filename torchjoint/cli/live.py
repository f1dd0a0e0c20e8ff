"""torchjoint live: plays a recording at its camera's speed, and segments what has been seen so far."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import tyro

from torchjoint.cli._log import printed_log
from torchjoint.cli._summary import summarize
from torchjoint.cli.arguments import DEFAULTS, Flat, Out
from torchjoint.datasets import load_scene
from torchjoint.live import LiveResult, LiveSegmenter
from torchjoint.recordings.playing import play
from torchjoint.results.folder import write_result
from torchjoint.results.output_folder import output_folder
from torchjoint.scene import Scene


def live(
    scene: tyro.conf.Positional[Path],
    out: Out,
    parameters: Flat = DEFAULTS,
    rate: float | None = 30.0,
    every: int = 0,
    voxel_size: float = 0.02,
    step: float = 0.1,
    turn: float = 10.0,
    overwrite: bool = False,
) -> None:
    """Plays a recording with depth as its camera took it, segments what has been seen, and writes the last result.

    The cloud grows with the frames; a cloud of the recording is not used. What becomes of things is printed.

    Args:
        scene: folder of frames with depth; docs/your_data.md lists the layouts.
        out: folder for the last result, as of `torchjoint segment`, with the keyframes.
        parameters: parameters of the method.
        rate: frames a second; frames for which there is no time are dropped. "None": all frames, as fast as possible.
        every: compute the things after so many frames, besides after the last one; 0: only then. It takes seconds,
            while frames go on.
        voxel_size: metres, the distance of the points.
        step: metres; a frame is a keyframe if its camera has moved at least so far since the last one.
        turn: degrees; or if it has turned by at least this angle.
        overwrite: replace OUT if it is an earlier result.
    """
    if rate is not None and not 0 < rate <= 1000:
        raise ValueError(f"--rate: expected more than 0 and up to 1000 frames a second, or None, got {rate}")
    if every < 0:
        raise ValueError(f"--every: expected a number of frames of at least 0, got {every}")
    config = parameters.config()
    segmenter = LiveSegmenter(config, voxel_size=voxel_size, step=step, turn=turn)
    with printed_log(), output_folder(out, f"live {scene.absolute()}", overwrite=overwrite) as partial:
        assert partial is not None  # only runs with a key can be finished
        recording = load_scene(scene, voxel_size=voxel_size)

        with ThreadPoolExecutor(1) as beside:
            running: list[Future[None]] = []

            def tell(count: int) -> None:
                if running and running[-1].done():
                    running.pop().result()  # raises its error
                if every and count % every == 0 and not running and segmenter.names:
                    running.append(beside.submit(_tell, segmenter, count))

            played = play(recording.frames, segmenter, rate, tell)
        for last in running:
            last.result()
        print(
            f"{len(played.seconds)} frames, the slowest in {max(played.seconds):.2f} seconds; {len(played.dropped)} "
            f"dropped; {len(played.keyframes)} keyframes"
        )
        result = segmenter.result()
        print(f"at the end: {_described(result)}")
        seen = recording.select_frames(played.keyframes)
        things = Scene(result.cloud.points, seen.frames, result.cloud.colors, name=recording.name)
        write_result(partial, things, result.segmentation, config, str(scene), seconds=segmenter.stopwatch.seconds)
    summarize(result.segmentation, out)


def _tell(segmenter: LiveSegmenter, count: int) -> None:
    print(f"after {count} frames: {_described(segmenter.result(images=False))}", flush=True)


def _described(result: LiveResult) -> str:
    born, gone, merged, split = map(len, result.changes)
    what = f"{len(result.ids)} things in {len(result.cloud.points)} points"
    return f"{what}; {born} are new, {split} were parts of others, {merged} have merged, {gone} are gone"
