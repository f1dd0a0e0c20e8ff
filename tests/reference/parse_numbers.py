"""parse_numbers: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import LABELS, PIXELS
from torchjoint.ops.internal import parse_numbers

EXAMPLE: dict[str, Any] = {
    "text": torch.tensor(list(b"1 -2.5e3\t.5\n 1e22 inf 0.1234567890123456789 \n4"), dtype=torch.uint8), "num_rows": 2,
    "num_columns": 3,
}  # fmt: skip
ERRORS = [
    ({"text": "1 2 3"}, RuntimeError, "Expected a value of type 'Tensor' for argument 'text'"),
    ({"text": PIXELS}, ValueError, "text: expected another dtype"),
    ({"text": LABELS.byte()}, ValueError, "text: expected 1 dimensions"),
    ({"num_rows": -1}, ValueError, "num_rows: expected a number >= 0, got -1"),
    ({"num_rows": 3}, ValueError, "text: expected 3 numbers in row 2, got 1 words"),
    ({"num_columns": 0}, ValueError, "num_columns: expected a number > 0, got 0"),
    ({"num_columns": 3.0}, RuntimeError, "Expected a value of type 'int' for argument 'num_columns'"),
]
REFUSED = [
    {"text": LABELS},
    {"num_rows": -1},
    {"num_columns": 2**62},
]

_NUMBER = re.compile(r"[+-]?((\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?|inf|infinity|nan)", re.ASCII | re.IGNORECASE)


def parse_numbers_reference(text: Tensor, num_rows: int, num_columns: int) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.internal.parse_numbers` computes, with Python's own numbers.

    Raises:
        ValueError: as the operator; the message says less.
    """
    rest, rows, end = bytes(text.tolist()), [], 0
    for row in range(num_rows):
        line, feed, rest = rest.partition(b"\n")
        end += len(line) + len(feed)
        words = [word for word in re.split(r"[ \t\v\f\r]+", line.decode("latin-1")) if word]
        if len(words) != num_columns or not all(_NUMBER.fullmatch(word) for word in words):
            raise ValueError(f"text: expected {num_columns} numbers in row {row}")
        rows.append([float(word) for word in words])
    values = torch.tensor(rows, dtype=torch.float64).reshape(num_rows, num_columns)
    return values.T.contiguous(), torch.tensor([end])


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    num_rows = int(4_000_000 * share)
    text = torch.tensor(list(b"1.25 -3.5\n"), dtype=torch.uint8).repeat(num_rows)
    return lambda: parse_numbers(text, num_rows, 2)
