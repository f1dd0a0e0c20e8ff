"""Files with a checksum, which detects damage: a number with a flipped bit still looks like a number."""

from __future__ import annotations

import hashlib
from pathlib import Path

from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import open_file, read_file

_MARK = b"torchjoint checked file 1\n"


def write_checked(path: Path, content: bytes) -> None:
    """Writes a file and the checksum of its content, atomically."""
    with atomic_write(path) as partial:
        partial.write_bytes(_MARK + hashlib.sha256(content).hexdigest().encode() + b"\n" + content)


def read_checked(path: Path) -> bytes:
    """Reads what :func:`write_checked` wrote.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file cannot be read, has another version, or is damaged; the message names the file.
    """
    data = read_file(path, "a checked file of torchjoint")
    if not data.startswith(_MARK):
        raise ValueError(f"{path}: expected a file of this version of torchjoint, got another, or a damaged one")
    checksum, _, content = data[len(_MARK) :].partition(b"\n")
    if checksum != hashlib.sha256(content).hexdigest().encode():
        raise ValueError(f"{path}: damaged: its checksum does not match its content")
    return content


def file_checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with open_file(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
