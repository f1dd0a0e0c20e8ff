"""Files that may come from others: the one way to open them. Errors name the file, and say what was expected.

A name in a folder may lead nowhere (a lost mount, git-annex), to a device that never ends, or to a pipe that nobody
fills. "Not there" and "cannot be read" are two things: without its cloud a recording is another recording.
"""

import csv
import io
import json
import os
import re
import stat
import struct
import tokenize
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import BufferedReader
from itertools import chain
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from torchjoint.runtime import bounds
from torchjoint.runtime.messages import printable

#: What readers raise where bytes are damaged; RecursionError is a RuntimeError, OverflowError an ArithmeticError.
DAMAGE: tuple[type[Exception], ...] = (
    ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RuntimeError, EOFError, SyntaxError,
    struct.error, zlib.error, tokenize.TokenError, BadZipFile,
)  # fmt: skip


def is_there(path: Path) -> bool:
    """Whether a path leads to something.

    Raises:
        ValueError: it cannot be known: a link leads nowhere, or a folder on the way cannot be entered.
    """
    return _mode(path) is not None


def has_file(path: Path) -> bool:
    """Whether a path leads to a file; False for a folder.

    Raises:
        ValueError: as of :func:`is_there`; also for a device or a pipe, which may never end.
    """
    mode = _mode(path)
    if mode is not None and not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise ValueError(f"{path}: cannot be read: expected a file, got a device, a pipe or a socket")
    return mode is not None and stat.S_ISREG(mode)


def has_folder(path: Path) -> bool:
    """Whether a path leads to a folder."""
    return stat.S_ISDIR(_mode(path) or 0)


def or_unreadable(is_one: Callable[[Path], bool], path: Path) -> bool:
    """Whether a path is one of a list, or this cannot be known: who reads it gets the error, the others are read."""
    try:
        return is_one(path)
    except (ValueError, PermissionError):
        return True


def present(path: Path, expected: str) -> Path:
    """Returns the path of a file that must exist.

    Raises:
        FileNotFoundError: there is no such file; the message says what was expected.
        ValueError: as of :func:`has_file`.
    """
    if not has_file(path):
        raise FileNotFoundError(f"{path}: missing; expected {expected}")
    return path


def open_file(path: Path, expected: str = "a file") -> BufferedReader:
    """Opens a file to read its bytes; errors as of :func:`present`."""
    return present(path, expected).open("rb")


def read_file(path: Path, expected: str, most: int | None = None) -> bytes:
    """Reads the bytes of a file.

    Args:
        path: of the file.
        expected: what it should be, for messages.
        most: the largest number of bytes; None: any.

    Raises:
        FileNotFoundError, ValueError: as of :func:`present`, or the file is larger.
    """
    with open_file(path, expected) as stream:
        size = os.fstat(stream.fileno()).st_size
        bounds.check(size, size if most is None else most, f"bytes of {expected}", str(path))
        return stream.read(size)  # files of the system may have no size, and no end


def read_text(path: Path, expected: str, most: int = bounds.TEXT_BYTES, *, errors: str = "strict") -> str:
    """Reads a text file (UTF-8) with any line ends; errors as of :func:`read_file`, also if it is no text."""
    data = read_file(path, expected, most)
    with damage_is(f"{path}: expected {expected} as text"):
        return data.decode("utf-8-sig", errors).replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: Path, expected: str) -> Any:
    """Reads a JSON file; errors as of :func:`read_file`, also if it is damaged."""
    return parse_json(read_file(path, expected, bounds.JSON_BYTES), str(path))


def parse_json(data: bytes, name: str) -> Any:
    """Reads the bytes of a JSON file."""
    bounds.check(sum(map(data.count, (b",", b"[", b"{"))), bounds.JSON_VALUES, "values", name)
    with damage_is(f"{name}: not a whole JSON file"):
        return json.loads(data, object_pairs_hook=dict_of)


def inflate(data: bytes, size: int, name: str) -> bytes:
    """Unpacks a whole zlib stream of `size` bytes; allocates at most one byte more. Errors begin with `name`."""
    stream = zlib.decompressobj()
    with damage_is(f"{name}: not a whole zlib stream"):
        unpacked = stream.decompress(data, size + 1)
    if not stream.eof or len(unpacked) != size:
        raise ValueError(f"{name}: expected a zlib stream of {size} bytes, got another or a truncated one")
    return unpacked


@contextmanager
def damage_is(message: str, *more: type[Exception]) -> Iterator[None]:
    """Turns an error of DAMAGE, or one of `more`, into a ValueError that begins with a message.

    >>> with damage_is("cameras.json: not a list of cameras"):
    ...     {}["frames"]
    Traceback (most recent call last):
    ValueError: cameras.json: not a list of cameras: KeyError('frames')
    """
    try:
        yield
    except (*DAMAGE, *more) as error:
        is_clear = isinstance(error, (ValueError, OSError)) or not isinstance(error, DAMAGE[:4])
        raise ValueError(f"{message}: {error if is_clear else repr(error)}") from error


def _mode(path: Path) -> int | None:
    """The mode of what a path leads to; None: nothing is there."""
    try:
        return os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        _check_links(path)
        return None
    except OSError as error:  # no permission, or a link to itself
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError:  # a name that no file can have
        return None


def _check_links(path: Path) -> None:
    """Raises if a path that leads nowhere does so because of a link: its own, or that of a folder on the way."""
    place = next(filter(os.path.lexists, chain((path,), path.parents)), path)  # mostly the first parent
    if os.path.islink(place) and not os.path.exists(place):
        raise ValueError(f"{path}: cannot be read: {place} is a link to {os.readlink(place)}, which is not there")


def dict_of(pairs: Sequence[tuple[Any, Any]], what: str = "name") -> dict[Any, Any]:
    """Pairs of a name and a value as a dict; errors as of :func:`no_twice`."""
    if len(made := dict(pairs)) < len(pairs):
        no_twice((name for name, _ in pairs), what)
    return made


def no_twice(names: Iterable[object], what: str) -> None:
    """Checks that no name occurs twice: only one of the two would be read."""
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise ValueError(f"{what} {twice[0]!r} is there twice")


#: Where a spreadsheet would find something to compute: at the start of a cell, also of those that it makes if it takes
#: semicolons or tabs for the ends of cells.
_FORMULA = re.compile(r'(^|(?<=[;\t\r\n"]))(?=[=+\-@＝＋－＠\t\r])')


def no_formula(text: str) -> str:
    """A text with apostrophes before what a spreadsheet would compute: names come from others."""
    return _FORMULA.sub("'", text).replace("\r\n", "\n").replace("\r", "\n")


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Rows as text, without formulas and what controls a terminal."""
    text = io.StringIO()
    cells = ([no_formula(printable(cell)) if isinstance(cell, str) else cell for cell in row] for row in rows)
    csv.writer(text, lineterminator="\n").writerows(cells)  # csv puts no quotes around a lone "\r", which ends a row
    return text.getvalue()
