"""The structured forest against OpenCV's, in one run: `python benchmarks/forest.py BSDS_DIR [FOLDER]`.

FOLDER is a recording in the style of 7-Scenes (optional). Times are processor time, as medians; calls of the compared
functions alternate, on the same image and with as many threads. ODS is measured on val, with the package's forest.
Since it has seen these images, only the difference between the strides counts.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path

import cv2
import numpy as np
import report
import torch
from torchjoint_lab.datasets.bsds import bsds_images
from torchjoint_lab.evaluation.boundary_scores import evaluate_boundaries

import torchjoint as tj
from torchjoint.images.forest import read_forest
from torchjoint.images.non_maximum_suppression import suppress_non_maxima
from torchjoint.images.structured_forest import StructuredForestBoundary
from torchjoint.ops.structured_forest import structured_forest

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
    parser.add_argument("bsds", type=Path)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--cloud", type=Path, help="of the recording, kept here, so that it is fused once")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--images", type=int, default=100, help="of val, for ODS")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    cv2.setNumThreads(arguments.threads)
    val = bsds_images(arguments.bsds, "val")
    # OpenCV resamples odd sides, we mirror them: compare the answers on even ones.
    images = {"320x320 (BSDS500)": val[0].image[:, :320, :320]}
    if arguments.folder is not None:
        frames = tj.load_scene(arguments.folder, cloud=arguments.cloud).frames
        images["640x480 (recording)"] = frames[len(frames) // 2].image
    rows = []
    for name, image in images.items():
        times, differ = measure(image.contiguous(), arguments.rounds)
        reference, nms = times["detectEdges"], times["OpenCV's nms"]
        rows.append([name, f"{reference:.1f}"])
        rows[-1] += [f"{times[ours]:.1f} ({times[ours] / reference:.2f}x)" for ours in ("ours", "stride 4")]
        rows[-1] += [f"{100 * differ:.2f} %", f"{nms:.1f}", f"{times['our nms']:.1f} ({times['our nms'] / nms:.2f}x)"]
    columns = ["image", "detectEdges, ms", "structured_forest, ms", "stride 4, ms", "pixels that differ"]
    text = report.table([*columns, "OpenCV's orientation and nms, ms", "our nms, ms"], rows)
    step = max(1, len(val) // arguments.images)
    scores = [
        [str(stride), *(f"{value:.4f}" for value in (score.ods, score.ois, score.ap))]
        for stride in (2, 4)
        for score in [evaluate_boundaries(StructuredForestBoundary(stride=stride), val[::step], 19, progress=True)]
    ]
    text += f"\n\n{report.table(['stride', 'ODS', 'OIS', 'AP'], scores)}\n\n{len(val[::step])} images of val.\n\n"
    text += f"{report.machine()}."
    print(text)
    report.write_part("forest", text)


if __name__ == "__main__":
    main()
