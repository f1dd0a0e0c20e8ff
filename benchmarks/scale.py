"""What many recordings cost: CPU seconds, memory and disk by frames and points, workers, and what an engine adds.

CPU seconds are compared, not wall-clock seconds, where a busy machine would disturb; the runs with 1 and 2 workers are
interleaved.

    python benchmarks/scale.py scenes             # slopes: cost of a frame and of a point
    python benchmarks/scale.py workers --rounds 3
    python benchmarks/scale.py engine --engine dask:2 --tasks 1000
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

import torchjoint as tj
from torchjoint.engine import open_engine
from torchjoint.recordings import RecordingOptions, segment_recording
from torchjoint.recordings.one_scene import Job, run_scene
from torchjoint.runtime.peak_memory import peak_memory, reset_peak_memory

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

#: Frames and points of the generated rooms; images have 320 x 240 pixels.
SCENES = [(8, 25_000), (16, 25_000), (32, 25_000), (16, 50_000), (16, 100_000)]


def write_room(folder: Path, seed: int, frames: int, points: int) -> Path:
    from folder_files import write_folder

    made = tj.synthetic.make_scene(seed, num_views=frames, num_points=points, height=240, width=320)
    return write_folder(folder, made, depth=False)


def megabytes(folder: Path) -> float:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6


def scenes(folder: Path) -> None:
    """CPU seconds, memory and disk of single scenes, and their slopes by least squares."""
    torch.set_num_threads(1)  # as a worker has; threads that wait for one another would count
    rows = []
    segment_recording(write_room(folder / "warm", 1, 2, 5000), folder / "warm-up", tj.Config(), RecordingOptions())
    print("| frames | points | CPU s | peak memory, MB | result on disk, MB |\n|---:|---:|---:|---:|---:|")
    for index, (frames, points) in enumerate(SCENES):
        room, out = write_room(folder / f"room{index}", 1, frames, points), folder / f"out{index}"
        reset_peak_memory()
        start = time.process_time()
        segment_recording(room, out, tj.Config(), RecordingOptions())
        rows.append((frames, points, time.process_time() - start, peak_memory() or 0, megabytes(out)))
        print("| {} | {:,} | {:.1f} | {:.0f} | {:.1f} |".format(*rows[-1]), flush=True)
    table = np.array(rows)
    design = np.column_stack([np.ones(len(rows)), table[:, 0], table[:, 1] / 1e5])
    for name, column in (("CPU s", 2), ("peak memory, MB", 3), ("disk, MB", 4)):
        fixed, frame, point = np.linalg.lstsq(design, table[:, column], rcond=None)[0]
        print(f"{name}: {fixed:.2f} + {frame:.3f} a frame + {point:.2f} per 100,000 points")


def workers(folder: Path, rounds: int) -> None:
    """The same scenes on one and two workers in turn: wall-clock and CPU seconds, without the workers' start."""
    rooms = [write_room(folder / f"room{seed}", seed, 8, 50_000) for seed in range(8)]
    with open_engine("loky:1") as one, open_engine("loky:2") as two:
        for engine in (one, two):
            list(engine.run(lambda _, number: __import__("torchjoint").__version__ and number, range(2), None))
        for round_ in range(rounds):
            seconds, cpu = [], []
            for engine in (one, two):
                job = Job(folder / f"out-{round_}-{engine.name}", tj.Config(), RecordingOptions(), overwrite=True)
                start = time.perf_counter()
                outcomes = list(engine.run(cpu_seconds, [(room.name, room) for room in rooms], job))
                seconds.append(time.perf_counter() - start)
                assert all(outcome.error is None for outcome in outcomes)
                cpu.append(sum(outcome.value for outcome in outcomes))
            one_worker, two_workers = seconds
            print(
                f"1 worker: {one_worker:.1f} s, {cpu[0]:.1f} CPU s; "
                f"2 workers: {two_workers:.1f} s, {cpu[1]:.1f} CPU s; "
                f"{one_worker / two_workers:.2f} times as fast",
                flush=True,
            )


def cpu_seconds(job: Job, scene: tuple[str, Path]) -> float:
    """What a recording costs its worker."""
    start = time.process_time()
    run_scene(job, scene)
    return time.process_time() - start


def engine(name: str, tasks: int) -> None:
    """What an engine adds to each task, in the head: CPU milliseconds for a task that does nothing."""
    with open_engine(name) as opened:
        list(opened.run(nothing, range(10), None))
        cpu, start = time.process_time(), time.perf_counter()
        for outcome in opened.run(nothing, range(tasks), None):
            assert outcome.error is None
        cpu, wall = time.process_time() - cpu, time.perf_counter() - start
    print(f"{name}: {cpu / tasks * 1e3:.2f} CPU ms a task in the head; {tasks / wall:.0f} tasks a second")


def nothing(shared: None, task: int) -> int:
    return task


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("scenes", "workers", "engine"))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--engine", default="loky:2")
    parser.add_argument("--tasks", type=int, default=1000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        if arguments.what == "scenes":
            scenes(Path(temporary))
        elif arguments.what == "workers":
            workers(Path(temporary), arguments.rounds)
        else:
            engine(arguments.engine, arguments.tasks)


if __name__ == "__main__":
    main()
