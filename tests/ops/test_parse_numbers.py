"""parse_numbers: by hand, and against its slow twin to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st
from reference.parse_numbers import parse_numbers_reference
from torch import Tensor

from torchjoint.ops.internal import parse_numbers

DIGITS = st.text("0123456789", max_size=25)
#: Numbers of all lengths and sizes, and words that nearly are numbers.
WORDS = st.one_of(
    st.floats().map(repr),
    st.floats(width=32).map(lambda value: f"{value:.8g}"),
    st.decimals(-10, 10, places=18).map(str),
    st.builds("{}{}{}{}{}".format, st.sampled_from(["", "-", "+"]), DIGITS, st.sampled_from(["", "."]), DIGITS,
              st.sampled_from(["", "", "e5", "E-7", "e+300", "e-330", "e99999999999", "e-99999999999"])),
    st.sampled_from(["nan", "-inf", "Infinity", "INF", "infinit", "nano", "0x1", "1_0", "1,5", "--1", "1e", ".", "\0"]),
)  # fmt: skip
BLANKS = st.sampled_from([" ", "\t", "  ", " \r", "\v\f"])


def as_text(text: str | bytes) -> Tensor:
    return torch.from_numpy(np.frombuffer(text.encode() if isinstance(text, str) else text, np.uint8).copy())


def outcome(function, *arguments) -> list[bytes] | str:
    try:
        return [one.numpy().tobytes() for one in function(*arguments)]
    except ValueError as error:
        return str(error).split("got")[0].replace("a word is no number: ", "").strip(", ")


@few_and_many(
    100,
    700,
    lines=st.lists(st.lists(WORDS, max_size=4), max_size=4),
    blank=BLANKS,
    num_rows=st.integers(0, 4),
    num_columns=st.integers(1, 4),
)
def test_against_the_slow_twin(lines: list[list[str]], blank: str, num_rows: int, num_columns: int) -> None:
    text = as_text("\n".join(blank + blank.join(words) for words in lines))
    expected = outcome(parse_numbers_reference, text, num_rows, num_columns)
    got = outcome(parse_numbers, text, num_rows, num_columns)
    if isinstance(got, str) and got.startswith(f"text: expected {num_rows} rows"):  # too short: told without reading
        assert isinstance(expected, str)
    else:
        assert got == expected


@few_and_many(100, 700, words=st.lists(WORDS, min_size=1, max_size=20))
def test_a_column_of_numbers(words: list[str]) -> None:
    """Most are numbers, so that values are compared more often than errors."""
    numbers = [word for word in words if isinstance(outcome(parse_numbers_reference, as_text(word), 1, 1), list)]
    text = as_text("\n".join(numbers) + "\n")
    assert outcome(parse_numbers, text, len(numbers), 1) == outcome(parse_numbers_reference, text, len(numbers), 1)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2\n3 x\n", "text: a word is no number: expected 2 numbers in row 1, got 'x' at byte 6"),
        ("1 2\n3 4-5\n", "got '4-5' at byte 6"),
        ("1 2\n3 \x01é" + "y" * 90 + "\n", f"got '???{'y' * 37}' at byte 6"),
        ("1 2\n\n3 4\n", "text: expected 2 numbers in row 1, got 0 words"),
        ("1 2\n3 4 5 6\n", "text: expected 2 numbers in row 1, got 4 words"),
        ("1 2\n3     ", "text: expected 2 numbers in row 1, got 1 words"),
        ("1 2", "text: expected 2 rows of 2 numbers, got 3 bytes"),
    ],
)
def test_errors_say_where(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message.replace("?", r"\?")):
        parse_numbers(as_text(text), 2, 2)


def test_sizes_are_checked_before_memory_is_allocated() -> None:
    for num_rows, num_columns in ((2**40, 3), (3, 2**40), (2**62, 2**62), (2**63 - 1, 1)):
        with pytest.raises(ValueError, match=f"expected {num_rows} rows of {num_columns} numbers, got 6 bytes"):
            parse_numbers(as_text("1 2 3\n"), num_rows, num_columns)


def test_nothing_behind_the_rows_is_read() -> None:
    text = as_text("1\r\n2\r\nxyz")
    values, end = parse_numbers(text, 2, 1)
    assert values.tolist() == [[1, 2]]
    assert bytes(text[end.item() :].tolist()) == b"xyz"
