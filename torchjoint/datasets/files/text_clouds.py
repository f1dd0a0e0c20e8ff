"""Clouds as rows of numbers: text with or without names of columns (.txt, .xyz, .asc, .csv, .pts), and arrays.

Rows of numbers without names are x y z, then whatever can be told without guessing: three columns whose rows all have
length 1 are normals; three of 0 to 255 (or 0 to 1) are colours, behind an intensity too, as in .pts and Semantic3D. A
warning tells what is left out.
"""

import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from torchjoint.datasets.files.columns import NO_METRE, NOT_READ, POINTS, Array, CloudFile, cloud_of, plain
from torchjoint.runtime.foreign_files import damage_is, no_twice, read_file
from torchjoint.scene.checks import tell_half

SUFFIXES = (".xyz", ".txt", ".asc", ".csv", ".pts")
#: A unit behind the name of a column: x [m], x (m); one of places that is no metre.
_UNIT = re.compile(r"\[[^][]*\]|\([^()]*\)")
_UNITS = rb"([cmk]|milli|centi)m\w*|(us[- ]?)?(survey )?f(ee|oo)?t|in|inch\w*|deg\w*"
_COLUMN_UNIT = re.compile(rb"\b([xyzenh]|easting|northing|elevation|height) ?[\[(] ?(" + _UNITS + rb") ?[\])]", re.I)
#: A row such as 1,5 2,5 3 with no comma before a blank, or 1,5, 2,5, 3: those between numbers have a blank behind.
_DECIMAL_COMMAS = re.compile(rb"(?!.*,\s)\s*(\S+\s+){2}\S|(?=(.*\d,\d){2})\s*(-?\d+(,\d+)?,\s+)+-?\d+(,\d+)?,?\s*$")
#: An array with more columns than this, and more columns than rows, is transposed: its columns are the points.
MOST_COLUMNS = 16
#: The names of columns that are read of rows without names.
NAMES = ("x", "y", "z", "r", "g", "b", "nx", "ny", "nz")
#: Normals in text have few digits, and a few have no length.
UNIT, MOST_UNIT = 0.02, 0.95
#: The name of a column that counts the rows. One that counts fewer rows may be a coordinate.
NUMBER = "number"
FEWEST_COUNTED = 10


def read_text_cloud(path: Path, letters: str | None) -> CloudFile:
    """Reads a cloud of text; `letters` of its columns are those of `read_cloud_file`, or None."""
    data, start, number, names, count = _opened(path)
    if unit := _COLUMN_UNIT.search(data, 0, start) or NO_METRE.search(data, 0, start):
        warnings.warn(f"{path}: {unit[0].decode('utf-8', 'replace')}: taken as metres", stacklevel=4)
    rows = _numbers(data[start:], number, path)
    if count is not None and count != len(rows):
        raise ValueError(f"{path}: line {number - 1}: {count} points are counted, got {len(rows)}: is it truncated?")
    with damage_is(str(path)):
        if letters is not None:
            return cloud_of_letters(rows, letters)
        if names is not None and len(names) == rows.shape[1]:
            no_twice((name for name in names if not NOT_READ.fullmatch(plain(name))), "column")
            return cloud_of(dict(zip(names, rows.T, strict=True)), str(path))
        # A comment may only mention x, y and z.
        if names is not None and re.search(rb"(?m)^(?![ \t]*(#|//)).*[a-zA-Z]", data[:start]):
            some = ", ".join(names)[:80]
            raise ValueError(f"{len(names)} names of columns, {some}, but {rows.shape[1]} numbers a row; name all")
        return cloud_of_rows(rows, str(path), count, path.suffix)


def read_column(path: Path, wanted: Sequence[str]) -> Array | None:
    """The numbers of the last column with one of these names, as integers if all are whole; None: there is none."""
    data, start, number, names, _ = _opened(path)
    if not (found := [place for place, name in enumerate(names or ()) if name in wanted]):
        return None
    values = _numbers(data[start:], number, path)[:, found[-1]]
    return values.astype(np.int64) if (values == np.floor(values)).all() else values


