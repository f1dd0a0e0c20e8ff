"""A temporary file for data that does not fit into memory.

The file has no name in its folder. So the system frees its space when the process ends, also when it is killed, and
nobody can delete it before.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import weakref
from collections.abc import Sequence
from pathlib import Path
from threading import Lock

#: Bytes of zeros that are written at once.
ZEROS = 1 << 20


class Span:
    """A range of bytes in a :class:`SpillFile`, which exists as long as its spans. Pickling makes it plain bytes."""

    def __init__(self, file: SpillFile, start: int, size: int) -> None:
        self._file, self._start, self._size = file, start, size

    def read(self) -> bytes:
        """The bytes.

        Raises:
            OSError: the disk failed.
        """
        return self._file.read(self._start, self._size)

    def __reduce__(self) -> tuple[type[bytes], tuple[bytes]]:
        return bytes, (self.read(),)


class SpillFile:
    """Keeps bytes on disk until their last span is deleted. Several threads may read.

    Args:
        folder: a folder on the disk to use; default: the variable TMPDIR, or /var/tmp (/tmp is often in memory).

    Raises:
        OSError: no file can be created there; the message names the folder.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = _default_folder() if folder is None else folder
        try:
            self._file = tempfile.TemporaryFile(dir=self.folder, buffering=0)  # noqa: SIM115 (it is closed below)
        except OSError as error:
            raise self._error(error) from error
        weakref.finalize(self, self._file.close)  # with the last span
        self._end = 0
        self._lock = Lock()

    def write(self, parts: Sequence[bytes]) -> list[Span]:
        """Writes all parts, or none.

        Raises:
            OSError: for example if the disk is full; earlier data stay readable.
        """
        with self._lock:
            start, spans = self._end, []
            try:
                for part in parts:
                    self._write(part, start)
                    spans.append(Span(self, start, len(part)))
                    start += len(part)
            except OSError as error:
                os.ftruncate(self._file.fileno(), self._end)
                raise self._error(error) from error
            self._end = start
        return spans

    def mapped(self, size: int) -> mmap.mmap:
        """The first `size` bytes of the file as memory, whose pages the system may drop; bytes beyond its end are 0.

        Raises:
            OSError: for example if the disk is full.
        """
        # Written, because a full disk would otherwise end the process where the memory is used first.
        full, rest = divmod(max(0, size - self._end), ZEROS)
        self.write([bytes(ZEROS)] * full + [bytes(rest)])
        return mmap.mmap(self._file.fileno(), size)

    def _write(self, part: bytes, start: int) -> None:
        rest = memoryview(part)
        while rest:
            written = os.pwrite(self._file.fileno(), rest, start)
            rest, start = rest[written:], start + written

    def read(self, start: int, size: int) -> bytes:
        """Bytes that were written."""
        parts = []
        while size > 0:
            part = os.pread(self._file.fileno(), size, start)
            if not part:
                raise OSError(f"memory: the temporary file in {self.folder} has become shorter")
            parts.append(part)
            start, size = start + len(part), size - len(part)
        return b"".join(parts)

    def _error(self, error: OSError) -> OSError:
        return OSError(
            error.errno,
            f"memory: data beyond this limit go to a temporary file, which cannot be written ({error.strerror}); free "
            "disk space, or give another folder (spill=, or the variable TMPDIR) or more memory (memory=)",
            str(self.folder),
        )


def _default_folder() -> Path:
    chosen = Path("/var/tmp")
    if os.environ.get("TMPDIR") or not os.access(chosen, os.W_OK | os.X_OK):
        return Path(tempfile.gettempdir())
    return chosen
