"""Run lengths: strings that pycocotools wrote, any mask there and back, and every way in which they can be damaged."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.masks.rle import rle_pixels


def decode_rle(rle):
    size, pixels = rle_pixels(rle)
    mask = torch.zeros(size, dtype=torch.bool)
    mask.view(-1)[torch.from_numpy(pixels)] = True
    return mask


def small():
    """A mask of 7 x 9 pixels, and what pycocotools 2.0 makes of it: compressed, and uncompressed."""
    mask = torch.zeros(7, 9, dtype=torch.bool)
    mask[1:4, 2:6] = mask[5, 8] = mask[0, 0] = True
    return mask, "01>2F00000b0N[O", [0, 1, 14, 3, 4, 3, 4, 3, 4, 3, 22, 1, 1]


def counts_of(mask):
    """Run lengths by counting, pixel after pixel."""
    counts, inside = [0], False
    for value in mask.T.reshape(-1).tolist():
        if value != inside:
            counts.append(0)
            inside = value
        counts[-1] += 1
    return counts


def compressed(counts):
    """COCO's string: the numbers, from the third on minus that two before, in groups of 5 bits."""
    text = ""
    for index, count in enumerate(counts):
        number = count - counts[index - 2] if index > 2 else count
        while True:
            bits, number = number & 31, number >> 5
            goes_on = number != (-1 if bits & 16 else 0)
            text += chr(48 + bits + 32 * goes_on)
            if not goes_on:
                break
    return text


def test_strings_of_pycocotools():
    mask, text, counts = small()
    for form in (text, text.encode(), counts, np.array(counts).tolist()):
        assert torch.equal(decode_rle({"size": [7, 9], "counts": form}), mask)
    assert compressed(counts) == text


def test_longer_strings_of_pycocotools():
    mask = torch.zeros(60, 20, dtype=torch.bool)
    mask[10:50, 5:17] = True
    mask[20:30, 8:12] = False
    text = "f9X1d00000ROF::FF::FF::FF::d000000000Z5"
    assert torch.equal(decode_rle({"size": [60, 20], "counts": text}), mask)
    assert compressed(counts_of(mask)) == text


@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 10**6), st.floats(0, 1))
def test_any_mask_there_and_back(height, width, seed, share):
    mask = torch.from_numpy(np.random.default_rng(seed).random((height, width)) < share)
    counts = counts_of(mask)
    assert torch.equal(decode_rle({"size": [height, width], "counts": counts}), mask)
    assert torch.equal(decode_rle({"size": (height, width), "counts": compressed(counts)}), mask)


@pytest.mark.parametrize(
    ("rle", "message"),
    [
        ({"size": [7, 9]}, "expected run lengths with size and counts, got entries size"),
        ({"size": [7], "counts": [63]}, r"size: expected two integers \[H, W\] of at least 1, got \[7\]"),
        ({"size": [7, -9], "counts": [63]}, r"size: expected two integers \[H, W\] of at least 1"),
        ({"size": [7.0, 9.0], "counts": [63]}, "size: expected two integers"),
        ({"size": [10**6, 10**6], "counts": [10**12]}, "size: 1000000 x 1000000 pixels are too many"),
        ({"size": [7, 9], "counts": [60]}, "counts: expected a sum of 7 x 9 = 63 pixels, got 60"),
        ({"size": [7, 9], "counts": [70, -7]}, "counts: expected numbers >= 0, got -7"),
        ({"size": [7, 9], "counts": [62.5, 0.5]}, "counts: expected a string or a list of integers, got list"),
        ({"size": [7, 9], "counts": "01>2F00000b0N["}, "counts: truncated, the last number is incomplete"),
        ({"size": [7, 9], "counts": "01>2F00000b0N"}, "counts: expected a sum of 7 x 9 = 63 pixels, got 62"),
        ({"size": [7, 9], "counts": "01>2 00000b0N[O"}, "counts: expected characters from '0' to 'o', got ' '"),
    ],
)
def test_damage_is_named(rle, message):
    with pytest.raises((ValueError, TypeError), match=message):
        decode_rle(rle)
