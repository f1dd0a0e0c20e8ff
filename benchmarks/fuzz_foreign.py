"""Foreign files for benchmarks/fuzz.py: what stands in the place of a file is no file, of another format, or a bomb.

In the place of any file of any sample: a dead link, a pipe, a device, a link to itself (tests/traps.py), EPS, which
Pillow would give to Ghostscript, or a bomb of another format (tests/bombs.py). A clear error must come, or what the
intact sample has; it must come soon, in little memory, and no program may be started.
"""

from __future__ import annotations

import resource
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fuzz_files import CLEAR, FindingError, make_samples

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

#: What starts a program.
PROGRAMS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.forkpty")
#: Bytes that a case may take beyond those that were taken before.
MEMORY = 4 << 30
SECONDS = 120


def watch(event: str, _: Any) -> None:
    if event in PROGRAMS:
        raise FindingError(f"a program is started: {event}")


class Foreign:
    """The samples, in whose files cases put something else."""

    def __init__(self, folder: Path) -> None:
        self.samples = make_samples(folder)
        sys.addaudithook(watch)


def foreign_case(index: int, seed: int, made: Foreign) -> str:
    """One case; its outcome in a few words.

    Raises:
        FindingError: what should not be.
    """
    import bombs
    import traps

    rng = np.random.default_rng([seed, index, 4])
    sample = made.samples[int(rng.integers(len(made.samples)))]
    file = sorted(sample.files)[int(rng.integers(len(sample.files)))]
    kinds = (*traps.TRAPS, "EPS", "bomb")
    kind = kinds[int(rng.integers(len(kinds)))]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        with traps.ends(SECONDS), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if kind in traps.TRAPS:
                with traps.trapped(file, kind):
                    outcome = _outcome(sample, f"{kind} for {file.name}")
            else:
                bomb = list(bombs.BOMBS.values())[int(rng.integers(len(bombs.BOMBS)))]
                file.write_bytes(bombs.EPS if kind == "EPS" else bomb.content)
                outcome = _outcome(sample, f"{kind} for {file.name}")
    finally:
        sample.restore()
    if (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) << 10 > MEMORY:
        raise FindingError(f"{sample.name}: {kind} for {file.name} took more than {MEMORY >> 30} GB")
    return f"foreign, {kind}: {outcome}"


def _outcome(sample: Any, what: str) -> str:
    try:
        content = sample.read()
    except CLEAR:
        return "clear error"
    same = content.keys() == sample.intact.keys() and all(
        torch.equal(content[name].nan_to_num(), sample.intact[name].nan_to_num()) for name in content
    )
    if not same:
        raise FindingError(f"{sample.name}: {what} passes with other values")
    return "values of the intact sample"
