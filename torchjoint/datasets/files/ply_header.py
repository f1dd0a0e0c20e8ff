"""The header of a PLY file: elements, and the types of their properties."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from torchjoint.datasets.files.text import parse_integer
from torchjoint.runtime import bounds

#: Largest size of a header, bytes; some writers list thousands of comments.
MAX_HEADER = 1 << 20

_KINDS = {
    "char": "i1", "uchar": "u1", "int8": "i1", "uint8": "u1", "short": "i2", "ushort": "u2", "int16": "i2",
    "uint16": "u2", "int": "i4", "uint": "u4", "int32": "i4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
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
    def lists(self) -> bool:
        """Whether a row has a list."""
        return any(one.length is not None for one in self.properties)

    @property
    def names(self) -> list[str]:
        """The names of the properties."""
        return [one.name for one in self.properties]

    def dtype(self, byte_order: str, lengths: Mapping[str, int] | None = None) -> np.dtype[Any]:
        """The NumPy type of a row whose lists have these `lengths`; field `#NAME` is the length of list NAME."""
        fields: list[Any] = []
        for one in self.properties:
            if one.length is None:
                fields.append((one.name, byte_order + one.kind))
            else:
                fields.append((f"#{one.name}", byte_order + one.length))
                fields.append((one.name, byte_order + one.kind, ((lengths or {})[one.name],)))
        return np.dtype(fields)


class PlyHeader(NamedTuple):
    """The header of a file."""

    encoding: str
    byte_order: str
    elements: tuple[Element, ...]
    size: int  #: bytes


def parse_header(data: bytes) -> PlyHeader:
    """Parses the header at the start of a file.

    Raises:
        ValueError: a wrong line; the message quotes the first one.
    """
    end = re.search(rb"\nend_header[ \t]*\r?\n", data[:MAX_HEADER])
    if not re.match(rb"ply[ \t]*\r?\n", data) or end is None:
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
    return PlyHeader(encoding, _ORDERS[encoding], made, end.end())


def _property(words: list[str]) -> Property | None:
    if len(words) == 3 and words[1] in _KINDS:
        return Property(words[2], _KINDS[words[1]])
    if len(words) == 5 and words[1] == "list" and words[2] in _KINDS and words[3] in _KINDS:
        count = _KINDS[words[2]]
        return Property(words[4], _KINDS[words[3]], count) if count[0] in "iu" else None
    return None
