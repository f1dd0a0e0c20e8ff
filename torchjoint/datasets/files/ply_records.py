"""A PLY file as records that can be copied: labels are added to a file of others, and everything else stays as it was.

Readers turn a file into tensors and forget what they do not know. Here the bytes of each vertex and of each face stay
together, so properties without a meaning for this package survive: those of Gaussian splats, for example.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from torchjoint.datasets.files.ply_header import MAX_HEADER, Element, PlyHeader, parse_header
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import damage_is, read_file

#: Bytes [rows, size] of a binary file, or lines [rows] of an ascii one.
Records = npt.NDArray[Any]


class PlyRecords(NamedTuple):
    """The parts of a file."""

    head: Sequence[str]  #: the lines of the header
    header: PlyHeader
    records: Mapping[str, Records]  #: by element; an element is missing if its rows have lists of several lengths
    rest: bytes  #: everything after the last element in `records`

    def with_labels(self, name: str, labels: Mapping[str, npt.NDArray[Any]]) -> bytes:
        """The file with one more property of the elements in `labels`, int NAME, at the end of each row.

        Raises:
            ValueError: there is such a property already.
        """
        lines = list(self.head)
        for element in labels:
            of_file = next(one for one in self.header.elements if one.name == element)
            if name in of_file.names:
                raise ValueError(f"element {element} has a property {name} already; choose another name")
            start = next(i for i, line in enumerate(lines) if line.split()[:2] == ["element", element])
            after = (i for i in range(start + 1, len(lines)) if not lines[i].startswith(("property", "comment")))
            lines.insert(next(after), f"property int {name}")
        bodies = [
            self._joined(records, labels[element]) if element in labels else records
            for element, records in self.records.items()
        ]
        return self._bytes(lines, bodies) + self.rest

    def some_vertices(self, which: npt.NDArray[np.bool_], triangles: npt.NDArray[np.int64] | None) -> bytes:
        """A file with some of the vertices, all their properties, and these triangles of the new vertices, if any.

        Raises:
            ValueError: an ascii file with triangles.
        """
        vertex = self.header.elements[0]
        end = self.head.index(next(line for line in self.head if line.split()[:1] == ["element"]))
        lines = [*self.head[:end], f"element vertex {int(which.sum())}", *_properties(vertex)]
        bodies = [self.records["vertex"][which]]
        if triangles is not None:
            if self.header.encoding == "ascii":
                raise ValueError("expected a binary file, for parts of a mesh, got an ascii one")
            kind = np.dtype([("size", "u1"), ("corner", f"{self.header.byte_order}i4", (3,))])
            faces = np.empty(len(triangles), kind)
            faces["size"], faces["corner"] = 3, triangles
            lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
            bodies.append(faces.view(np.uint8).reshape(len(faces), kind.itemsize))
        return self._bytes([*lines, "end_header"], bodies)

    def _joined(self, records: Records, values: npt.NDArray[Any]) -> Records:
        if self.header.encoding == "ascii":
            return np.array([b"%s %d" % pair for pair in zip(records, values.tolist(), strict=True)], dtype=object)
        last = np.ascontiguousarray(values, dtype=f"{self.header.byte_order}i4").view(np.uint8)
        return np.concatenate([records, last.reshape(len(records), 4)], axis=1)

    def _bytes(self, lines: Sequence[str], bodies: Sequence[Records]) -> bytes:
        joined = (
            [b"".join(line + b"\n" for line in body) for body in bodies]
            if self.header.encoding == "ascii"
            else [body.tobytes() for body in bodies]
        )
        return "".join(f"{line}\n" for line in lines).encode("utf-8", "surrogateescape") + b"".join(joined)


def read_records(path: Path) -> PlyRecords:
    """Reads a file's records.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    with damage_is(str(path)):
        return parse_records(read_file(path, "a .ply"))


def parse_records(data: bytes) -> PlyRecords:
    """Reads the records of a file's bytes.

    Raises:
        ValueError: the bytes are damaged, or have no vertices.
    """
    header = parse_header(data[:MAX_HEADER])
    if not header.elements or header.elements[0].name != "vertex" or header.elements[0].lists:
        raise ValueError("expected vertices without lists as first element")
    text = data[: header.size].decode("utf-8", "surrogateescape")
    head = [line.rstrip() for line in re.split(r"\r?\n", text) if line]
    records, rest = (_lines if header.encoding == "ascii" else _rows)(data, header)
    return PlyRecords(head, header, records, rest)


def write_bytes(path: Path, content: bytes) -> None:
    """Writes a file atomically."""
    with atomic_write(path) as partial:
        partial.write_bytes(content)


def _rows(data: bytes, header: PlyHeader) -> tuple[dict[str, Records], bytes]:
    """Rows of elements from the first on, while all rows of an element have one size."""
    place, records = header.size, {}
    for element in header.elements:
        if not element.properties:
            continue
        dtype = element.dtype(header.byte_order, {one.name: 3 for one in element.properties if one.length is not None})
        if dtype.itemsize * element.rows > len(data) - place:
            if not element.lists:
                raise ValueError(f"truncated: element {element.name} has fewer than {element.rows} rows")
            break
        rows = np.frombuffer(data, dtype, element.rows, place)
        if any((rows[f"#{one.name}"] != 3).any() for one in element.properties if one.length is not None):
            break
        records[element.name] = np.frombuffer(data, np.uint8, rows.nbytes, place).reshape(element.rows, dtype.itemsize)
        place += rows.nbytes
    return records, data[place:]


def _lines(data: bytes, header: PlyHeader) -> tuple[dict[str, Records], bytes]:
    lines = [line for line in data[header.size :].splitlines() if line.strip()]
    expected = sum(element.rows for element in header.elements)
    if len(lines) != expected:
        raise ValueError(f"expected {expected} lines after the header, one a row, got {len(lines)}")
    place, records = 0, {}
    for element in header.elements:
        records[element.name] = np.empty(element.rows, dtype=object)
        records[element.name][:] = lines[place : place + element.rows]
        place += element.rows
    return records, b""


def _properties(element: Element) -> list[str]:
    words = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint"}
    words |= {"f4": "float", "f8": "double"}
    return [f"property {words[one.kind]} {one.name}" for one in element.properties]
