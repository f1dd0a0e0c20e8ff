"""What a user reads: messages, missing extras, and seconds."""

import errno
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Lock

#: Parts of the messages of torch, and of the system's loader of libraries.
_OUT_OF_MEMORY = ("not enough memory", "can't allocate memory", "bad_alloc", "failed to map segment")
#: What controls a terminal, not tab and line breaks, and the number that stands for it; and what turns the direction of
#: writing or goes back to the start of the line.
_CONTROLS = {code: f"\\x{code:02x}" for code in (*range(9), 11, 12, *range(14, 32), *range(127, 160))}
_TURNS = {code: f"\\u{code:04x}" for code in (13, 1564, 8206, 8207, *range(8232, 8239), *range(8294, 8298))}
#: Is called with each share of step 6 that is done, for a bar; a method need not call it.
advance: ContextVar[Callable[[float], object]] = ContextVar("torchjoint_advance", default=lambda share: None)


def is_out_of_memory(error: BaseException) -> bool:
    """Whether Python or torch had too little memory."""
    return isinstance(error, MemoryError) or any(part in str(error) for part in _OUT_OF_MEMORY)


def printable(name: str) -> str:
    """A name as text for files and pages: controls, and half characters, which have no encoding, as their numbers."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8").translate(_CONTROLS)


def on_terminal(text: str) -> str:
    """Text with names of others for a terminal: characters that control it are shown as their numbers."""
    return printable(text).translate(_TURNS)


def counted(number: int, thing: str) -> str:
    """A number of things.

    >>> counted(1, "frame"), counted(2, "frame")
    ('1 frame', '2 frames')
    """
    return f"{number} {thing}{'s' * (number != 1)}"


def say(text: object, *, flush: bool = False) -> None:
    """Prints text with names of others."""
    print(on_terminal(str(text)), flush=flush)


def in_one_line(error: BaseException) -> str:
    """Describes an error in one line, and how to solve it if this is known."""
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"the disk is full{f' ({error.filename})' if error.filename else ''}; make room and start again"
    if is_out_of_memory(error):
        return "out of memory; --thin, --max-frames and --voxel-size reduce the data"
    if isinstance(error, RecursionError):
        return f"nested too deeply: {error}"
    # The system's words are "[Errno 13] Permission denied: 'cloud.ply'".
    return on_terminal(re.sub(r"^\[Errno \d+\] (.+): '([^']+)'$", r"\2: \1", " ".join(str(error).split())))


@contextmanager
def needed_for(purpose: str, package: str, requirement: str) -> Iterator[None]:
    """Wraps the import of a package that may be missing.

    Args:
        purpose: what needs the package; the message begins with it.
        package: name of the package, such as "Open3D".
        requirement: the argument of `pip install`, such as "torchjoint[open3d]".
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"{purpose} needs {package}: pip install '{requirement}'") from error
    except (ImportError, OSError) as error:
        raise ModuleNotFoundError(f"{purpose} needs {package}: installed, but does not load: {error}") from error


class Stopwatch:
    """Sums wall-clock seconds by name; the times of parallel threads are added.

    >>> watch = Stopwatch()
    >>> with watch("step"):
    ...     pass
    >>> list(watch.seconds)
    ['step']
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._lock = Lock()

    def __getstate__(self) -> dict[str, dict[str, float]]:
        return {"seconds": dict(self.seconds)}

    def __setstate__(self, state: dict[str, dict[str, float]]) -> None:
        self.seconds, self._lock = state["seconds"], Lock()

    def add(self, seconds: Mapping[str, float]) -> None:
        """Adds the seconds by name of another stopwatch."""
        with self._lock:
            for name, value in seconds.items():
                self.seconds[name] = self.seconds.get(name, 0.0) + value

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Adds the duration of the block, in seconds, to the sum of `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add({name: time.perf_counter() - start})
