#!/usr/bin/env python3
"""How light the package is: prints each figure beside its limit. Too many modules or lines is an error.

Times depend on the machine, so they are the best of five runs, and only printed. Usage: python .ci/figures.py
"""

import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
IMPORT = """
import sys, time, torch
start = time.perf_counter()
import torchjoint
print(time.perf_counter() - start, *sys.modules)
"""
FOREIGN = {"kornia", "matplotlib", "scipy"}


def imported() -> tuple[float, list[str]]:
    """Seconds of `import torchjoint` after `import torch`, and the modules that are loaded then."""
    seconds, *modules = subprocess.run(
        [sys.executable, "-c", IMPORT], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    return float(seconds), modules


def help_seconds() -> float:
    """Seconds of `torchjoint --help`."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "torchjoint", "--help"], cwd=ROOT, capture_output=True, check=True)
    return time.perf_counter() - start


def main() -> None:
    """Print the figures; fail if a count is over its limit."""
    runs = [imported() for _ in range(5)]
    packages = [name.split(".")[0] for name in runs[0][1]]
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in ROOT.glob("torchjoint/**/*.py"))
    counts = [
        ("own modules after `import torchjoint`", packages.count("torchjoint"), 150),
        ("modules of kornia, matplotlib, SciPy", sum(name in FOREIGN for name in packages), 0),
        ("lines of Python in torchjoint/", lines, 31_000),
    ]
    times = [
        ("seconds of `import torchjoint` after torch", min(seconds for seconds, _ in runs), 0.15),
        ("seconds of `torchjoint --help`", min(help_seconds() for _ in range(5)), 1.0),
    ]
    for name, figure, limit in [*counts, *times]:
        print(f"{name:<43} {figure:>9.6g}  at most {limit:g}{'  OVER' if figure > limit else ''}")
    sys.exit(any(figure > limit for _, figure, limit in counts))


if __name__ == "__main__":
    main()