def with_column(path: Path, name: str, values: Sequence[int], out: Path | None = None) -> bytes:
    """The text of a cloud with one more column, `name` in the line of names; its rows have no comments then.

    It is for `out`, whose suffix may give seven columns a meaning.
    """
    data, start, number, names, count = _opened(path)
    head, rows = data[:start].splitlines(), data[start:].splitlines()
    if names is None:
        old = _numbers(data[start:], number, path)
        kinds = (old, path), (np.column_stack([old, values]), out or path)
        was, then = (" ".join(_names_of(one, count, file.suffix)) for one, file in kinds)
        if was != then:
            raise ValueError(f"{path}: with {name}, {was} would be read as {then}; name all columns in a first line")
    mark = next((mark for mark in (b";", b",", b"\t") if mark in rows[0]), b" ")
    last = mark if rows[0].rstrip().endswith(mark) else b""  # it is no empty field then
    of_row = {place: numbers for place, row in enumerate(rows) if (numbers := re.split(rb"#|//", row)[0].rstrip())}
    for (place, numbers), value in zip(of_row.items(), values, strict=True):  # else labels would move to other rows
        rows[place] = numbers.removesuffix(last) + mark + str(value).encode()
    if names is not None:
        if name in names:
            raise ValueError(f"{path}: expected no column {name}, got one; choose another --name")
        place = max(at for at, line in enumerate(head) if _preamble(line, str(path))[2] == names)
        titles = head[place]
        head[place] = titles.rstrip().removesuffix(mark) + (mark if mark in titles else b" ") + name.encode()
    return b"\n".join([*head, *rows, b""])


def _opened(path: Path) -> tuple[bytes, int, int, list[str] | None, int | None]:
    """The text of a cloud, and what :func:`_preamble` finds in it."""
    with damage_is(str(path)):
        data = _as_utf8(read_file(path, "a point cloud as text"))
    return data, *_preamble(data, f"{path}: not a whole {path.suffix} cloud")


def _as_utf8(data: bytes) -> bytes:
    """Text without the mark of its encoding and without quotes, with line ends of Unix."""
    if b";" not in data and re.search(rb'"[-+]?\d[-+.\de]*,[^"\n]*"', data):
        raise ValueError("expected decimal points, got commas inside of quotes; replace them")
    data = data.decode("utf-16").encode() if data[:2] in (b"\xff\xfe", b"\xfe\xff") else data
    return data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b'"', b"")


def _preamble(data: bytes, name: str) -> tuple[int, int, list[str] | None, int | None]:
    """The byte and the line where the rows begin, the names of columns, and the number of points, if there are any."""
    start, number, names, count = 0, 1, None, None
    while start < len(data):
        end = data.find(b"\n", start) + 1 or len(data)
        line = data[start:end].decode("utf-8", "replace").strip()
        is_comment = line.startswith(("#", "//"))
        mark = next((mark for mark in ";," if mark in line), None)
        line = _UNIT.sub("", line.lstrip("#/ ")).removesuffix(mark or " ")
        words = [word.strip() for word in line.split(mark)]
        if words and (is_comment or not _is_number(words[0] or words[-1])):
            if any({plain(word) for word in words}.issuperset(axes) for axes in POINTS):
                names = words
            elif not is_comment:
                told = f"{name}: line {number}: expected numbers, or names of columns with x, y and z"
                raise ValueError(f"{told}, got {line[:80]!r}; name them x, y and z, or remove the text")
        elif len(words) == 1 and words[0].isdigit() and count is None:
            count = int(words[0])
        elif words:
            break
        start, number = end, number + 1
    return start, number, names, count


def _numbers(text: bytes, first: int, path: Path) -> Array:
    """The rows of numbers; the first one is line `first` of the file."""
    line = text.partition(b"\n")[0]
    delimiter = next((mark for mark in (";", ",") if mark.encode() in line), None)
    if delimiter == ";" and b"," in (line if b"." in text else text):
        text = text.replace(b",", b".")  # decimal commas
    # 1,05,2,5,3,25: whole numbers do not begin with 0
    elif delimiter == "," and (_DECIMAL_COMMAS.match(line) or (b"." not in text and re.search(rb",0\d", text))):
        raise ValueError(f"{path}: line {first}: expected decimal points, got commas in {_shown(line)}; replace them")
    if delimiter and line.rstrip().endswith(delimiter.encode()):
        text = re.sub(rb"[;,][ \t]*(?=\n|$)", b"", text)
    if delimiter:  # an empty field is no number
        text = re.sub(rb"(?m)(^(?=[ \t]*[;,])|[;,])[ \t]*(?=[;,]|$)", rb"\1nan", text)
    if not text.strip():
        raise ValueError(f"{path}: expected a row of x y z for each point, got no rows")
    try:
        return np.loadtxt(io.BytesIO(text), comments=["#", "//"], delimiter=delimiter, ndmin=2)
    except ValueError as error:
        columns = None
        for number, one in enumerate(text.split(b"\n"), first):
            words = re.split(rb"[;,]", one) if delimiter else one.split()
            columns = columns or len(words)
            if not one.strip() or one.startswith((b"#", b"//")):
                continue
            if len(words) != columns or not all(_is_number(word.decode("latin1")) for word in words):
                told = f"{path}: not a whole {path.suffix} cloud: line {number}: expected {columns} numbers"
                raise ValueError(f"{told}, got {_shown(one)}; correct or remove the line, or text columns") from error
        raise ValueError(f"{path}: not a whole {path.suffix} cloud: {error}") from error


