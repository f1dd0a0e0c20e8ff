"""torchjoint-lab benchmark masks: compares ways of bringing a network's masks to 3D."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from torchjoint.runtime.files import write_text
from torchjoint_lab.benchmark.masks import TITLES, VIEWS, measure, report, runs
from torchjoint_lab.cli.arguments import check_output

TABLE = "table.md"


def benchmark_masks(
    out: Path,
    half: Literal["checking", "tuning"] = "checking",
    methods: Sequence[str] = (),
    domains: Sequence[str] = tuple(VIEWS),
    scenes: int = 4,
    noise_seeds: int = 4,
    overwrite: bool = False,
) -> str:
    """Does the runs whose results are missing in the folder, writes table.md there, and returns the table.

    Raises:
        ValueError: an unknown method or domain, or a number below 1.
        FileExistsError: `out` is not a folder, or it has a table of no earlier start and `overwrite` is False.
    """
    if unknown := [name for name in methods if name not in TITLES]:
        raise ValueError(f"--methods: expected some of {', '.join(TITLES)}, got {unknown[0]!r}")
    todo = runs(half, scenes, noise_seeds, domains)
    folder = out / "runs"
    table = check_output(out, (TABLE,), overwrite or folder.is_dir())[TABLE]
    folder.mkdir(parents=True, exist_ok=True)
    chosen = [name for name in TITLES if not methods or name in methods]
    text = report(list(measure(todo, chosen, folder)), half)
    with table.written() as path:
        write_text(path, f"{text}\n")
    print(f"\n{text}\n\nwritten to {out}: {TABLE}; runs/ has the scores of each run; the next start reads them")
    return text
