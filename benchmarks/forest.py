"""The structured forest against OpenCV's, on photographs: `python benchmarks/forest.py`.

Times are processor time, as medians; calls of the compared functions alternate, on the same image and with as many
threads. lab/studies/strides.py measures how good the boundaries are with each stride.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from importlib.resources import as_file, files

import cv2
import numpy as np
import report
import torch
from instances import photograph

from torchjoint.images.contours import suppress_non_maxima
from torchjoint.images.forest import read_forest
from torchjoint.ops.internal import structured_forest

#: OpenCV resamples odd sides, ours are mirrored: compare the answers on even ones.
SIZES = {"320x320": (320, 320), "640x480": (480, 640)}
MODEL = files("torchjoint.models") / "bsds500.yml.gz"


def processor_times(functions: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median milliseconds of processor time of each function, over all threads; one call of each in turn."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for function in functions.values():  # the first call includes one-time setup
        function()
    for _ in range(rounds):
        for name, function in functions.items():
            before = time.process_time()
            function()
            times[name].append(time.process_time() - before)
    return {name: statistics.median(taken) * 1e3 for name, taken in times.items()}


def measure(image: torch.Tensor, rounds: int) -> tuple[dict[str, float], float]:
    """Times by function, and the share of pixels in which the two detectors differ by more than 1e-6."""
    with as_file(MODEL) as path:
        detector, forest = cv2.ximgproc.createStructuredEdgeDetection(str(path)), read_forest(path)
    trees = (
        *map(torch.from_numpy, (forest.children, forest.features, forest.thresholds)),
        *map(torch.from_numpy, (forest.boundary_counts, forest.boundary_pixels)),
        forest.trees_per_site,
    )
    pixels = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
    edges = detector.detectEdges(pixels)
    differ = float((np.abs(structured_forest(image[None], *trees)[0].numpy() - edges) > 1e-6).mean())
    strength = torch.from_numpy(edges)
    times = processor_times(
        {
            "detectEdges": lambda: detector.detectEdges(pixels),
            "ours": lambda: structured_forest(image[None], *trees),
            "stride 4": lambda: structured_forest(image[None], *trees, stride=4),
            "OpenCV's nms": lambda: detector.edgesNms(edges, detector.computeOrientation(edges)),
            "our nms": lambda: suppress_non_maxima(strength),
        },
        rounds,
    )
    return times, differ


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    cv2.setNumThreads(arguments.threads)
    rows = []
    for name, size in SIZES.items():
        times, differ = measure(photograph(*size).contiguous(), arguments.rounds)
        edges, nms = times["detectEdges"], times["OpenCV's nms"]
        forests = [value for ours in ("ours", "stride 4") for value in (times[ours], times[ours] / edges)]
        rows.append([name, edges, *forests, 100 * differ, nms, times["our nms"], times["our nms"] / nms])
    columns = {"image": 0, "detectEdges, ms": 1, "ours, ms": 1, "ours / detectEdges": 2, "stride 4, ms": 1}
    columns |= {"stride 4 / detectEdges": 2, "pixels that differ, %": 2}
    columns |= {"OpenCV's orientation and nms, ms": 1, "our nms, ms": 1, "our nms / OpenCV's": 2}
    report.save("forest", [report.Table(columns, rows)])


if __name__ == "__main__":
    main()
