"""Features of a patch: channel values, and differences of a channel between two cells of a coarse grid."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from torchjoint.images.forest import NUM_FEATURES
from torchjoint_lab.training.channels import NUM_CHANNELS, Channels

Ints = NDArray[np.int64]
T = TypeVar("T", bound=np.generic)

#: Side of a patch, in channel cells; a cell is two pixels wide.
PATCH_CELLS = 16
#: Features below this number are single values: (channel, column, row) of the patch; the row varies fastest.
NUM_REGULAR = NUM_CHANNELS * PATCH_CELLS**2

#: Rows and columns of the 5 x 5 cells whose differences are features: (channel, pair a < b), cells column by column.
_GRID = np.array([1, 4, 8, 11, 14])
_CELLS = np.array([(row, column) for column in _GRID for row in _GRID])
_FIRST, _SECOND = np.triu_indices(len(_CELLS), 1)
NUM_PAIRS = len(_FIRST)
assert NUM_REGULAR + NUM_CHANNELS * NUM_PAIRS == NUM_FEATURES


def sites(channels: Channels) -> tuple[Ints, Ints]:
    """Returns the first cells (rows, columns), [S] each, of all patches that OpenCV's detector evaluates."""
    height, width = (max(0, size - PATCH_CELLS) for size in channels.regular.shape[1:])
    rows, columns = np.divmod(np.arange(height * width), max(width, 1))
    return rows, columns


def feature_channels(features: Ints) -> Ints:
    """Returns the kind of each feature: a channel (0-12), or differences of a channel (13-25)."""
    similarity = NUM_CHANNELS + (features - NUM_REGULAR) // NUM_PAIRS
    return np.where(features < NUM_REGULAR, features // PATCH_CELLS**2, similarity)


def regular_values(channels: NDArray[T], rows: Ints, columns: Ints, features: Ints) -> NDArray[T]:
    """Returns values of features below NUM_REGULAR in `channels` [13, H, W]; the other arguments are broadcast."""
    height, width = channels.shape[1:]
    channel, cell = np.divmod(features, PATCH_CELLS**2)
    column, row = np.divmod(cell, PATCH_CELLS)
    return channels.reshape(-1).take((channel * height + row) * width + column + (rows * width + columns))


def similarity_values(channels: NDArray[np.float32], rows: Ints, columns: Ints, features: Ints) -> NDArray[np.float32]:
    """Returns values of features from NUM_REGULAR on; arguments as for :func:`regular_values`."""
    height, width = channels.shape[1:]
    channel, pair = np.divmod(features - NUM_REGULAR, NUM_PAIRS)
    values = channels.reshape(-1)
    place = rows * width + columns
    ends = (_CELLS[cells[pair]] for cells in (_FIRST, _SECOND))
    first, second = (values.take((channel * height + end[..., 0]) * width + end[..., 1] + place) for end in ends)
    return first - second


def feature_values(channels: Channels, rows: Ints, columns: Ints, features: Ints) -> NDArray[np.float32]:
    """Returns values of any features, one feature at each of the sites (rows, columns): all [S]."""
    values = np.empty(len(features), np.float32)
    is_regular = features < NUM_REGULAR
    for mine, maps, function in (
        (is_regular, channels.regular, regular_values),
        (~is_regular, channels.similarity, similarity_values),
    ):
        values[mine] = function(maps, rows[mine], columns[mine], features[mine])
    return values
