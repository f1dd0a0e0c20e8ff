"""A temporary file for what does not fit into memory.

The file has no name in its folder: the system frees its room when the process ends, however it ends, and nobody can
delete it before.
"""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Sequence
from pathlib import Path
from threading import Lock


class Span:
    """Some bytes of a :class:`SpillFile`, which lives as long as they do. Pickled, they are plain bytes."""

    def __init__(self, file: SpillFile, start: int, size: int) -> None:
        self._file, self._start, self._size = file, start, size

    def read(self) -> bytes:
        """The bytes.

        Raises:
            OSError: the disk has failed.
        """
        return self._file.read(self._start, self._size)

    def __reduce__(self) -> tuple[type[bytes], tuple[bytes]]:
        return bytes, (self.read(),)


class SpillFile:
    """Keeps bytes on disk until the last of their spans is gone. Several threads may read.

    Args:
        folder: on the disk that is used; default: the variable TMPDIR, or /var/tmp (/tmp is often memory).

    Raises:
        OSError: no file can be made there; the message names the folder.
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
            OSError: the disk is full, for example; what was written before stays readable.
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
            f"memory: what is beyond it goes to a temporary file, which cannot be written ({error.strerror}); make "
            "room, give another folder (spill=, or the variable TMPDIR), or more memory (memory=)",
            str(self.folder),
        )


def _default_folder() -> Path:
    chosen = Path("/var/tmp")
    if os.environ.get("TMPDIR") or not os.access(chosen, os.W_OK | os.X_OK):
        return Path(tempfile.gettempdir())
    return chosen
