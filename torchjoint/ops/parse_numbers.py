"""Reads numbers from text, for files of clouds."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def parse_numbers(text: Tensor, num_rows: int, num_columns: int) -> tuple[Tensor, Tensor]:
    r"""Read the numbers of the first ``num_rows`` lines of a text; every character of these lines is checked.

    Words are separated by blanks (space, tab, vertical tab, form feed, carriage return), lines by a line feed. A number
    is decimal with an optional sign, point and exponent, or ``nan``, ``inf`` or ``infinity`` in small letters or
    capitals. It is rounded to the nearest float64, ties to even. Locale and number of threads have no influence.

    Args:
        text: ``[B]`` uint8, ASCII characters.
        num_rows: lines to read, >= 0. The text after them is ignored.
        num_columns: numbers in each line, > 0.

    Returns:
        ``values`` ``[num_columns, num_rows]`` float64, and ``end`` ``[1]`` int64, the number of characters that were
        read: the lines with their line feeds; the last line feed may be missing.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device; a line that does not have ``num_columns`` words; a word that is no number
            (the message gives row and position); a ``text`` that is too short for so many numbers (this is checked
            before memory is allocated).

    Example:
        >>> import torch
        >>> text = torch.tensor(list(b"1 2.5\n-3e1 nan\nrest"), dtype=torch.uint8)
        >>> parse_numbers(text, num_rows=2, num_columns=2)
        (tensor([[  1.0000, -30.0000],
                [  2.5000,      nan]], dtype=torch.float64), tensor([15]))
    """
    check_array("text", text, torch.uint8, (None,), "[B]")
    check_number("num_rows", num_rows, (int,))
    check_number("num_columns", num_columns, (int,))
    result = call(torch.ops.torchjoint.parse_numbers.default, text, num_rows, num_columns)
    return cast(tuple[Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::parse_numbers")
def _fake(text: Tensor, num_rows: int, num_columns: int) -> tuple[Tensor, Tensor]:
    return text.new_empty(num_columns, num_rows, dtype=torch.float64), text.new_empty(1, dtype=torch.int64)
