"""Reads PCD files of the Point Cloud Library, version 0.7: ascii, binary and binary_compressed, with any fields.

Format: https://pointclouds.org/documentation/tutorials/pcd_file_format.html. The body of binary_compressed holds the
compressed and the uncompressed size, two uint32, then LZF data: the fields one after the other, each with all points.
VIEWPOINT is the pose of the sensor; it must not be applied to the points.
"""

import io
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from torchjoint.datasets.files.columns import POINTS, Array, CloudFile, cloud_of, plain, typed
from torchjoint.datasets.files.text import parse_integer
from torchjoint.runtime.foreign_files import damage_is, dict_of, open_file, read_file

#: Largest size of a header, bytes; real headers have a few hundred bytes.
MAX_HEADER = 65536

#: Largest number of values per point in one field; feature histograms have some hundreds.
MAX_COUNT = 4096

#: TYPE and SIZE of fields.
_KINDS = ("F4", "F8", "I1", "I2", "I4", "I8", "U1", "U2", "U4", "U8")


@dataclass(frozen=True)
class PcdHeader:
    """The header of a PCD file."""

    fields: Mapping[str, np.dtype[Any]]  #: types [count] by name; a padding field has the name "_" and its index
    width: int  #: points per row, and rows; one row if the cloud is not organised
    height: int
    encoding: str  #: ascii, binary, binary_compressed
    size: int  #: of the header, bytes

    @property
    def num_points(self) -> int:
        """The number of points in the file, including points without coordinates (NaN)."""
        return self.width * self.height


@dataclass(frozen=True)
class Pcd:
    """The cloud of a PCD file; points are in the order of the file."""

    width: int  #: points per row, and rows
    height: int
    #: arrays [N] by name, or [N, count] if a field has several values per point
    fields: Mapping[str, Array] = field(default_factory=dict)

    def cloud(self, name: str) -> CloudFile:
        """Points, NaN where the sensor had no return; colours and normals, if any; warnings begin with `name`."""
        return cloud_of(self.fields, name)


def read_pcd(path: Path) -> Pcd:
    """Reads a PCD file."""
    data = read_file(path, "a point cloud, .pcd")
    header = _parse_header(path, data[:MAX_HEADER])
    body, dtype = memoryview(data)[header.size :], np.dtype(list(header.fields.items()))
    if header.encoding == "ascii":
        fields = _read_ascii(path, bytes(body), header)
    elif header.encoding == "binary":
        _check_length(path, header, dtype.itemsize * header.num_points, body)
        records = np.frombuffer(body, dtype, header.num_points)
        fields = {name: np.ascontiguousarray(records[name]) for name in header.fields}
    else:
        fields = _read_compressed(path, body, header, dtype.itemsize * header.num_points)
    return Pcd(header.width, header.height, {name: one for name, one in fields.items() if not name.startswith("_")})


def read_pcd_header(path: Path) -> PcdHeader:
    """Reads the header only."""
    with open_file(path) as stream:
        return _parse_header(path, stream.read(MAX_HEADER))


def _parse_header(path: Path, start: bytes) -> PcdHeader:
    lines: list[tuple[str, list[str]]] = []
    size = 0
    for line in start.splitlines(keepends=True):
        size += len(line)
        words = line.removeprefix(b"\xef\xbb\xbf").decode("ascii", errors="replace").split()
        if words and not words[0].startswith("#"):
            lines.append((words[0], words[1:]))
        if words[:1] == ["DATA"]:
            break
    entries = dict_of(lines, f"{path}: line")
    with damage_is(f"{path}: not a PCD file, or its header is damaged"):
        names, types, (encoding,) = entries["FIELDS"], entries["TYPE"], entries["DATA"]
        entries = {"COUNT": ["1"] * len(names), "POINTS": []} | entries
        sizes, counts, points, (width,), (height,) = (
            [parse_integer(word, key) for word in entries[key]]
            for key in ("SIZE", "COUNT", "POINTS", "WIDTH", "HEIGHT")
        )
    if encoding not in ("ascii", "binary", "binary_compressed"):
        raise ValueError(f"{path}: expected DATA ascii, binary or binary_compressed, got {encoding!r}")
    if width < 1 or height < 1 or points not in ([], [width * height]):
        raise ValueError(f"{path}: expected POINTS = WIDTH x HEIGHT > 0, got {points}, {width} and {height}")
    return PcdHeader(_field_types(path, names, sizes, types, counts), width, height, encoding, size)


