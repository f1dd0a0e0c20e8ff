"""What many recordings cost: CPU seconds, memory and disk by frames and points, workers, and what an engine adds.

CPU seconds are compared, not wall-clock seconds, where a busy machine would disturb; the runs with 1 and 2 workers are
interleaved.

    python benchmarks/scale.py scenes             # slopes: cost of a frame and of a point
    python benchmarks/scale.py workers --rounds 3
    python benchmarks/scale.py engine --engine loky:2 dask:2 --tasks 1000
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
import report
import torch
from torchjoint_lab.synthetic import make_scene

import torchjoint as tj
from torchjoint.engine import open_engine
from torchjoint.recordings import RecordingOptions, segment_recording
from torchjoint.recordings.one_scene import Job, run_scene
from torchjoint.runtime.memory import peak_memory, reset_peak_memory

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

#: Frames and points of the generated rooms; images have 320 x 240 pixels.
SCENES = [(8, 25_000), (16, 25_000), (32, 25_000), (16, 50_000), (16, 100_000)]


def write_room(folder: Path, seed: int, frames: int, points: int) -> Path:
    from folder_files import write_folder

    made = make_scene(seed, num_views=frames, num_points=points, height=240, width=320)
    return write_folder(folder, made, depth=False)


def megabytes(folder: Path) -> float:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6


def scenes(folder: Path) -> None:
    """CPU seconds, memory and disk of single scenes, and their slopes by least squares."""
    torch.set_num_threads(1)  # as a worker has; threads that wait for one another would count
    rows = []
    segment_recording(write_room(folder / "warm", 1, 2, 5000), folder / "warm-up", tj.Config(), RecordingOptions())
    for index, (frames, points) in enumerate(SCENES):
        room, out = write_room(folder / f"room{index}", 1, frames, points), folder / f"out{index}"
        reset_peak_memory()
        start = time.process_time()
        segment_recording(room, out, tj.Config(), RecordingOptions())
        rows.append((frames, points, time.process_time() - start, peak_memory() or 0, megabytes(out)))
        print(rows[-1], flush=True)
    table = np.array(rows)
    design = np.column_stack([np.ones(len(rows)), table[:, 0], table[:, 1] / 1e5])
    slopes = np.linalg.lstsq(design, table[:, 2:], rcond=None)[0].tolist()
    columns = {"CPU s": 2, "peak memory, MB": 1, "result on disk, MB": 2}
    measured = [[f"{frames} frames, {points:,} points", *values] for frames, points, *values in rows]
    fitted = [[name, *line] for name, line in zip(("fixed", "a frame", "100,000 points"), slopes, strict=True)]
    titles = {"recording": measured, "by least squares": fitted}
    report.save("scale_scenes", [report.Table({name: 0} | columns, lines) for name, lines in titles.items()])


def workers(folder: Path, rounds: int) -> None:
    """The same scenes on one and two workers in turn: wall-clock and CPU seconds, without the workers' start."""
    rows = []
    rooms = [write_room(folder / f"room{seed}", seed, 8, 50_000) for seed in range(8)]
    with open_engine("loky:1") as one, open_engine("loky:2") as two:
        for engine in (one, two):
            list(engine.run(lambda number: __import__("torchjoint").__version__ and number, range(2)))
        for round_ in range(rounds):
            seconds, cpu = [], []
            for engine in (one, two):
                job = Job(folder / f"out-{round_}-{engine.name}", tj.Config(), RecordingOptions(), overwrite=True)
                start = time.perf_counter()
                outcomes = list(engine.run(partial(cpu_seconds, job), [(room.name, room) for room in rooms]))
                seconds.append(time.perf_counter() - start)
                assert all(outcome.error is None for outcome in outcomes)
                cpu.append(sum(outcome.value for outcome in outcomes))
            rows.append([f"round {round_ + 1}", *seconds, seconds[0] / seconds[1], cpu[1] / cpu[0]])
    columns = {"run": 0, "one worker, s": 1, "two workers, s": 1, "times as fast": 2, "times the CPU seconds": 2}
    report.save("scale_workers", [report.Table(columns, rows)])


def cpu_seconds(job: Job, scene: tuple[str, Path]) -> float:
    """What a recording costs its worker."""
    start = time.process_time()
    run_scene(job, scene)
    return time.process_time() - start


def engines(names: list[str], tasks: int) -> None:
    """What each engine adds to a task, in the head: CPU milliseconds for a task that does nothing."""
    columns = {"engine": 0, "CPU ms a task in the head": 1, "tasks a second": 0}
    report.save("scale_engines", [report.Table(columns, [[name, *engine(name, tasks)] for name in names])])


def engine(name: str, tasks: int) -> tuple[float, float]:
    with open_engine(name) as opened:
        list(opened.run(nothing, range(10)))
        cpu, start = time.process_time(), time.perf_counter()
        for outcome in opened.run(nothing, range(tasks)):
            assert outcome.error is None
        cpu, wall = time.process_time() - cpu, time.perf_counter() - start
    return cpu / tasks * 1e3, tasks / wall


def nothing(task: int) -> int:
    return task


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("scenes", "workers", "engine"))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--engine", nargs="+", default=["loky:2"])
    parser.add_argument("--tasks", type=int, default=1000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        if arguments.what == "scenes":
            scenes(Path(temporary))
        elif arguments.what == "workers":
            workers(Path(temporary), arguments.rounds)
        else:
            engines(arguments.engine, arguments.tasks)


if __name__ == "__main__":
    main()
