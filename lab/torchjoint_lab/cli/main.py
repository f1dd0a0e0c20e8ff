"""The entry point of the lab's command line; lists its commands."""

from __future__ import annotations

from torchjoint.cli.main import Command, run

COMMANDS = {
    "evaluate": Command("torchjoint_lab.cli.evaluate:evaluate", "scores results against ground truth"),
    "benchmark": Command("torchjoint_lab.cli.benchmark:benchmark", "compares methods on labelled scenes"),
    "robustness": Command(
        "torchjoint_lab.cli.robustness:robustness", "measures how much results change with noise, light and poses"
    ),
    "real": Command("torchjoint_lab.cli.real:real", "scores the default on real recordings"),
    "scannet200": Command(
        "torchjoint_lab.cli.scannet200:scannet200", "segments and scores ScanNet, with masks of others"
    ),
    "train-forest": Command("torchjoint_lab.cli.train_forest:train_forest", "trains the boundary detector of images"),
    "train-boundary-model": Command(
        "torchjoint_lab.cli.train_boundary_model:train_boundary_model", "trains the model of step 6, method learned"
    ),
    "train-scan-model": Command(
        "torchjoint_lab.cli.train_scan_model:train_scan_model", "trains the model of step 6, method scan"
    ),
    "evaluate-boundaries": Command(
        "torchjoint_lab.cli.evaluate_boundaries:evaluate_boundaries", "scores boundaries of images on BSDS500"
    ),
    "paper-tables": Command("torchjoint_lab.cli.paper_tables:paper_tables", "scores results as the paper's tables do"),
}

INTERRUPTED = (
    "`benchmark --tuning`, `real`, `robustness`, `train-forest` and `train-boundary-model` resume when they are "
    "started again"
)


def main() -> None:
    """Entry point."""
    run("torchjoint-lab", COMMANDS, "Research on torchjoint: training, benchmarks, other methods.", INTERRUPTED)
