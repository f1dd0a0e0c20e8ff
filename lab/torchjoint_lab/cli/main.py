"""The entry point of the lab's command line; lists its commands."""

from __future__ import annotations

from torchjoint.cli.main import Command, run

COMMANDS = {
    "evaluate": Command("scores results against ground truth", "result my_recording"),
    "benchmark": Command("compares methods on labelled scenes", "table"),
    "robustness": Command("measures how much results change with noise, light and poses", "--kinds table kitchen"),
    "real": Command("scores the default on real recordings", "--data data --sets ycb mosd"),
    "scannet200": Command("segments and scores ScanNet, with masks of others", "scans --masks masks -o scannet200"),
    "train-forest": Command("trains the boundary detector of images", "BSDS500 -o mine.yml.gz"),
    "train-boundary-model": Command("trains the model of step 6, method learned", "my_scenes -o mine.npz"),
    "train-scan-model": Command("trains the model of step 6, method scan", "--data data -o scan"),
    "evaluate-boundaries": Command("scores boundaries of images on BSDS500", "structured_forest BSDS500"),
    "paper-tables": Command("scores results as the paper's tables do", "scans -o tables"),
}

INTERRUPTED = (
    "`benchmark --tuning`, `real`, `robustness`, `train-forest` and `train-boundary-model` resume when they are "
    "started again"
)


DESCRIPTION = """\
Example: torchjoint-lab evaluate result my_recording

Research on torchjoint: training, benchmarks, other methods."""


def main() -> None:
    """Entry point."""
    run("torchjoint-lab", COMMANDS, DESCRIPTION, INTERRUPTED)
