"""What `compute(images=False)` takes after one more frame: `python benchmarks/one_more_frame.py`.

A generated room of 100,000 points and eight frames of 640x480; then one frame more, and the points' labels again. The
last part is repeated with the same frames, so the figures are medians of equal work.
"""

import argparse
import cProfile
import pstats
import statistics
import time

import report
from torchjoint_lab.synthetic import make_scene

import torchjoint as tj

#: Frames before the one more.
FRAMES = 8


def seconds_after_one_more(scene: tj.Scene) -> tuple[float, float]:
    """Seconds by the clock and of the processors, which compute takes after the last frame."""
    segmenter = tj.JointSegmenter()
    segmenter.reset(scene.points, scene.colors)
    segmenter.update(scene.frames[:FRAMES])
    segmenter.compute(images=False)
    segmenter.update(scene.frames[FRAMES : FRAMES + 1])
    start, work = time.perf_counter(), time.process_time()
    segmenter.compute(images=False)
    return time.perf_counter() - start, time.process_time() - work


def profile(scene: tj.Scene) -> None:
    segmenter = tj.JointSegmenter()
    segmenter.reset(scene.points, scene.colors)
    segmenter.update(scene.frames)
    segmenter.compute(images=False)
    with cProfile.Profile() as profiler:
        segmenter.compute(images=False)
    pstats.Stats(profiler).sort_stats("tottime").print_stats(25)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--profile", action="store_true", help="print what the functions take, instead")
    arguments = parser.parse_args()
    made = make_scene(0, "large", num_views=FRAMES + 1, num_points=arguments.points)
    if arguments.profile:
        profile(made.scene)
        return
    wall, work = zip(*(seconds_after_one_more(made.scene) for _ in range(arguments.rounds)), strict=True)
    size = "x".join(map(str, reversed(made.scene.frames[0].size)))
    about = f"{len(made.scene.points):,} points, {FRAMES} frames of {size} and one more; medians of {arguments.rounds}."
    rows = [["wall clock", statistics.median(wall)], ["processor time", statistics.median(work)]]
    report.save("one_more_frame", [report.Table({"`compute(images=False)`": 0, "s": 2}, rows)], about)


if __name__ == "__main__":
    main()
