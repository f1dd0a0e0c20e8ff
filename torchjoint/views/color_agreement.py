"""Check before step 4: do the colours of the points fit the images better than chance?

The colours of two sensors differ by exposure and noise. So the residual is compared with that in shifted images. If the
poses are right, a shift makes the residual clearly larger. If they are wrong, it makes no difference.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

#: Shifts in twelve directions, as shares of the image's longer side.
COLOR_SHIFTS = [
    (radius * math.sin(math.pi * step / 6), radius * math.cos(math.pi * step / 6))
    for step, radius in enumerate((0.05, 0.07, 0.09, 0.11) * 3)
]

#: Smallest number of points to compare.
LEAST_POINTS = 30
#: If there are more points, every k-th is compared. The mean of 10,000 colours errs by a hundredth of their spread.
MOST_POINTS = 10_000


class ColorAgreement(NamedTuple):
    """Colours of points against those of an image; all NaN if too few points are in view."""

    residual: float = math.nan  #: mean |colour of a point - colour of its pixel|
    by_chance: float = math.nan  #: the same in shifted images
    correlation: float = math.nan  #: correlation of the two colours, -1 to 1


def color_agreement(colors: Tensor, image: Tensor, row: Tensor, column: Tensor) -> ColorAgreement:
    """Compares the colours of M visible points with the colours of their pixels.

    Args:
        colors: [M, 3] RGB in [0, 1].
        image: [3, H, W] RGB in [0, 1].
        row: [M] int64, row of each point's pixel.
        column: [M] int64, column of this pixel.
    """
    if len(colors) < LEAST_POINTS:
        return ColorAgreement()
    step = math.ceil(len(colors) / MOST_POINTS)
    colors, row, column = colors[::step], row[::step], column[::step]
    height, width = image.shape[1:]
    seen = image[:, row, column].T
    shifted = []
    for down, right in COLOR_SHIFTS:
        there = row + round(down * max(height, width)), column + round(right * max(height, width))
        inside = (there[0] >= 0) & (there[0] < height) & (there[1] >= 0) & (there[1] < width)
        if int(inside.sum()) >= LEAST_POINTS:
            pixels = image[:, there[0][inside], there[1][inside]].T
            shifted.append(float((colors[inside] - pixels).abs().mean()))
    by_chance = sum(shifted) / len(shifted) if shifted else math.nan
    return ColorAgreement(
        float((colors - seen).abs().mean()), by_chance, float(correlation(colors.double(), seen.double()))
    )


def correlation(first: Tensor, second: Tensor) -> Tensor:
    """The correlation of two tensors of one shape, each without the mean of its columns; 0 if one is constant."""
    first, second = first - first.mean(0), second - second.mean(0)
    size = (first.square().sum() * second.square().sum()).sqrt()
    return (first * second).sum() / size if float(size) > torch.finfo(torch.float32).tiny else size.new_zeros(())
