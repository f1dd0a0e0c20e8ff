"""Files with a checksum, which detects damage: a number with a flipped bit still looks like a number."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchjoint.runtime import bounds
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import damage_is, open_file, read_file

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


def write_values(path: Path, values: Mapping[str, Any]) -> None:
    """Writes a dict of tensors, numbers and texts, atomically."""
    content = io.BytesIO()
    torch.save(values, content)
    write_checked(path, content.getvalue())


def read_values(path: Path) -> dict[str, Any]:
    """Reads what :func:`write_values` wrote. No code in it is run, and no tensor is larger than its file.

    Raises:
        FileNotFoundError, ValueError: as :func:`read_checked`; also if the content is another one.
    """
    content = read_checked(path)
    with damage_is(f"{path}: not a saved state", Exception):  # torch raises errors of many types
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            stored = sum(entry.file_size for entry in archive.infolist())
        bounds.check(stored, len(content), "bytes, for torch packs nothing,")
        values = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        if not isinstance(values, dict):
            raise TypeError(f"expected a dict, got {type(values).__name__}")
        # A tensor may show the same bytes many times; three times is a grey image.
        size = sum(tensor.numel() * tensor.element_size() for tensor in _tensors(values))
        bounds.check(size, 4 * len(content), "bytes of tensors")
    return values


def _tensors(values: object) -> Iterator[Tensor]:
    if isinstance(values, Tensor):
        if values.layout != torch.strided or values.is_quantized:
            raise TypeError(f"expected plain tensors, got {values.layout}")
        yield values
    elif isinstance(values, (Mapping, Sequence)) and not isinstance(values, (str, bytes)):
        for one in values.values() if isinstance(values, Mapping) else values:
            yield from _tensors(one)


def file_checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with open_file(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