def _is_number(word: str) -> bool:
    try:
        float(word.replace(",", "."))
    except ValueError:
        return False
    return "_" not in word


def _shown(line: bytes) -> str:
    return repr(line[:80].decode("utf-8", "replace"))


def cloud_of_rows(rows: Array, name: str, count: int | None = None, suffix: str = "") -> CloudFile:
    """The cloud of rows [N, columns] without names, of a file of this name, count of points, and suffix."""
    if rows.ndim != 2 or rows.shape[1] < 3:
        raise ValueError(f"expected a row of x y z for each point, got shape {list(rows.shape)}")
    if rows.shape[1] > max(MOST_COLUMNS, rows.shape[0]):
        raise ValueError(f"expected a row of x y z for each point, got shape {list(rows.shape)}: transpose the array")
    if rows.dtype == np.float16 and rows.size:
        tell_half(float(np.nanmax(np.abs(rows[:, :3]), initial=0)), torch.float16, name)
    names = _names_of(rows := rows.astype(np.float64), count, suffix)
    if NUMBER in names:
        told = "the first column counts the rows, and is not read; a first line of names (x y z red ...) tells others"
        warnings.warn(f"{name}: {told}", stacklevel=3)
    if rows.shape[1] > len(names):
        told = f"{name}: of {rows.shape[1]} columns, the first {len(names)} are known, {' '.join(names)}"
        more = "a first line of names (x y z red ...), or `superpoints --columns`, names others"
        warnings.warn(f"{told}; the rest is left out; {more}", stacklevel=3)
    return cloud_of(dict(zip(names, rows.T, strict=False)), name)


def _names_of(rows: Array, count: int | None, suffix: str) -> list[str]:
    """The names of the first columns, as far as they can be told; seven of a .pts are x y z intensity r g b."""
    names, is_pts = [NUMBER] * _is_count(rows) + ["x", "y", "z"], count is not None or suffix.lower() == ".pts"
    after = rows[:, len(names) :]
    if after.shape[1] >= 4 and (is_pts or not _are_bytes(after[:, 0])) and _are_bytes(_known(after[:, 1:4])):
        names += ["intensity", "r", "g", "b"]
    while rows.shape[1] >= len(names) + 3:
        three = _known(rows[:, len(names) : len(names) + 3])
        if "nx" not in names and _are_unit(three):
            names += ["nx", "ny", "nz"]
        elif "r" not in names and three.size and three.min() >= 0 and three.max() <= 256:
            names += ["r", "g", "b"]
        else:
            break
    return names


def _is_count(rows: Array) -> bool:
    """Whether the first of four or more columns is no coordinate: it is 0, 1, 2, ... or 1, 2, 3, ...

    Or it has whole numbers, no two of them equal, and the next two columns have not: numbers of points, with gaps.
    """
    first, whole = rows[:, 0], rows[:, :3] == np.floor(rows[:, :3])
    if rows.shape[1] < 4 or len(rows) < FEWEST_COUNTED or not whole[:, 0].all():
        return False
    counts = first[0] in (0, 1) and (np.diff(first) == 1).all()
    return bool(counts or (not whole.all(0)[1:].any() and len(np.unique(first)) == len(rows)))


def _known(values: Array) -> Array:
    return values[~np.isnan(values).any(1)]


def _are_bytes(values: Array) -> bool:
    return bool(((values >= 0) & (values <= 255) & (values == np.floor(values))).all())


def _are_unit(values: Array) -> bool:
    """Whether rows [N, 3] have length 1; colours have not."""
    near = np.abs(np.linalg.norm(values, axis=1) - 1) < UNIT
    return bool(len(values)) and bool((near | ~values.any(1)).all()) and float(near.mean()) > MOST_UNIT


def cloud_of_letters(rows: Array, letters: str) -> CloudFile:
    """The cloud of rows whose columns have a letter each."""
    if rows.ndim != 2 or rows.shape[1] != len(letters):
        raise ValueError(f"expected rows of {len(letters)} numbers, {letters!r}, got shape {list(rows.shape)}")
    normal = iter(("nx", "ny", "nz"))
    names = [next(normal) if letter == "n" else letter for letter in letters]
    return cloud_of({name: rows[:, at].astype(np.float64) for at, name in enumerate(names) if name in NAMES}, "rows")
