"""Seconds per stage on a real recording: `python benchmarks/kitchen.py FOLDER`, a folder in the style of 7-Scenes."""

import argparse
import time
from pathlib import Path

import report

import torchjoint as tj


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
    rows = [[stage, f"{seconds:.2f}", f"{seconds / frames * 1000:.1f}"] for stage, seconds in result.seconds.items()]
    for title, seconds in (("wall clock", total), ("processor time", work)):
        rows.append([f"**whole, {title}**", f"**{seconds:.2f}**", f"**{seconds / frames * 1000:.1f}**"])
    size = "x".join(map(str, reversed(scene.frames[0].size)))
    text = (
        f"{frames} frames {size}, {len(scene.points)} points, {result.num_point_segments} segments. Loading the cloud "
        f"(fusing it, where it was not kept): {loading:.1f} s. Stages that work on several frames at a time are added "
        "up over threads.\n\n" + report.table(["stage", "seconds", "ms a frame"], rows) + f"\n\n{report.machine()}."
    )
    print(text)
    report.write_part("kitchen", text)


if __name__ == "__main__":
    main()
