"""Times method scan on LiDAR sweeps: `python benchmarks/lidar.py DATA [--travel PYTHON]`.

DATA has semantickitti/*.bin, vod/cloud.ply and argo/cloud.ply, or some of them. Given are the medians of whole runs,
from the points to their labels without images, by the clock and of the processors, and the memory they add. PYTHON
is the interpreter of an environment with `pip install travel-seg`, which is run as a program; without it, or where it
is absent, TRAVEL has no row.
"""

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import report
from torch import Tensor

import torchjoint as tj

#: What TRAVEL's interpreter runs: a file of points, the number of runs. Its log goes to stdout, so times to stderr.
TRAVEL = """
import sys, time
import numpy as np
import travel_seg
points = np.load(sys.argv[1])
for _ in range(int(sys.argv[2]) + 1):
    wall, work = time.perf_counter(), time.process_time()
    travel_seg.segment(points)
    print("seconds", time.perf_counter() - wall, time.process_time() - work, file=sys.stderr)
"""


def sweeps(data: Path) -> dict[str, Tensor]:
    """The points of the sweeps that there are."""
    files = [*sorted((data / "semantickitti").glob("*.bin"))[:1], data / "vod/cloud.ply", data / "argo/cloud.ply"]
    return {file.parent.name: tj.datasets.load_scene(file).points for file in files if file.is_file()}


def ours(points: Tensor, runs: int) -> list[tuple[float, float]]:
    """Seconds by the clock and of the processors of each run, after one that warms up."""
    segmenter = tj.JointSegmenter.from_preset("scan")
    times = []
    for _ in range(runs + 1):
        wall, work = time.perf_counter(), time.process_time()
        segmenter.reset(points)
        segmenter.compute(images=False)
        times.append((time.perf_counter() - wall, time.process_time() - work))
    return times[1:]


def travel(python: Path, points: Tensor, runs: int) -> list[tuple[float, float]]:
    """The same of TRAVEL."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "points.npy"
        np.save(file, np.pad(points.float().numpy(), ((0, 0), (0, 1))))
        done = subprocess.run(
            [str(python), "-c", TRAVEL, str(file), str(runs)], check=True, capture_output=True, text=True
        )
    rows = [line.split()[1:] for line in done.stderr.splitlines() if line.startswith("seconds")]
    return [(float(wall), float(work)) for wall, work in rows[1:]]


def peak() -> float:
    """Largest memory of this process so far, MB."""
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the sweeps")
    parser.add_argument("--travel", type=Path, help="interpreter that has travel-seg")
    parser.add_argument("--runs", type=int, default=7)
    arguments = parser.parse_args()
    found = sweeps(arguments.data)
    if not found:
        parser.error(f"data: expected semantickitti/*.bin, vod/cloud.ply or argo/cloud.ply in {arguments.data}")
    rows: list[list[report.Cell]] = []
    before = peak()
    for name, points in sorted(found.items(), key=lambda item: len(item[1])):
        times = {"ours": ours(points, arguments.runs)}
        memory: dict[str, float] = {"ours": peak() - before}
        if arguments.travel is not None and arguments.travel.is_file():
            times["TRAVEL"] = travel(arguments.travel, points, arguments.runs)
        for method, seconds in times.items():
            wall, work = map(statistics.median, zip(*seconds, strict=True))
            rows.append([f"{name}, {len(points):,} points, {method}", wall, work, memory.get(method)])
    columns = {"sweep": 0, "s": 3, "processor s": 3, "MB added at most": 0}
    about = f"Medians of {arguments.runs}. Memory is that of our process above its memory before the first run."
    report.save("lidar", [report.Table(columns, rows)], about)


if __name__ == "__main__":
    main()
