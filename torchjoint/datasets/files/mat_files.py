"""Reads numeric matrices from MATLAB's .mat files, versions 5 to 7.

SciPy is not used: a damaged file can crash SciPy, or make it unpack a few bytes to gigabytes. Written from "MAT-File
Format" (The MathWorks): an element has a type, a length and data; a matrix is an element that contains elements.
"""

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import damage_is, read_file

_HEADER_BYTES = 128
_ORDERS = {b"IM": "<", b"MI": ">"}
_MATRIX, _COMPRESSED = 14, 15

#: NumPy types by the number of a data type.
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_INT8, _INT32, _UINT32 = 1, 5, 6

#: Numbers of array classes: double, single, and integers of 8 to 64 bits.
_NUMERIC = range(6, 16)
_IS_COMPLEX = 0x0800

#: Upper bound for the bytes of a variable's name and shape.
_START_BYTES = 4096


def read_matrices(path: Path, max_count: int) -> dict[str, npt.NDArray[Any]]:
    """Reads the variables of a file that are matrices [H, W] of real numbers; skips all other variables.

    Args:
        path: the file.
        max_count: largest number of elements of all matrices together.
    """
    data = read_file(path, "a .mat file", bounds.IMAGE_BYTES)
    order = _ORDERS.get(data[126:128])
    if order is None or data.startswith(b"MATLAB 7.3") or data[124:126] not in (b"\x00\x01", b"\x01\x00"):
        raise ValueError(f"{path}: not a .mat file of versions 5 to 7 (save it with -v7)")
    matrices, place = {}, _HEADER_BYTES
    with damage_is(f"{path}: not a whole .mat file"):
        while place < len(data):
            kind, count = struct.unpack_from(f"{order}2I", data, place)
            place += 8
            if count > len(data) - place:
                raise ValueError(f"truncated: {count} bytes are announced at byte {place}")
            packed = data[place : place + count] if kind == _COMPRESSED else None
            body = data[place : place + count] if packed is None else _unpack(packed, _START_BYTES, order)
            place += count
            if kind not in (_MATRIX, _COMPRESSED):
                continue
            name, shape, is_real, start = _read_start(body, order)
            if is_real and len(shape) == 2:
                max_count -= math.prod(shape)
                if max_count < 0:
                    raise ValueError(f"{name} of {shape} numbers: {-max_count} more than expected")
                if packed is not None:
                    body = _unpack(packed, start + 8 + 8 * math.prod(shape), order)
                numbers, _ = _element(body, start, None, order)
                if len(numbers) != math.prod(shape):
                    raise ValueError(f"{name} should have {shape} numbers, has {len(numbers)}")
                matrices[name] = numbers.reshape(shape, order="F").astype(numbers.dtype.newbyteorder("="))
    return matrices


def _unpack(packed: bytes, most: int, order: str) -> bytes:
    """Decompresses at most the first `most` bytes of the matrix in a compressed element."""
    unpacked = zlib.decompressobj().decompress(packed, most + 8)
    if (kind := struct.unpack_from(f"{order}I", unpacked)[0]) != _MATRIX:
        raise ValueError(f"a packed element of type {kind}")
    return unpacked[8:]


def _read_start(body: bytes, order: str) -> tuple[str, tuple[int, ...], bool, int]:
    """A variable's name, shape, whether it holds real numbers (and no text, cells, ...), and their byte offset."""
    flags, place = _element(body, 0, _UINT32, order)
    shape, place = _element(body, place, _INT32, order)
    name, place = _element(body, place, _INT8, order)
    if len(flags) < 1 or (shape < 0).any():
        raise ValueError(f"a variable of shape {shape.tolist()}")
    is_real = int(flags[0]) & 0xFF in _NUMERIC and not int(flags[0]) & _IS_COMPLEX
    return name.tobytes().decode("ascii"), tuple(shape.tolist()), is_real, place


def _element(body: bytes, place: int, expected: int | None, order: str) -> tuple[npt.NDArray[Any], int]:
    """The numbers of an element, and the byte offset of the next element."""
    kind, count = struct.unpack_from(f"{order}2I", body, place)
    start = place + 8
    if kind >> 16:  # small element: up to 4 bytes of data are stored in the header
        kind, count, start = kind & 0xFFFF, kind >> 16, place + 4
    if kind not in _TYPES or expected not in (None, kind) or (start == place + 4 and count > 4):
        raise ValueError(f"an element of type {kind} and {count} bytes")
    if count > len(body) - start:
        raise ValueError(f"truncated: {count} bytes of numbers are announced, {len(body) - start} are there")
    dtype = np.dtype(order + _TYPES[kind])
    numbers = np.frombuffer(body, dtype, count // dtype.itemsize, start)
    return numbers, start + 4 if start == place + 4 else start + -(-count // 8) * 8
