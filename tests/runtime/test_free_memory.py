"""Memory that the allocator keeps goes back to the system when it is asked for."""

from __future__ import annotations

import ctypes
import subprocess
import sys

import pytest

from torchjoint.runtime.memory import give_back

# 300 MB in blocks that the allocator keeps, because later ones are still in use.
PROGRAM = """
import re
from pathlib import Path
import torch
from torchjoint.runtime.memory import give_back

def resident():
    return int(re.search(r"VmRSS:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1]) / 1e3

blocks = [torch.ones(10_000) for _ in range(15_000)]
kept = blocks[::2]
last = torch.ones(10_000)
blocks.clear()
full = resident()
give_back()
print(full - resident(), sum(float(one.sum()) for one in kept))
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="the C library is not glibc")
def test_free_blocks_go_back_and_used_ones_stay() -> None:
    output = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True).stdout
    megabytes, total = map(float, output.split())
    assert megabytes > 150
    assert total == 7_500 * 10_000


def test_nothing_happens_where_the_system_cannot(monkeypatch) -> None:
    asked = []
    monkeypatch.setattr(ctypes, "CDLL", lambda name: asked.append(name) or object())
    give_back()
    assert asked == ["libc.so.6"]
