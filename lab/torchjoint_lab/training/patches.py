"""Samples training patches from annotated images: quantised features, and the segmentation in the patch's middle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from torchjoint.images.forest import LABEL_SIZE, NUM_FEATURES, padded
from torchjoint_lab.datasets.bsds import BsdsImage
from torchjoint_lab.training.channels import NUM_CHANNELS, SHRINK, Channels, image_channels
from torchjoint_lab.training.features import (
    NUM_REGULAR,
    Ints,
    feature_channels,
    feature_values,
    regular_values,
    similarity_values,
    sites,
)

#: A site is positive if the distance from its middle to a boundary is smaller than this, pixels.
POSITIVE_DISTANCE = 8
#: Number of quantisation codes of a feature value; the borders between codes are the possible thresholds.
NUM_CODES = 256
#: Size of the lookup table that quantises differences, over the range of the borders.
_TABLE_SIZE = 2**14
_SITES_FOR_BORDERS = 2000


class Samples(NamedTuple):
    """S patches; label pixels are in column-major order, as in OpenCV."""

    codes: NDArray[np.uint8]  #: [F, S] of the features
    segments: NDArray[np.uint16]  #: [S, 256] segment id of each label pixel


class FeatureCodes:
    """Quantises feature values: the code of a value is the number of borders (of 255) that are at most the value.

    Attributes:
        borders: [26, 255] float32, ascending, for the values of the 13 channels, then for the differences in each.
    """

    def __init__(self, borders: NDArray[np.float32]) -> None:
        self.borders = borders
        self._low = borders[NUM_CHANNELS:, 0]
        self._step = (borders[NUM_CHANNELS:, -1] - self._low).clip(min=1e-12) / (_TABLE_SIZE - 1)
        middles = self._low[:, None] + self._step[:, None] * np.arange(_TABLE_SIZE)
        self._tables = np.stack([_codes(*pair) for pair in zip(borders[NUM_CHANNELS:], middles, strict=True)])

    @classmethod
    def of_images(cls, images: Sequence[BsdsImage], rng: np.random.Generator) -> FeatureCodes:
        """Computes borders as quantiles of the values in some of the images, so that codes are equally frequent."""
        found: list[list[NDArray[np.float32]]] = [[] for _ in range(2 * NUM_CHANNELS)]
        for image in images[:: max(1, len(images) // 50)]:
            channels = image_channels(padded(_pixels(image)))
            rows, columns = sites(channels)
            for kind, values in enumerate(found):
                some = rng.integers(0, len(rows), _SITES_FOR_BORDERS)
                low, high = _features_of_kind(kind)
                features = rng.integers(low, high, _SITES_FOR_BORDERS)
                values.append(feature_values(channels, rows[some], columns[some], features))
        shares = np.arange(1, NUM_CODES) / NUM_CODES
        return cls(np.stack([np.quantile(np.concatenate(values), shares) for values in found]).astype(np.float32))

    def thresholds(self, features: Ints, codes: Ints) -> NDArray[np.float32]:
        """Returns thresholds in feature values: a value is below the threshold if its code is at most `codes`."""
        return self.borders[feature_channels(features), np.minimum(codes, NUM_CODES - 2)]

    def of_sites(self, channels: Channels, rows: Ints, columns: Ints, features: Ints) -> NDArray[np.uint8]:
        """Returns codes [F, S] of `features` [F], ascending, at the sites (rows, columns), [S] each."""
        regular, similarity = np.split(features, [np.searchsorted(features, NUM_REGULAR)])
        maps = [_codes(border, values) for border, values in zip(self.borders, channels.regular, strict=False)]
        codes = np.empty((len(features), len(rows)), np.uint8)
        codes[: len(regular)] = regular_values(np.stack(maps), rows, columns, regular[:, None])
        kinds = feature_channels(similarity) - NUM_CHANNELS
        for kind in range(NUM_CHANNELS):
            mine = np.flatnonzero(kinds == kind)
            values = similarity_values(channels.similarity, rows, columns, similarity[mine, None])
            values -= self._low[kind]
            values *= 1 / self._step[kind]
            values.clip(0, _TABLE_SIZE - 1, out=values)
            codes[len(regular) + mine] = self._tables[kind].take((values + np.float32(0.5)).astype(np.int16))
        return codes


def draw_samples(
    images: Sequence[BsdsImage],
    codes: FeatureCodes,
    features: Ints,
    count: int,
    rng: np.random.Generator,
    each_image: Callable[[], object] = lambda: None,
) -> Samples:
    """Samples about `count` patches, half of them near boundaries, spread evenly over images and their annotators.

    Each image is mirrored with probability 1/2. If an annotator has too few sites of a kind, fewer are drawn.

    Args:
        images: images to sample from.
        codes: quantises features.
        features: [F] indices of the features, ascending.
        count: largest number of samples, S.
        rng: source of all random choices.
        each_image: called after each image.
    """
    all_codes = np.empty((len(features), count), np.uint8)
    segments = []
    done = 0
    for index, image in enumerate(images):
        mirror = rng.random() < 0.5
        channels = image_channels(padded(_mirrored(_pixels(image), mirror)))
        maps = [padded(_mirrored(one.numpy().astype(np.uint16), mirror)) for one in image.segmentations]
        budget = (count - done) // (len(images) - index)
        drawn = [_draw_sites(one, channels, budget // len(maps) // 2, rng) for one in maps]
        for one, (rows, columns) in zip(maps, drawn, strict=True):
            segments.append(_label_patches(one, rows, columns))
        rows, columns = (np.concatenate(parts) for parts in zip(*drawn, strict=True))
        all_codes[:, done : done + len(rows)] = codes.of_sites(channels, rows, columns, features)
        done += len(rows)
        each_image()
    return Samples(all_codes[:, :done], np.concatenate(segments))


def segmentation_boundaries(segments: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Returns [H, W] bool: left and right, or upper and lower, neighbours differ in segment: lines of two pixels."""
    padded = np.pad(segments, 1, mode="edge")
    across = padded[1:-1, 2:] != padded[1:-1, :-2]
    down = padded[2:, 1:-1] != padded[:-2, 1:-1]
    return across | down


