"""Reads PLY files (Greg Turk's Polygon File Format, 1994), ascii and binary of both byte orders; writes binary ones.

Every number is checked: a truncated file, extra data, or a word that is not a number is an error in any element. Labels
are added to a file of others as bytes: properties without a meaning for this package survive.
"""

import io
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.files.columns import COLORS, NO_METRE, Array, CloudFile, cloud_of, plain, tell_not_read, typed
from torchjoint.datasets.files.text import parse_integer
from torchjoint.runtime import bounds
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.foreign_files import damage_is, read_file

#: Largest size of a header, bytes; some writers list thousands of comments.
MAX_HEADER = 1 << 20

#: Names of the list of a face's vertices.
_FACE_LISTS = ("vertex_indices", "vertex_index")
#: Names of what colours the faces, and not the vertices.
_DRAWN = {"texcoord", *(color for colors in COLORS for color in colors)}
_WORDS = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float",
          "f8": "double"}  # fmt: skip
_KINDS = {word: kind for kind, word in _WORDS.items()} | {
    f"{name}{8 * int(kind[1])}": kind for kind in _WORDS for name in [{"i": "int", "u": "uint", "f": "float"}[kind[0]]]
}
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


class Property(NamedTuple):
    """One number for each row of an element, or a list of numbers."""

    name: str
    kind: str  #: numpy's type, without byte order
    length: str | None = None  #: the type of a list's length; None: no list


class Element(NamedTuple):
    """Rows of one kind, such as vertices."""

    name: str
    rows: int
    properties: tuple[Property, ...]

    @property
    def lists(self) -> list[str]:
        """The names of the properties that are lists."""
        return [one.name for one in self.properties if one.length is not None]

    def dtype(self, byte_order: str, lengths: Mapping[str, int]) -> np.dtype[Any]:
        """The NumPy type of a row whose lists have these `lengths`; field `#NAME` is the length of list NAME."""
        fields: list[Any] = []
        for one in self.properties:
            if one.length is not None:
                fields.append((f"#{one.name}", byte_order + one.length))
            fields.append((one.name, byte_order + one.kind, () if one.length is None else (lengths[one.name],)))
        return np.dtype(fields)


class Header(NamedTuple):
    """The header of a file."""

    encoding: str
    byte_order: str
    elements: tuple[Element, ...]
    size: int  #: bytes


class Lists(NamedTuple):
    """A column of lists, one after the other."""

    values: Array  #: of all lists
    lengths: Array  #: [rows] int64


#: By name: numbers [rows], or lists.
Columns = Mapping[str, "Array | Lists"]


def read_ply(path: Path) -> CloudFile:
    """Reads the vertices and faces of a PLY file; of other elements only the size is checked."""
    elements = _read_elements(path)
    with damage_is(str(path)):
        return _assembled(elements, str(path))


def read_vertex_property(path: Path, *names: str) -> Array | None:
    """Reads an integer property of the vertices, [N]: the last one, which is the newest, of these names; None: none."""
    found = {name: one for name, one in _read_elements(path).get("vertex", {}).items() if name in names}
    if not found:
        return None
    name, values = found.popitem()
    if isinstance(values, Lists) or values.dtype.kind not in "iu":
        got = "lists" if isinstance(values, Lists) else values.dtype
        raise ValueError(f"{path}: property {name}: expected integers, got {got}")
    return values.astype(np.int64)


