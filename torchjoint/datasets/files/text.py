"""Reads text files with one record per line. Errors name the file and the line."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from io import TextIOWrapper
from pathlib import Path

from torchjoint.runtime import foreign_files as bounds
from torchjoint.runtime.foreign_files import damage_is, open_file


def read_lines(path: Path, expected: str) -> Iterator[tuple[str, str]]:
    """Yields (name, line) for each line except comments (#); messages use `name`; `expected` describes the file.

    Raises:
        FileNotFoundError, ValueError: there is no such file, or it is not a text file.
    """
    is_damaged = damage_is(f"{path}: expected {expected} as text")
    with open_file(path, expected) as stream, is_damaged, TextIOWrapper(stream, "utf-8-sig") as text:
        for number, line in enumerate(iter(partial(text.readline, bounds.LINE), ""), 1):
            bounds.check(len(line), bounds.LINE - 1, f"characters in line {number}")
            if not line.startswith("#"):
                yield f"{path}: line {number}", line.strip()


def parse_numbers(words: Sequence[str], name: str) -> list[float]:
    """Converts the words of a line to finite numbers.

    Raises:
        ValueError: the message names the line and the invalid words.
    """
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [math.nan]
    if not all(map(math.isfinite, values)):
        raise ValueError(f"{name}: expected finite numbers, got {' '.join(words)[:100]!r}")
    return values


def parse_integer(word: str, name: str) -> int:
    """Converts a word of a line to an integer of at most 18 digits.

    Raises:
        ValueError: the message names the line and the invalid word.
    """
    if not (word.isascii() and word.removeprefix("-").isdigit() and len(word) < 19):
        raise ValueError(f"{name}: expected an integer, got {word[:100]!r}")
    return int(word)
