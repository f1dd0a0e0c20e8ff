"""The entry point of the lab's command line; lists its commands."""

from __future__ import annotations

from torchjoint.cli.main import Command, run

COMMANDS = {
    "evaluate": Command("scores results against ground truth"),
    "benchmark": Command("compares methods on labelled scenes"),
    "robustness": Command("measures how much results change with noise, light and poses"),
    "real": Command("scores the default on real recordings"),
    "scannet200": Command("segments and scores ScanNet, with masks of others"),
    "train-forest": Command("trains the boundary detector of images"),
    "train-boundary-model": Command("trains the model of step 6, method learned"),
    "train-scan-model": Command("trains the model of step 6, method scan"),
    "evaluate-boundaries": Command("scores boundaries of images on BSDS500"),
    "paper-tables": Command("scores results as the paper's tables do"),
}

INTERRUPTED = (
    "`benchmark --tuning`, `real`, `robustness`, `train-forest` and `train-boundary-model` resume when they are "
    "started again"
)


def main() -> None:
    """Entry point."""
    run("torchjoint-lab", COMMANDS, "Research on torchjoint: training, benchmarks, other methods.", INTERRUPTED)