def _field_types(
    path: Path, names: list[str], sizes: list[int], types: list[str], counts: list[int]
) -> dict[str, np.dtype[Any]]:
    if not len(names) == len(sizes) == len(types) == len(counts):
        raise ValueError(f"{path}: FIELDS, SIZE, TYPE and COUNT do not agree in number")
    fields: dict[str, np.dtype[Any]] = {}
    for place, (name, size, kind, count) in enumerate(zip(names, sizes, types, counts, strict=True)):
        name = f"_{place}" if name == "_" else name
        if f"{kind}{size}" not in _KINDS or not 0 < count <= MAX_COUNT or name in fields:
            raise ValueError(f"{path}: field {name!r} of TYPE {kind}, SIZE {size}, COUNT {count} is not known or twice")
        fields[name] = np.dtype((f"<{kind.lower()}{size}", (count,) if count > 1 else ()))
    floats = {plain(name) for name, dtype in fields.items() if not dtype.shape and dtype.kind == "f"}
    if not floats.issuperset(POINTS[0]):
        raise ValueError(f"{path}: expected fields x, y and z of TYPE F, got {' '.join(names)}")
    return fields


def _read_ascii(path: Path, body: bytes, header: PcdHeader) -> dict[str, Array]:
    ends = np.cumsum([np.prod(dtype.shape, dtype=int) for dtype in header.fields.values()])
    columns = ends[-1]
    with damage_is(f"{path}: expected lines of {columns} numbers"):
        values = np.loadtxt(io.BytesIO(body), comments=None, ndmin=2) if body.strip() else np.empty((0, columns))
    if values.shape != (header.num_points, columns):
        expected = f"{header.num_points} points of {columns} numbers"
        raise ValueError(f"{path}: truncated, or too long: expected {expected}, got {len(values)} of {values.shape[1]}")
    parts = zip(header.fields.items(), np.split(values, ends[:-1], axis=1), strict=True)
    return {
        name: typed(part, dtype.base, str(path), f"field {name!r}").reshape(-1, *dtype.shape)
        for (name, dtype), part in parts
    }


def _read_compressed(path: Path, body: memoryview, header: PcdHeader, expected: int) -> dict[str, Array]:
    if len(body) < 8:
        raise ValueError(f"{path}: truncated after the header")
    compressed, uncompressed = struct.unpack("<II", body[:8])
    if uncompressed != expected:
        raise ValueError(f"{path}: expected {expected} bytes of {header.num_points} points, got {uncompressed}")
    _check_length(path, header, compressed, body[8:])
    values = decompress(bytes(body[8 : 8 + compressed]), expected, str(path))
    ends = np.cumsum([header.num_points * dtype.itemsize for dtype in header.fields.values()])
    parts = zip(header.fields.items(), np.split(np.frombuffer(values, np.uint8), ends[:-1]), strict=True)
    return {name: part.view(dtype.base).reshape(-1, *dtype.shape) for (name, dtype), part in parts}


def _check_length(path: Path, header: PcdHeader, expected: int, body: memoryview) -> None:
    if len(body) < expected:
        raise ValueError(f"{path}: truncated: {header.num_points} points take {expected} bytes, got {len(body)}")
    if rest := bytes(body[expected:]).rstrip(b"\0\n"):  # some writers fill a page of memory
        told = f"{path}: {len(rest)} bytes behind the {header.num_points} points of its header are not read"
        warnings.warn(told, stacklevel=4)


def decompress(data: bytes, size: int, name: str = "data") -> bytearray:
    """Decompresses data to `size` bytes. Damaged data make at most one run of 264 bytes more before the error.

    Args:
        data: a sequence of runs. A control byte c below 32 starts a literal run: the next c + 1 bytes are copied
            as they are. Any other control byte starts a back reference of length (c >> 5) + 2, plus the next byte
            if c >> 5 is 7. The copy starts ((c & 31) << 8) + the next byte + 1 bytes before the end of the output,
            and may overlap itself.
        size: of the output, bytes.
        name: for messages.
    """
    out, place, end = bytearray(), 0, len(data)
    with damage_is(f"{name}: damaged: not whole LZF data"):
        while place < end and len(out) <= size:
            control = data[place]
            place += 1
            if control < 32:  # literal run: control + 1 bytes are copied
                out += data[place : place + control + 1]
                place += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[place]
                place += 1
            start = len(out) - ((control & 31) << 8) - data[place] - 1
            place += 1
            if start < 0:
                raise IndexError
            pattern = out[start : start + length + 2]  # a copy that overlaps its own output repeats it
            out += (pattern * ((length + 2) // len(pattern) + 1))[: length + 2]
    if len(out) != size or place != end:
        raise ValueError(f"{name}: damaged: expected {size} bytes of LZF data, got {len(out)}")
    return out
