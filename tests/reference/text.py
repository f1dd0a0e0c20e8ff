"""Reference version of the operator on text; shapes are those of the operator."""

from __future__ import annotations

import re

import torch
from torch import Tensor

_NUMBER = re.compile(r"[+-]?((\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?|inf|infinity|nan)", re.ASCII | re.IGNORECASE)


def parse_numbers_reference(text: Tensor, num_rows: int, num_columns: int) -> tuple[Tensor, Tensor]:
    """What :func:`torchjoint.ops.parse_numbers` computes, with Python's own numbers.

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
