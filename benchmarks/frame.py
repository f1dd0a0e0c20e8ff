"""Time of joint segmentation per frame, relative to structured edges: `python benchmarks/frame.py [FOLDER]`.

FOLDER is a recording in the style of 7-Scenes (optional); the other scene is synthetic. The reference is OpenCV's
structured-edge detector alone, with the package's forest, on the same frames and with the same number of threads.
Both run in turn, for several rounds; each figure is the median of the rounds. Processor time is summed over threads.
"""

import argparse
import dataclasses
import statistics
import time
from collections.abc import Callable, Sequence
from importlib.resources import as_file, files
from pathlib import Path

import cv2
import numpy as np
import report
import torch
from torch import nn
from torchjoint_lab.synthetic import make_scene

import torchjoint as tj

#: Stages of the stopwatch that run per frame, in the order of the method.
STAGES = ("boundaries", "image segments", "visibility", "propagation", "image labels")
BATCH = 8
#: From this number of frames on, the result is another one: step 6, which runs once, is shared by more frames.
MANY = 100
TITLES = {
    "all": "whole",
    "all but boundaries": "whole but boundary detection",
    "detectEdges": "structured edges (`detectEdges`)",
}


class Given(nn.Module):
    """A detector that returns precomputed boundaries, batch by batch."""

    def __init__(self, boundaries: Sequence[torch.Tensor]) -> None:
        super().__init__()
        self.boundaries = list(boundaries)

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        batch, self.boundaries = self.boundaries[: len(images)], self.boundaries[len(images) :]
        return torch.stack(batch)


def milliseconds(name: str, function: Callable[[], object], num_frames: int) -> dict[str, float]:
    """Wall clock and processor time of a frame, under the names "NAME, wall clock" and "NAME, processor time"."""
    wall, work = time.perf_counter(), time.process_time()
    function()
    taken = {"wall clock": time.perf_counter() - wall, "processor time": time.process_time() - work}
    return {f"{name}, {clock}": seconds / num_frames * 1000 for clock, seconds in taken.items()}


def measure(scene: tj.Scene, rounds: int) -> dict[str, float]:
    """Returns medians over the rounds, milliseconds per frame."""
    frames = list(scene.frames)
    boundaries = tj.JointSegmenter().image_segmenter.boundary(torch.stack([frame.image for frame in frames]))
    images = [np.ascontiguousarray(frame.image.permute(1, 2, 0).numpy()) for frame in frames]
    with as_file(files("torchjoint.models") / "bsds500.yml.gz") as model:
        detector = cv2.ximgproc.createStructuredEdgeDetection(str(model))
    results: dict[str, list[float]] = {}
    for _ in range(rounds):
        one = milliseconds("detectEdges", lambda: [detector.detectEdges(image) for image in images], len(frames))
        for name, module in (("all", None), ("all but boundaries", Given(boundaries))):
            segmenter = tj.JointSegmenter(boundary=module)
            segmenter.reset(scene.points, scene.colors)
            seconds: dict[str, float] = {}
            one |= milliseconds(name, lambda of=segmenter, to=seconds: to.update(segment(of, frames)), len(frames))
            if module is None:
                one |= {stage: seconds[stage] / len(frames) * 1000 for stage in STAGES}
        for name, value in one.items():
            results.setdefault(name, []).append(value)
    return {name: statistics.median(values) for name, values in results.items()}


def segment(segmenter: tj.JointSegmenter, frames: Sequence[tj.Frame]) -> dict[str, float]:
    """Returns the seconds of each stage."""
    for start in range(0, len(frames), BATCH):
        segmenter.update(frames[start : start + BATCH])
    return dict(segmenter.compute().seconds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--cloud", type=Path, help="kept here, so that it is fused once")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=20, help="of the recording, evenly spread")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    cv2.setNumThreads(arguments.threads)

    scenes = {"synthetic": make_scene(0, "large", num_views=24).scene}
    if arguments.folder is not None:
        recording = tj.load_scene(arguments.folder, cloud=arguments.cloud)
        step = max(1, len(recording.frames) // arguments.frames)
        scenes = {"recording": dataclasses.replace(recording, frames=recording.frames[::step])} | scenes
    results = {name: measure(scene, arguments.rounds) for name, scene in scenes.items()}

    def row(title: str, value: Callable[[dict[str, float]], float]) -> list[str | float]:
        return [title, *(value(result) for result in results.values())]

    times, ratios = [row(stage, lambda result, stage=stage: result[stage]) for stage in STAGES], []
    for clock in ("wall clock", "processor time"):
        edges = f"detectEdges, {clock}"
        for name, title in TITLES.items():
            of = f"{name}, {clock}"
            times.append(row(f"{title}, {clock}", lambda result, of=of: result[of]))
            if name != "detectEdges":
                ratio = lambda result, of=of, edges=edges: result[of] / result[edges]  # noqa: E731
                ratios.append(row(f"{title}, {clock}", ratio))
    sizes = "; ".join(
        f"{name}: {len(scene.frames)} frames of {scene.frames[0].size[1]}x{scene.frames[0].size[0]}, "
        f"{len(scene.points):,} points"
        for name, scene in scenes.items()
    )
    tables = [
        report.Table({"ms a frame": 0} | dict.fromkeys(results, 1), times),
        report.Table({"ratio to `detectEdges`": 0} | {f"{name}, ratio": 2 for name in results}, ratios),
    ]
    report.save("frame" if arguments.frames < MANY else "frame_many", tables, f"{sizes[0].upper()}{sizes[1:]}.")


if __name__ == "__main__":
    main()
