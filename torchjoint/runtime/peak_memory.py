"""Measures the largest memory use of this process over some time."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def reset_peak_memory() -> None:
    """Starts a new measurement, if the system supports it (Linux)."""
    with suppress(OSError):
        _RESET.write_text("5")


def peak_memory() -> float | None:
    """Largest memory use since :func:`reset_peak_memory`, megabytes (10^6 bytes); None if the system does not tell."""
    try:
        found = re.search(r"VmHWM:\s*(\d+) kB", _STATUS.read_text())
    except OSError:
        return None
    return None if found is None else int(found[1]) * 1024 / 1e6
