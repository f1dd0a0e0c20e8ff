"""Boundaries of the package's forest at each second and at each fourth pixel: `python lab/studies/strides.py BSDS_DIR`.

The forest has seen these images, so only the difference between the strides counts.
"""

import argparse
from pathlib import Path

import report
from torchjoint_lab.datasets.bsds import bsds_images
from torchjoint_lab.evaluation.boundary_scores import evaluate_boundaries

from torchjoint.images.forest import StructuredForestBoundary

THRESHOLDS = 19


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bsds", type=Path)
    parser.add_argument("--images", type=int, default=100, help="of val, evenly spread")
    report.add_write(parser)
    arguments = parser.parse_args()
    val = bsds_images(arguments.bsds, "val")
    val = val[:: max(1, len(val) // arguments.images)]
    rows = []
    for stride in (2, 4):
        score = evaluate_boundaries(StructuredForestBoundary(stride=stride), val, THRESHOLDS, progress=True)
        rows.append([str(stride), *(f"{value:.4f}" for value in (score.ods, score.ois, score.ap))])
    text = f"{report.table(['stride', 'ODS', 'OIS', 'AP'], rows)}\n\n{len(val)} images of val."
    report.show("strides", text, arguments.write)


if __name__ == "__main__":
    main()
