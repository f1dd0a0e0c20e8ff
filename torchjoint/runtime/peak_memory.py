"""The most memory that this process has used since a moment."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def reset_peak_memory() -> None:
    """Begins to measure anew, where the system can (Linux)."""
    with suppress(OSError):
        _RESET.write_text("5")


def peak_memory() -> float | None:
    """Most memory since :func:`reset_peak_memory`, megabytes (10^6 bytes); None if the system does not tell."""
    try:
        found = re.search(r"VmHWM:\s*(\d+) kB", _STATUS.read_text())
    except OSError:
        return None
    return None if found is None else int(found[1]) * 1024 / 1e6
