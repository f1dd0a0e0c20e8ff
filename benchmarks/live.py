"""Times live segmentation: `python benchmarks/live.py RECORDING`, of a recording with depth, such as the kitchen.

The frames come one after the other, none waits. Results are computed between them, and are timed apart. A second table
plays the recording at --rate, as `torchjoint live` does: results are computed beside the frames, each --every frames if
none is being computed.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Sequence
from pathlib import Path

import report
import torch

import torchjoint as tj
from torchjoint.recordings.playing import computed_beside, play
from torchjoint.runtime.memory import peak_memory, reset_peak_memory


def played(frames: Sequence[tj.Frame], rate: float, every: int) -> list[str | float]:
    """How far apart results come while frames do; a row of the second table."""
    segmenter, begun = tj.LiveSegmenter(), []
    seconds: list[float] = []

    def compute(count: int) -> None:
        start = time.perf_counter()
        segmenter.result(images=False)
        begun.append(count)
        seconds.append(time.perf_counter() - start)

    with computed_beside(compute, every) as due:
        done = play(frames, segmenter, rate, lambda count, _: due(count) if segmenter.names else None)
    apart = [b - a for a, b in itertools.pairwise(begun)] or [len(frames)]
    times = torch.tensor(done.seconds) * 1000
    name = f"{rate:g} frames / s, results due after {every}"
    ways = f"{min(apart)} to {max(apart)}", sum(seconds) / len(seconds)
    return [name, f"{len(done.dropped)} of {len(frames)}", float(times.quantile(0.95)), float(times.max()), *ways]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--results", type=int, default=4, help="number of results")
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--every", type=int, default=10)
    arguments = parser.parse_args()
    frames = tj.load_scene(arguments.recording, fuse=False).frames
    segmenter, rows, times = tj.LiveSegmenter(), [], []
    reset_peak_memory()
    for index in range(len(frames)):
        frame = frames[index]
        start = time.perf_counter()
        segmenter.update(frame)
        times.append(1000 * (time.perf_counter() - start))
        if (index + 1) % (len(frames) // arguments.results) == 0:
            start = time.perf_counter()
            result = segmenter.result(images=False)
            seconds = time.perf_counter() - start
            so_far = torch.tensor(times)
            sizes = f"{index + 1}", f"{len(segmenter.names)}", f"{len(result.cloud.points):,}"
            speed = 1000 * len(times) / sum(times), float(so_far.quantile(0.95)), max(times)
            rows.append([*sizes, *speed, seconds, (peak_memory() or 0) / 1000])
            print(rows[-1], flush=True)
    everything = tj.JointSegmenter()
    everything.reset(result.cloud.points, result.cloud.colors)
    everything.update(frames)
    offline = everything.compute(images=False).points
    covering = tj.metrics.segmentation_covering(result.segmentation.points, offline).symmetric
    columns = {"frames": 0, "keyframes": 0, "points": 0, "frames / s": 1, "95 % of the frames, ms": 0}
    columns |= {"slowest, ms": 0, "a result, s": 1, "peak memory, GB": 2}
    about = f"Covering of the last result and that of all frames as keyframes: {covering:.2f}."
    beside = {"played": 0, "dropped": 0, "95 % of the frames, ms": 0, "slowest, ms": 0}
    beside |= {"frames between results": 0, "a result beside frames, s": 1}
    tables = [report.Table(columns, rows), report.Table(beside, [played(frames, arguments.rate, arguments.every)])]
    report.save("live", tables, about=about)


if __name__ == "__main__":
    main()
