"""Files that may come from others: errors name the file, and say what was expected."""

from __future__ import annotations

import struct
import tokenize
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from zipfile import BadZipFile

#: What readers raise where bytes are damaged; RecursionError is a RuntimeError, OverflowError an ArithmeticError.
DAMAGE: tuple[type[Exception], ...] = (
    ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RuntimeError, EOFError, SyntaxError,
    struct.error, zlib.error, tokenize.TokenError, BadZipFile,
)  # fmt: skip


def present(path: Path, expected: str) -> Path:
    """Returns the path of a file that must exist.

    Raises:
        FileNotFoundError: there is no such file; the message says what was expected.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected {expected}")
    return path


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