def write_cloud(
    path: Path,
    points: Tensor,
    colors: Tensor | None = None,
    labels: Tensor | None = None,
    faces: Tensor | None = None,
    name: str = "label",
) -> None:
    """Writes a binary PLY atomically: equal arguments give equal bytes.

    Args:
        path: of the file.
        points: [N, 3], as float, or double if they are float64.
        colors: [N, 3] in [0, 1], as uchar red green blue.
        labels: [N] integers, as int `name`.
        faces: [F, 3] triangles of the points.
        name: of the property of the labels.
    """
    kind = torch.float64 if points.dtype == torch.float64 else torch.float32
    columns = dict(zip("xyz", points.to(kind).T, strict=True))
    if colors is not None:
        columns |= zip(("red", "green", "blue"), (colors.clamp(0, 1) * 255).round().to(torch.uint8).T, strict=True)
    if labels is not None:
        columns[name] = labels.to(torch.int32)
    rows = np.empty(len(points), [(name, column.numpy().dtype.newbyteorder("<")) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column.numpy()
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    lines += [f"property {_WORDS[rows.dtype[name].str[1:]]} {name}" for name in columns]
    more, body = ([], b"") if faces is None else _triangles(faces.numpy(), "<")
    write_bytes(path, ("\n".join([*lines, *more, "end_header"]) + "\n").encode() + rows.tobytes() + body)


def _triangles(corners: Array, byte_order: str) -> tuple[list[str], bytes]:
    """The lines and the bytes of an element of triangles [F, 3]."""
    faces = np.empty(len(corners), [("size", "u1"), ("corner", f"{byte_order}i4", (3,))])
    faces["size"], faces["corner"] = 3, corners
    return [f"element face {len(faces)}", "property list uchar int vertex_indices"], faces.tobytes()


def write_bytes(path: Path, content: bytes) -> None:
    """Writes a file atomically."""
    with atomic_write(path) as partial:
        partial.write_bytes(content)


def _assembled(elements: Mapping[str, Columns], name: str) -> CloudFile:
    if "vertex" not in elements:
        raise ValueError(f"expected an element vertex, got {', '.join(elements) or 'none'}")
    vertex = {name: column for name, column in elements["vertex"].items() if not isinstance(column, Lists)}
    if any(column.startswith("packed_") for column in vertex):
        raise ValueError(
            "expected splats with x, y and z, got packed ones of SuperSplat (.compressed.ply); save them as .ply "
            "(`splat-transform a.compressed.ply a.ply`, or SuperSplat's export)"
        )
    cloud = cloud_of(vertex, name)
    tell_not_read(elements["vertex"].keys() - vertex.keys(), name)
    if not len(cloud.points):
        raise ValueError("no points")
    drawn = {*map(plain, elements.get("face", {}))} & _DRAWN | {*map(plain, vertex)} & {"textureu", "u", "s"}
    if cloud.colors is None and drawn:
        told = f"{name}: {', '.join(sorted(drawn))}: colours of faces and textures are not read, only those of vertices"
        warnings.warn(told, stacklevel=4)
    return cloud._replace(faces=_faces(elements, len(cloud.points), name))


def _faces(elements: Mapping[str, Columns], num_points: int, name: str) -> Tensor | None:
    """The triangles [F, 3] int64 of polygons, from the first corner of each; and those of strips."""
    found = []
    for element, triangles_of in (("face", _fans), ("tristrips", _strips)):
        columns = elements.get(element, {})
        lists = next((columns[one] for one in _FACE_LISTS if one in columns), None)
        if lists is None and columns:
            warnings.warn(f"{name}: element {element}: no list {_FACE_LISTS[0]}; triangles are not read", stacklevel=5)
        if isinstance(lists, Lists) and len(triangles := triangles_of(lists)):
            low, high = triangles.min(), triangles.max()
            if not 0 <= low <= high < num_points:
                raise ValueError(f"element {element}: expected vertices in [0, {num_points}), got {low} to {high}")
            found.append(triangles)
    return torch.from_numpy(np.concatenate(found)) if found else None


def _fans(lists: Lists) -> Array:
    count = np.maximum(lists.lengths - 2, 0)
    start = np.repeat(np.cumsum(lists.lengths) - lists.lengths, count)
    second = start + 1 + np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.stack([lists.values[corner] for corner in (start, second, second + 1)], axis=1).astype(np.int64)


def _strips(lists: Lists) -> Array:
    """Each corner makes a triangle with the two before it, turned every other time; -1 begins a new strip."""
    corners = np.insert(lists.values.astype(np.int64), np.cumsum(lists.lengths), -1)
    is_end = corners == -1
    place = np.arange(len(corners)) - np.maximum.accumulate(np.where(is_end, np.arange(len(corners)) + 1, 0))
    triangles = np.lib.stride_tricks.sliding_window_view(corners, 3) if len(corners) > 2 else np.empty((0, 3), np.int64)
    triangles = np.where(place[: len(triangles), None] % 2 == 1, triangles[:, [1, 0, 2]], triangles)
    a, b, c = triangles.T
    return triangles[(triangles != -1).all(1) & (a != b) & (b != c) & (a != c)]


def _read_elements(path: Path) -> dict[str, Columns]:
    data = read_file(path, "a point cloud, .ply")
    with damage_is(str(path)):
        header = parse_header(data)
        if unit := NO_METRE.search(data, 0, header.size):
            warnings.warn(f"{path}: {unit[1].decode('ascii', 'replace')}: taken as metres", stacklevel=5)
        if header.encoding == "ascii":
            return {element.name: _ascii_rows(text, element) for element, text in _texts(data, header)}
        return _binary_elements(data, header)


def parse_header(data: bytes) -> Header:
    """Parses the header at the start of a file."""
    end = re.search(rb"\nend_header[ \t]*\r?\n", data[:MAX_HEADER])
    if not re.match(rb"(?:\xef\xbb\xbf)?ply[ \t]*\r?\n", data) or end is None:
        raise ValueError("not a PLY file, or its header is truncated")
    lines = data[: end.start()].decode("ascii", errors="replace").splitlines()[1:]
    encoding = ""
    elements: dict[str, tuple[int, dict[str, Property]]] = {}
    name, num_properties = "", 0
    for line in lines:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and len(words) == 3 and words[1] in _ORDERS and words[2] == "1.0" and not encoding:
            encoding = words[1]
        elif words[0] == "element" and len(words) == 3 and words[1] not in elements:
            count = parse_integer(words[2], f"header: {line!r}")
            if count < 0:
                raise ValueError(f"header: {line!r}: expected a count")
            name = words[1]
            elements[name] = (count, {})
            bounds.check(len(elements), bounds.ELEMENTS, "elements", "header")
        elif words[0] == "property" and elements and (one := _property(words)) is not None:
            if one.name in elements[name][1]:
                raise ValueError(f"header: property {one.name} of element {name} is there twice")
            elements[name][1][one.name] = one
            num_properties += 1
            bounds.check(num_properties, bounds.PROPERTIES, "properties", "header")
        else:
            raise ValueError(f"header: {line[:100]!r} is not understood")
    if not encoding:
        raise ValueError("header: expected format ascii, binary_little_endian or binary_big_endian 1.0")
    made = tuple(Element(name, count, tuple(of.values())) for name, (count, of) in elements.items())
    return Header(encoding, _ORDERS[encoding], made, end.end())


def _property(words: list[str]) -> Property | None:
    if len(words) == 3 and words[1] in _KINDS:
        return Property(words[2], _KINDS[words[1]])
    if len(words) == 5 and words[1] == "list" and words[2] in _KINDS and words[3] in _KINDS:
        count = _KINDS[words[2]]
        return Property(words[4], _KINDS[words[3]], count) if count[0] in "iu" else None
    return None


def _binary_elements(data: bytes, header: Header) -> dict[str, Columns]:
    place, elements = header.size, {}
    for element in header.elements:
        if element.properties:
            elements[element.name], place = _binary_rows(data, place, element, header.byte_order)
    if data[place:].strip():
        raise ValueError(f"expected the end at byte {place}, got {len(data) - place} more bytes")
    return elements


def _binary_rows(data: bytes, place: int, element: Element, order: str) -> tuple[Columns, int]:
    """The columns of an element, and the byte behind it."""
    smallest = sum(np.dtype(one.length or one.kind).itemsize for one in element.properties)
    _check_rest(data, place, smallest * element.rows, element)
    lengths: dict[str, Any] = dict.fromkeys(element.lists, 0)
    if element.lists and element.rows:
        first, _ = _rows_of_several_lengths(data, place, element._replace(rows=1), order)
        lengths = {name: int(lists.lengths[0]) for name, lists in first.items() if isinstance(lists, Lists)}
    rows = _rows_of_one_length(data, place, element, order, lengths)
    if rows is None:
        return _rows_of_several_lengths(data, place, element, order)
    columns: dict[str, Array | Lists] = {one.name: rows[one.name] for one in element.properties}
    columns |= {name: Lists(rows[name].ravel(), np.full(len(rows), length)) for name, length in lengths.items()}
    return columns, place + rows.nbytes


def _rows_of_one_length(
    data: bytes, place: int, element: Element, order: str, lengths: Mapping[str, int]
) -> Array | None:
    """The rows of an element whose lists all have these lengths; None if they do not, or the file is too short."""
    dtype = element.dtype(order, lengths)
    if dtype.itemsize * element.rows > len(data) - place:
        return None
    rows = np.frombuffer(data, dtype, element.rows, place)
    return rows if all((rows[f"#{name}"] == length).all() for name, length in lengths.items()) else None


def _rows_of_several_lengths(data: bytes, place: int, element: Element, order: str) -> tuple[Columns, int]:
    """The rows one by one: where a list begins depends on all lists before it. Numbers stay bytes until the end."""
    bounds.check(element.rows, bounds.LIST_ROWS, f"rows of lists of several lengths in element {element.name}")
    found = [bytearray() for _ in element.properties]
    lengths = {name: np.zeros(element.rows, np.int64) for name in element.lists}
    steps = [(one.name, np.dtype(one.kind).itemsize, one.length) for one in element.properties]
    for row in range(element.rows):
        for raw, (name, size, count) in zip(found, steps, strict=True):
            length = 1
            if count is not None:
                width = int(count[1])
                _check_rest(data, place, width, element)
                part = data[place : place + width]
                length = int.from_bytes(part, "little" if order == "<" else "big", signed=count[0] == "i")
                if length < 0:
                    raise ValueError(f"element {element.name}: a list of {length} numbers")
                lengths[name][row] = length
                place += width
            _check_rest(data, place, length * size, element)
            raw += data[place : place + length * size]
            place += length * size
    columns: dict[str, Array | Lists] = {}
    for one, raw in zip(element.properties, found, strict=True):
        values = np.frombuffer(raw, order + one.kind)
        columns[one.name] = Lists(values, lengths[one.name]) if one.length else values
    return columns, place


def _check_rest(data: bytes, place: int, size: int, element: Element) -> None:
    if size > len(data) - place:
        told = f"truncated: {element.rows} of element {element.name} need {size} bytes at byte {place}"
        raise ValueError(f"{told}, got {max(0, len(data) - place)}")


def _texts(data: bytes, header: Header) -> Iterator[tuple[Element, bytes]]:
    """The lines of each element of an ascii file, one a row; behind the last row there may be blank ones."""
    body = data[header.size :]
    ends = np.flatnonzero(np.frombuffer(body.rstrip(), np.uint8) == ord("\n")) + 1
    full = [element for element in header.elements if element.properties]
    lines, expected = len(ends) + bool(body.strip()), sum(element.rows for element in full)
    if lines != expected:
        counts = ", ".join(f"{element.rows} of {element.name}" for element in header.elements)
        raise ValueError(f"truncated, or too long: expected {expected} lines ({counts}), got {lines}")
    if expected and not data.endswith(b"\n"):
        raise ValueError("truncated: expected a line break after the last number, which may be cut off")
    starts, row = [0, *ends.tolist(), len(body)], 0
    for element in full:
        yield element, body[starts[row] : starts[row := row + element.rows]]


def _ascii_rows(text: bytes, element: Element) -> Columns:
    """The columns of an element, of which each row is a line; the lengths of its lists tell where its numbers are."""
    numbers, counts = _numbers_of_lines(text, element)
    ends = np.cumsum(counts)
    place = starts = ends - counts

    def must_fit(fits: Array, expected: Array, what: str) -> None:
        if not fits.all():
            row = int(fits.argmin())
            got = text.splitlines()[row][:80]
            raise ValueError(f"element {element.name}: expected {expected[row]} numbers{what} in {got!r}")

    columns: dict[str, Array | Lists] = {}
    for one in element.properties:
        name = f"property {one.name}"
        must_fit(place < ends, place - starts + 1, "")
        if one.length is None:
            columns[one.name], place = typed(numbers[place], one.kind, name, element.name), place + 1
            continue
        lengths = typed(numbers[place], one.length, name, element.name).astype(np.int64)
        place = place + 1
        must_fit((lengths >= 0) & (lengths <= ends - place), lengths, f" of {one.name}")
        at = np.arange(lengths.sum()) + np.repeat(place - np.cumsum(lengths) + lengths, lengths)
        columns[one.name], place = Lists(typed(numbers[at], one.kind, name, element.name), lengths), place + lengths
    must_fit(place == ends, place - starts, "")
    return columns


def _numbers_of_lines(text: bytes, element: Element) -> tuple[Array, Array]:
    """All numbers of an element's lines, and how many there are in each line [rows]."""
    if not element.rows:
        return np.empty(0), np.empty(0, np.int64)
    reason = ""
    try:
        table = np.loadtxt(io.BytesIO(text), comments=None, ndmin=2)
        if len(table) == element.rows and (element.lists or table.shape[1] == len(element.properties)):
            return table.ravel(), np.full(element.rows, table.shape[1])
    except ValueError as error:  # of lines of several lengths, or of a word
        reason = str(error)
    counts = np.array([len(line.split()) for line in text.splitlines()])
    if not element.lists:
        for row in np.flatnonzero(counts != len(element.properties)).tolist():
            told = f"expected {len(element.properties)} numbers in row {row}, got {counts[row]} words"
            raise ValueError(f"element {element.name}: {told}")
        raise ValueError(f"element {element.name}: a word is no number: {reason}")
    bounds.check(element.rows, bounds.LIST_ROWS, f"rows of lists of several lengths in element {element.name}")
    if b"_" in text:  # Python reads 1_0 as 10
        raise ValueError(f"element {element.name}: expected numbers, got a word with _")
    return np.array([float(word) for word in text.split()]), counts


class PlyRecords(NamedTuple):
    """A file as records that can be copied: the bytes of each vertex, and of each face, stay together."""

    head: Sequence[bytes]  #: the lines of the header, with their ends
    header: Header
    #: By element: bytes [rows, size] of a binary file, or lines [rows] of an ascii one, with their ends; faces that are
    #: no triangles, and other lists of several lengths in a binary file, have another name, or are in `rest`.
    records: Mapping[str, Array]
    rest: bytes  #: everything after the last element in `records`

    def check_new(self, name: str, element: str = "vertex") -> None:
        """Raises ValueError if an element has a property of this name."""
        of_file = next(one for one in self.header.elements if one.name == element)
        if any(one.name == name for one in of_file.properties):
            raise ValueError(f"element {element} has a property {name} already; choose another (--name), or remove it")

    def with_labels(self, name: str, labels: Mapping[str, Array]) -> bytes:
        """The file with one more property of the elements in `labels`, int NAME, at the end of each row."""
        lines, bodies = list(self.head), dict(self.records)
        for element, values in labels.items():
            self.check_new(name, element)
            start, end = _section(lines, element)
            lines.insert(end, f"property int {name}".encode() + _end(lines[start]))
            rows = bodies[element]
            if self.header.encoding == "ascii":
                pairs = zip(rows, values.tolist(), strict=True)
                bodies[element] = np.array([b"%s %d%s" % (r.rstrip(b"\r\n"), v, _end(r)) for r, v in pairs], object)
            else:
                last = np.ascontiguousarray(values, f"{self.header.byte_order}i4").view(np.uint8)
                bodies[element] = np.concatenate([rows, last.reshape(len(rows), 4)], axis=1)
        return b"".join([*lines, *map(_joined, bodies.values()), self.rest])

    def some_vertices(self, which: Array, triangles: Array | None) -> bytes:
        """A file with some of the vertices, all their properties, and these triangles of the new vertices, if any."""
        first = next(i for i, line in enumerate(self.head) if line.split()[:1] == [b"element"])
        start, end = _section(self.head, "vertex")
        lines, bodies = [f"element vertex {int(which.sum())}"], [_joined(self.records["vertex"][which])]
        lines += [line.decode("ascii", "replace").strip() for line in self.head[start + 1 : end]]
        if triangles is not None:
            if self.header.encoding == "ascii":
                raise ValueError("expected a binary file, for parts of a mesh, got an ascii one")
            more, body = _triangles(triangles, self.header.byte_order)
            lines, bodies = lines + more, [*bodies, body]
        added = [line.encode() + _end(self.head[0]) for line in [*lines, "end_header"]]  # of one kind
        return b"".join([*self.head[:first], *added, *bodies])


def read_records(path: Path) -> PlyRecords:
    """Reads a file's records."""
    with damage_is(str(path)):
        data = read_file(path, "a .ply")
        header = parse_header(data)
        records, rest = (_records_of_lines if header.encoding == "ascii" else _records_of_bytes)(data, header)
        if "vertex" not in records:
            raise ValueError("expected vertices without lists of several lengths")
        return PlyRecords(data[: header.size].splitlines(keepends=True), header, records, rest)


def _records_of_bytes(data: bytes, header: Header) -> tuple[dict[str, Array], bytes]:
    """Rows of elements from the first on, while all rows of an element have one size."""
    place, records = header.size, {}
    for element in header.elements:
        if not element.properties:
            continue
        rows = _rows_of_one_length(data, place, element, header.byte_order, dict.fromkeys(element.lists, 3))
        if rows is not None:
            records[element.name] = np.frombuffer(data, np.uint8, rows.nbytes, place).reshape(-1, rows.itemsize)
            place += rows.nbytes
        elif not element.lists:
            raise ValueError(f"truncated: element {element.name} has fewer than {element.rows} rows")
        elif "vertex" in records:
            break
        else:
            end = _rows_of_several_lengths(data, place, element, header.byte_order)[1]
            records[f"#{element.name}"], place = np.frombuffer(data, np.uint8, end - place, place)[None], end
    return records, data[place:]


def _records_of_lines(data: bytes, header: Header) -> tuple[dict[str, Array], bytes]:
    records, rest = {}, b""
    for element, text in _texts(data, header):
        columns = _ascii_rows(text, element) if element.name == "face" else {}
        mixed = any(isinstance(v, Lists) and (v.lengths != 3).any() for k, v in columns.items() if k in _FACE_LISTS)
        lines = io.BytesIO(text).readlines()
        records["#" * mixed + element.name] = np.array(lines[: element.rows], object)
        rest = b"".join(lines[element.rows :])
    return records, rest


def _section(head: Sequence[bytes], element: str) -> tuple[int, int]:
    """The line of a header in which an element begins, and the one behind its properties."""
    start = next(i for i, line in enumerate(head) if line.split()[:2] == [b"element", element.encode()])
    after = (i for i in range(start + 1, len(head)) if head[i].split()[:1] in ([b"element"], [b"end_header"]))
    return start, next(after)


def _end(line: bytes) -> bytes:
    """The line break at the end of a line."""
    return line[len(line.rstrip(b"\r\n")) :] or b"\n"


def _joined(rows: Array) -> bytes:
    return b"".join(rows) if rows.dtype == object else rows.tobytes()
