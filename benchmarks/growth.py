"""Memory and time against the number of frames and of points: `python benchmarks/growth.py`.

Each figure is that of a process of its own. The recording is generated: VIEWS views of one synthetic room, which come
again and again with fresh noise, so that no two frames are equal. Memory is the largest resident memory from the first
frame to the last label image, above what the process takes once the cloud is prepared; that of points is the largest of
the whole process. What has been measured is kept in RESULTS, and not measured again: a long run can be continued.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import report
import torch
from instances import room
from torchjoint_lab.synthetic import make_scene

import torchjoint as tj
from torchjoint.runtime.threads import LazySequence, ahead

VIEWS, POINTS, BATCH = 12, 300_000, 8
NOISE = 0.01
PLOT = Path(__file__).parent / "growth_frames.png"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, nargs="*", default=[100, 300, 500, 1000, 1500])
    parser.add_argument("--points", type=int, nargs="*", default=[10**4, 10**5, 10**6, 10**7])
    parser.add_argument("--size", default="1296x968", help="of a frame, WIDTHxHEIGHT")
    parser.add_argument("--memory", default="500MB")
    parser.add_argument("--results", type=Path, default=Path(tempfile.gettempdir()) / "torchjoint-growth.jsonl")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        kind, *values = arguments.one.split(",")
        print(json.dumps(of_frames(*values) if kind == "frames" else of_points(*values)))
        return
    tasks = [f"points,{count}" for count in arguments.points]
    tasks += [f"frames,{count},{arguments.size},{arguments.memory}" for count in arguments.frames]
    known = measured(arguments.results)
    for task in tasks:
        if task not in known:
            command = [sys.executable, __file__, "--one", task]
            output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
            with arguments.results.open("a") as stream:
                stream.write(json.dumps({"task": task} | json.loads(output.splitlines()[-1])) + "\n")
            print(task, output.splitlines()[-1], flush=True)
    write([measured(arguments.results)[task] for task in tasks], arguments.size, arguments.memory)


def measured(results: Path) -> dict[str, dict]:
    lines = results.read_text().splitlines() if results.is_file() else []
    return {record["task"]: record for record in map(json.loads, lines)}


def memory(name: str) -> float:
    """VmRSS, resident now, or VmHWM, the largest so far; GB."""
    return int(re.search(rf"{name}:\s*(\d+) kB", Path("/proc/self/status").read_text())[1]) * 1024 / 1e9


def recording(num_frames: int, size: str) -> tj.Scene:
    """A room of POINTS points; the views are rendered once, and kept beside the temporary files."""
    width, height = map(int, size.split("x"))
    file = Path(tempfile.gettempdir()) / f"torchjoint-growth-{size}-{VIEWS}-{POINTS}.pt"
    if not file.is_file():
        made = make_scene(0, "large", num_views=VIEWS, width=width, height=height, num_points=POINTS).scene
        frames = [(f.image.mul(255).round().byte(), f.intrinsics, f.world_to_camera) for f in made.frames]
        torch.save((made.points, made.colors, frames), file)
    points, colors, frames = torch.load(file)

    def read(index: int) -> tj.Frame:
        pixels, intrinsics, pose = frames[index % len(frames)]
        noise = np.random.default_rng(index).standard_normal(pixels.shape, dtype=np.float32) * NOISE
        image = (pixels.float() / 255 + torch.from_numpy(noise)).clamp_(0, 1)
        return tj.Frame(image, intrinsics, pose, name=f"{index:06d}")

    return tj.Scene(points, LazySequence(num_frames, read), colors)


def of_frames(count: str, size: str, limit: str) -> dict[str, float]:
    scene = recording(int(count), size)
    segmenter = tj.JointSegmenter(memory=limit)
    segmenter.reset(scene.points, scene.colors)
    before = memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # VmHWM starts anew
    start, work = time.perf_counter(), time.process_time()
    batches = [range(len(scene.frames))[first : first + BATCH] for first in range(0, len(scene.frames), BATCH)]
    for batch in ahead(lambda indices: [scene.frames[index] for index in indices], batches):
        segmenter.update(batch)
    update, update_work = time.perf_counter() - start, time.process_time() - work
    peak_of_update, start, work = memory("VmHWM") - before, time.perf_counter(), time.process_time()
    result = segmenter.compute()
    largest = max(int(labels.max()) for labels in result.images)
    return {
        "count": len(scene.frames),
        "gb": memory("VmHWM") - before,
        "gb_of_update": peak_of_update,
        "disk": segmenter.state.observations._file._end / 1e9 if segmenter.state.observations._file else 0.0,
        "update": update,
        "compute": time.perf_counter() - start,
        "work": update_work + time.process_time() - work,
        "segments": largest + 1,
    }


def of_points(count: str) -> dict[str, float]:
    scene = tj.Scene(room(int(count)))
    start, work = time.perf_counter(), time.process_time()
    result = tj.JointSegmenter()(scene)
    return {
        "count": len(scene.points),
        "gb": memory("VmHWM"),
        "seconds": time.perf_counter() - start,
        "work": time.process_time() - work,
        "segments": result.num_point_segments,
    }


def slope(records: list[dict], key: str) -> float:
    """Of the straight line through the records, per unit of "count"."""
    return float(np.polyfit([one["count"] for one in records], [one[key] for one in records], 1)[0])


def write(records: list[dict], size: str, limit: str) -> None:
    points = [one for one in records if one["task"].startswith("points")]
    frames = [one for one in records if one["task"].startswith("frames")]
    rows = [
        [f"{one['count']:,}", one["gb"], one["disk"], one["update"], one["compute"], 1000 * one["work"] / one["count"]]
        for one in frames
    ]
    columns = {"frames": 0, "GB above the cloud": 2, "GB on disk": 2, "update, s": 0, "compute, s": 0}
    columns |= {"processor time, ms a frame": 0}
    tables = [report.Table(columns, rows, f"Frames of {size}, {POINTS:,} points, memory={limit!r}")]
    rows = [[f"{one['count']:,}", *(one[key] for key in ("gb", "seconds", "work", "segments"))] for one in points]
    columns = {"points": 0, "GB, whole process": 2, "s": 1, "processor time, s": 1, "segments": 0}
    tables.append(report.Table(columns, rows, "A cloud without frames, from points to labels"))
    more = [["a frame", 1e6 * slope(frames, "gb"), 1e6 * slope(frames, "work")]] if len(frames) > 1 else []
    if len(points) > 1:
        more.append(["a point", 1e6 * slope(points, "gb"), 1e6 * slope(points, "work")])
    columns = {"one more": 0, "memory, kB": 1, "processor time, microseconds": 0}
    report.save("growth", [table for table in (*tables, report.Table(columns, more)) if table.rows])
    plot(points, frames)


def plot(points: list[dict], frames: list[dict]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(9, 6), layout="constrained")
    for column, (records, name) in enumerate(((frames, "frames"), (points, "points"))):
        if not records:
            continue
        counts = [one["count"] for one in records]
        for row, (key, label) in enumerate((("gb", "memory, GB"), ("work", "processor time, s"))):
            axis = axes[row, column]
            axis.plot(counts, [one[key] for one in records], "o-")
            axis.set_xlabel(name)
            axis.set_ylabel(label)
            if column:
                axis.set_xscale("log")
                axis.set_yscale("log")
            else:
                axis.set_xlim(0)
                axis.set_ylim(0)
            axis.grid(alpha=0.3)
    figure.savefig(PLOT, dpi=100)


if __name__ == "__main__":
    main()
