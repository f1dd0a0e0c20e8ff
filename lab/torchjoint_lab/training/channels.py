"""Computes the 13 image channels of a structured forest, equal to the channels of OpenCV's detector.

OpenCV can also run the forests trained here, but gives no access to its features, so this module reimplements them with
OpenCV's own filters; they agree with those of `ops.structured_forest`. P. Dollár and C. L. Zitnick, "Fast Edge
Detection Using Structured Forests" (PAMI 2015).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

#: Channels at half the image's size: L, u, v; then for the image at full and half size: magnitude, 4 orientations.
NUM_CHANNELS = 13
NUM_ORIENTATIONS = 4
#: The image is padded by this many pixels on each side, so that patches may cross its border.
PADDING = 8
SHRINK = 2
REGULAR_RADIUS, SIMILARITY_RADIUS, NORMALIZATION_RADIUS = 1, 4, 4  #: of the triangle filters, in cells

_XYZ_FROM_RGB = np.array(
    [[0.430574, 0.341550, 0.178325], [0.222015, 0.706655, 0.071330], [0.020183, 0.129553, 0.939180]], np.float32
)


class Channels(NamedTuple):
    """Both maps are [13, H / 2, W / 2], of the padded image."""

    regular: Array  #: weakly smoothed, for features that are single values
    similarity: Array  #: strongly smoothed, for features that are differences of cells


def image_channels(image: Array) -> Channels:
    """Computes the channels of an image [H, W, 3] float32, RGB in [0, 1]."""
    padded = cv2.copyMakeBorder(image, PADDING, PADDING, PADDING, PADDING, cv2.BORDER_REFLECT)
    luv = rgb_to_luv(np.asarray(padded, np.float32))
    half = _resized_size(luv, 1 / SHRINK)
    channels = [_resize(luv, half)]
    for scale in (1.0, 0.5):
        scaled = luv if scale == 1 else _resize(luv, _resized_size(luv, scale))
        magnitude, histogram = _gradient_histogram(scaled, max(1, int(SHRINK * scale)))
        channels += [_resize(magnitude, half)[..., None], _resize(histogram, half)]
    stacked = np.concatenate(channels, axis=2)
    regular, similarity = (triangle_filter(stacked, radius) for radius in (REGULAR_RADIUS, SIMILARITY_RADIUS))
    return Channels(*(np.ascontiguousarray(np.moveaxis(values, 2, 0)) for values in (regular, similarity)))


def rgb_to_luv(image: Array) -> Array:
    """Converts RGB to CIE Luv with a table of 1024 lightnesses (white is one step too low), all about in [0, 1]."""
    red, green, blue = np.moveaxis(image, 2, 0)
    # No matrix product, since its rounding depends on the order of summation.
    x, y, z = ((a * red + b * green) + c * blue for a, b, c in _XYZ_FROM_RGB)
    lightness = _lightness_table()[np.clip((1024 * y).astype(np.int64), 0, 1023)]
    n = 1 / (x + 15 * y + 3 * z + np.float32(1e-35))
    u = lightness * (52 * x * n - np.float32(13 * 0.197833)) + np.float32(88 / 270)
    v = lightness * (117 * y * n - np.float32(13 * 0.468331)) + np.float32(134 / 270)
    return np.stack([lightness, u, v], axis=2).astype(np.float32)


def _lightness_table() -> Array:
    y = np.arange(1024) / 1024
    return (np.where(y > 8 / (29**3 / 27), 116 * np.cbrt(y) - 16, y * 29**3 / 27) / 270).astype(np.float32)


def _gradient_histogram(image: Array, cell: int) -> tuple[Array, Array]:
    """Normalised gradient magnitude [H, W] of the channel where it is largest; its orientations, summed over cells."""
    right = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1, borderType=cv2.BORDER_REFLECT)
    down = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=1, borderType=cv2.BORDER_REFLECT)
    squared = right * right + down * down
    best = squared.argmax(axis=2)[..., None]
    dx, dy, squared = (np.take_along_axis(values, best, axis=2)[..., 0] for values in (right, down, squared))
    magnitude = np.sqrt(squared)
    phase = cv2.phase(dx, dy, angleInDegrees=True) / 180
    phase = np.where(dy < 0, phase - 1, phase)
    phase = np.where((np.abs(dx) < 1e-5) & (np.abs(dy) < 1e-5), 0.5, phase)
    magnitude = magnitude / (triangle_filter(magnitude, NORMALIZATION_RADIUS) + np.float32(0.01))

    return magnitude, _cell_sums(magnitude / np.float32(cell**2), phase.astype(np.float32), cell)


def _cell_sums(magnitude: Array, phase: Array, cell: int) -> Array:
    """Sums of magnitude over square cells by hard orientation: [ceil(H / cell), ceil(W / cell), 4]."""
    height, width = magnitude.shape
    orientation = np.rint(phase * NUM_ORIENTATIONS) % NUM_ORIENTATIONS
    parts = np.where(orientation[..., None] == np.arange(NUM_ORIENTATIONS), magnitude[..., None], np.float32(0))
    parts = np.pad(parts, ((0, -height % cell), (0, -width % cell), (0, 0)))
    sums = np.zeros_like(parts[::cell, ::cell])
    for row in range(cell):  # in pixel order, since float32 sums depend on the order
        for column in range(cell):
            sums += parts[row::cell, column::cell]
    return sums


def triangle_filter(image: Array, radius: int) -> Array:
    """Filters an image [H, W] or [H, W, C] with weights that fall linearly with distance; radius in pixels."""
    if radius <= 1:
        kernel = np.array([1, 12 / radius / (radius + 2) - 2, 1])
        kernel /= kernel.sum()
    else:
        rise = np.arange(1, radius + 1)
        kernel = np.concatenate([rise, [radius + 1], rise[::-1]]) / (radius + 1) ** 2
    kernel = kernel.astype(np.float32)
    return np.asarray(cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101), np.float32)


def _resized_size(image: Array, scale: float) -> tuple[int, int]:
    """(width, height); halves are rounded to even, as in OpenCV."""
    return int(np.rint(image.shape[1] * scale)), int(np.rint(image.shape[0] * scale))


def _resize(image: Array, size: tuple[int, int]) -> Array:
    if (image.shape[1], image.shape[0]) == size:
        return image
    shrinks = size[0] < image.shape[1] and size[1] < image.shape[0]
    return np.asarray(
        cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR), np.float32
    )
