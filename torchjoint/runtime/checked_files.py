"""Files with a checksum, which detects damage: a number with a flipped bit still looks like a number."""

from __future__ import annotations

import hashlib
import io
import pickletools
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchjoint.runtime import bounds
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import damage_is, open_file, read_file

_MARK = b"torchjoint checked file 1\n"
#: What the pickle of a state may name.
_CALLED = re.compile(
    r"torch\._utils _rebuild_tensor_v[23]|torch(\.storage)? \w+Storage|torch [a-z]+[0-9]*|collections OrderedDict"
)


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
    """Reads what :func:`write_values` wrote. No code in it is run, and it is not larger than its file.

    Raises:
        FileNotFoundError, ValueError: as :func:`read_checked`; also if the content is another one.
    """
    content = read_checked(path)
    with damage_is(f"{path}: not a saved state", Exception):  # torch raises errors of many types
        _check_pickle(content)
        values = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        if not isinstance(values, dict):
            raise TypeError(f"expected a dict, got {type(values).__name__}")
        _check_size(values, len(content))
    return values


def _check_pickle(content: bytes) -> None:
    """Checks that nothing is packed, and that the pickle calls for tensors only: torch also makes large bytearrays."""
    if not content.startswith(b"PK"):  # torch would read an older format
        raise ValueError("expected an archive")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        stored = sum(entry.file_size for entry in archive.infolist())
        bounds.check(stored, len(content), "bytes, for torch packs nothing,")
        for entry in archive.infolist():
            for code, argument, _ in pickletools.genops(archive.read(entry)) if entry.filename.endswith(".pkl") else ():
                if code.name in ("STACK_GLOBAL", "INST") or (
                    code.name == "GLOBAL" and not _CALLED.fullmatch(str(argument))
                ):
                    raise ValueError(f"expected tensors, numbers and texts, got {argument or code.name}")


def _check_size(values: dict[str, Any], most: int) -> None:
    """Checks how large values are together: a list or a tensor may hold the same bytes many times."""
    left: list[Any] = [values]
    count = size = 0
    while left:
        one, count = left.pop(), count + 1
        bounds.check(count, most, "values")
        if isinstance(one, Tensor):
            if one.layout != torch.strided or one.is_quantized:
                raise TypeError(f"expected plain tensors, got {one.layout}")
            size += one.numel() * one.element_size()
            bounds.check(size, 4 * most, "bytes of tensors")  # three times is a grey image
        elif isinstance(one, dict):
            left += one.values()
        elif isinstance(one, (list, tuple)):
            left += one


def file_checksum(path: Path) -> str:
    """SHA-256 of a file."""
    with open_file(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