def segmentation_lines(segments: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Returns [H, W] bool: the right or lower neighbour is in another segment: lines of one pixel."""
    lines = np.zeros(segments.shape, bool)
    lines[:, :-1] |= segments[:, :-1] != segments[:, 1:]
    lines[:-1] |= segments[:-1] != segments[1:]
    return lines


def _draw_sites(
    segments: NDArray[np.uint16], channels: Channels, count: int, rng: np.random.Generator
) -> tuple[Ints, Ints]:
    """(rows, columns) of `count` sites near a boundary, then of `count` sites far from boundaries."""
    rows, columns = sites(channels)
    distance = cv2.distanceTransform((~segmentation_boundaries(segments)).astype(np.uint8), cv2.DIST_L2, 5)
    middle = LABEL_SIZE // 2
    is_near = distance[SHRINK * rows + middle, SHRINK * columns + middle] < POSITIVE_DISTANCE
    places = [np.flatnonzero(kind) for kind in (is_near, ~is_near)]
    chosen = np.concatenate([rng.choice(some, min(count, len(some)), replace=False) for some in places])
    return rows[chosen], columns[chosen]


def _label_patches(values: NDArray[np.generic], rows: Ints, columns: Ints) -> NDArray[np.generic]:
    """[S, 256]: the label pixels of each site."""
    column, row = np.divmod(np.arange(LABEL_SIZE**2), LABEL_SIZE)
    return values[SHRINK * rows[:, None] + row, SHRINK * columns[:, None] + column]


def _codes(borders: NDArray[np.float32], values: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.searchsorted(borders, values, side="right").astype(np.uint8)


def _features_of_kind(kind: int) -> tuple[int, int]:
    ends = np.flatnonzero(np.diff(feature_channels(np.arange(NUM_FEATURES)), prepend=-1, append=-1))
    return int(ends[kind]), int(ends[kind + 1])


def _pixels(image: BsdsImage) -> NDArray[np.float32]:
    return np.ascontiguousarray(image.image.permute(1, 2, 0).numpy())


def _mirrored(values: NDArray[np.generic], mirror: bool) -> NDArray[np.generic]:
    return np.ascontiguousarray(values[:, ::-1]) if mirror else values
