"""Seconds per stage on a real recording: `python benchmarks/kitchen.py FOLDER`, a folder in the style of 7-Scenes."""

import argparse
import tempfile
import time
from pathlib import Path

import report

import torchjoint as tj
from torchjoint.results.folder import write_result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cloud", type=Path, help="kept here, so that it is fused once")
    arguments = parser.parse_args()
    start = time.perf_counter()
    scene = tj.load_scene(arguments.folder, cloud=arguments.cloud)
    loading = time.perf_counter() - start
    start, start_of_work = time.perf_counter(), time.process_time()
    result = tj.JointSegmenter()(scene, progress=True)
    total, work = time.perf_counter() - start, time.process_time() - start_of_work
    frames = len(result.images)
    with tempfile.TemporaryDirectory() as out:
        start = time.perf_counter()
        write_result(Path(out), scene, result, tj.Config(), str(arguments.folder))
        written = time.perf_counter() - start
    of_all = {"whole, wall clock": total, "whole, processor time": work, "files, wall clock": written}
    seconds = result.seconds | of_all
    rows = [[stage, taken, taken / frames * 1000] for stage, taken in seconds.items()]
    size = "x".join(map(str, reversed(scene.frames[0].size)))
    about = (
        f"{frames} frames of {size}, {len(scene.points):,} points, {result.num_point_segments} segments; loading the "
        f"cloud took {loading:.1f} s. Stages are wall clock, added up over threads."
    )
    report.save("kitchen", [report.Table({"stage": 0, "seconds": 2, "ms a frame": 1}, rows)], about)


if __name__ == "__main__":
    main()
