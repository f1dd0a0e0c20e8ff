"""A boundary detector that ends its worker, or its memory, once: `boundary.detector=deadly_boundary:DeadlyBoundary`.

The folder TORCHJOINT_TEST_DEATHS holds a file for each death that is still to come: `kill`, `memory`, `wait`.
A process that imports this writes results with an overview of one inch, as the tests' own process does.
"""

import os
import resource
import signal
import time
from pathlib import Path

import torch
from matplotlib.figure import Figure

from torchjoint.images.boundary import GradientBoundary
from torchjoint.results import folder

folder.overview = lambda scene, result, **_: Figure(figsize=(1, 1))


class DeadlyBoundary(GradientBoundary):
    def forward(self, images):
        deaths = Path(os.environ["TORCHJOINT_TEST_DEATHS"])
        if taken(deaths / "kill"):
            os.kill(os.getpid(), signal.SIGKILL)
        if taken(deaths / "memory"):
            fill_memory()
        while (deaths / "wait").exists():
            time.sleep(0.05)
        return super().forward(images)


def taken(file):
    """Whether the file was there; only one worker takes it."""
    try:
        file.unlink()
    except FileNotFoundError:
        return False
    return True


def fill_memory():
    """Asks for more memory than this process may have."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**27, before[1]))
    try:
        torch.zeros(2**28)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
