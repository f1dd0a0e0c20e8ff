"""Text files with a record a line. Errors name the file and the line."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path


def read_lines(path: Path, expected: str) -> Iterator[tuple[str, str]]:
    """The lines of a file but comments (#), each after its name for messages; `expected` says what the file is to hold.

    Raises:
        FileNotFoundError, ValueError: no such file, or not one of text.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: missing; expected {expected}")
    try:
        with path.open(encoding="utf-8") as stream:
            for number, line in enumerate(stream, 1):
                if not line.startswith("#"):
                    yield f"{path}: line {number}", line.strip()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: expected {expected} as text: {error}") from error


def parse_numbers(words: Sequence[str], name: str) -> list[float]:
    """Words of a line -> finite numbers.

    Raises:
        ValueError: naming the line and what came.
    """
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [math.nan]
    if not all(map(math.isfinite, values)):
        raise ValueError(f"{name}: expected finite numbers, got {' '.join(words)[:100]!r}")
    return values


def parse_integer(word: str, name: str) -> int:
    """A word of a line -> an integer of at most 18 digits.

    Raises:
        ValueError: naming the line and what came.
    """
    if not (word.isascii() and word.removeprefix("-").isdigit() and len(word) < 19):
        raise ValueError(f"{name}: expected an integer, got {word[:100]!r}")
    return int(word)
