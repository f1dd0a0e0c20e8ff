"""Memory: how much there is, how much a process takes, and giving it back."""

import ctypes
import re
from contextlib import suppress
from pathlib import Path


def give_back() -> None:
    """Returns free memory that the allocator keeps to the system.

    The allocator of glibc keeps freed blocks of up to 32 MB for each thread. On other systems this does nothing.
    """
    with suppress(OSError, AttributeError):  # only glibc has it
        ctypes.CDLL("libc.so.6").malloc_trim(0)


_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def reset_peak_memory() -> None:
    """Starts a new measurement, if the system supports it (Linux)."""
    with suppress(OSError):
        _RESET.write_text("5")


def peak_memory() -> float | None:
    """Largest memory use since :func:`reset_peak_memory`, megabytes (10^6 bytes); None if the system does not tell."""
    with suppress(OSError):
        if found := re.search(r"VmHWM:\s*(\d+) kB", _STATUS.read_text()):
            return int(found[1]) * 1024 / 1e6
    return None


#: Default limit, as a share of the memory.
SHARE_OF_MEMORY = 0.25

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}
_SIZE = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*([kmgt]i?)?b?\s*", re.IGNORECASE)


def as_bytes(memory: int | str | None, name: str = "memory") -> int:
    """Converts a size to bytes: "2GB" (10^9), "500 MiB" (2^20) or a number; None: SHARE_OF_MEMORY of the memory.

    Example:
        >>> as_bytes("2GB"), as_bytes("1.5 KiB"), as_bytes(0)
        (2000000000, 1536, 0)
    """
    if memory is None:
        return int(SHARE_OF_MEMORY * available_memory())
    match = _SIZE.fullmatch(memory) if isinstance(memory, str) else None
    if match is not None:
        return int(float(match[1]) * _UNITS[(match[2] or "").lower()])
    if isinstance(memory, int) and not isinstance(memory, bool) and memory >= 0:
        return memory
    raise ValueError(f"{name}: expected a size such as '2GB' or '500MB', or bytes >= 0, got {memory!r}")


def available_memory(root: Path = Path("/")) -> int:
    """The memory of this machine in bytes, or the limit of the container (control group) that the process runs in.

    Args:
        root: the folder that contains proc/ and sys/.
    """
    import psutil

    limits = [psutil.virtual_memory().total]
    own = root / "proc/self/cgroup"
    lines = own.read_text(encoding="utf-8", errors="replace").splitlines() if own.is_file() else []
    for line in lines:
        _, controllers, group = line.split(":", 2)
        if controllers == "":
            limits += _limits(root / "sys/fs/cgroup", group, "memory.max")
        elif "memory" in controllers.split(","):
            limits += _limits(root / "sys/fs/cgroup/memory", group, "memory.limit_in_bytes")
    return min(limits)


def _limits(base: Path, group: str, name: str) -> list[int]:
    """The limits of a control group and of all groups around it. Inside a container the group's path may not exist."""
    inner = base / group.lstrip("/")
    folders = [folder for folder in (inner, *inner.parents) if folder == base or base in folder.parents]
    texts = [(folder / name).read_text(encoding="ascii").strip() for folder in folders if (folder / name).is_file()]
    return [int(text) for text in texts if text.isdecimal()]  # "max" is no limit
