"""Step 5: what the image segmentations say about each edge of the point graph.

The evidence is two plain sums over images, v and the sum of overlaps, so frames can come in any order, be spread
over processes, and be added up.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.config import PropagationConfig
from torchjoint.visibility import Visible

#: Overlaps are rounded to multiples of this before they are summed: sums of up to 2^29 of them are then exact in
#: float64, so that the order of the frames cannot change a single bit.
OVERLAP_RESOLUTION = 2.0**-24


def label_windows(labels: Tensor, visible: Visible, window: int) -> Tensor:
    """The t x t labels around each visible point's pixel, clipped at the image's border.

    Args:
        labels: [H, W] int64, -1 = none.
        window: t, odd.

    Returns:
        [M, t*t] int64; -1 where there is no pixel or no label.
    """
    reach = window // 2
    padded = torch.nn.functional.pad(labels, (reach, reach, reach, reach), value=-1)
    # Row r of the image is row r + reach of the padded one, so a window starts at the pixel's own indices.
    steps = torch.arange(window)
    rows = visible.row[:, None, None] + steps[:, None]
    columns = visible.column[:, None, None] + steps[None, :]
    return padded[rows, columns].flatten(1)


def window_overlap(first: Tensor, second: Tensor) -> Tensor:
    """Overlap of two windows: histogram intersection / size of the smaller window (eq. 5).

    Pixels without a label (-1) are left out of a window's size.

    Args:
        first, second: [E, t*t] int64, -1 = none.

    Returns:
        [E] float64 in [0, 1]; NaN where a window has no label at all.
    """
    size = torch.minimum((first >= 0).sum(1), (second >= 0).sum(1)).double()
    # Most windows lie within one segment, where the intersection is all or nothing.
    uniform = (first == first[:, :1]).all(1) & (second == second[:, :1]).all(1)
    overlap = (first[:, 0] == second[:, 0]).double()
    mixed = torch.nonzero(~uniform).squeeze(1)
    overlap[mixed] = _intersection(first[mixed], second[mixed]).double() / size[mixed]
    overlap[size == 0] = torch.nan
    return overlap


def _intersection(first: Tensor, second: Tensor) -> Tensor:
    """Size of the histogram intersection of rows, sum over labels l of min(count of l in each), -1 left out."""
    total = torch.zeros(first.shape[0], dtype=torch.int64)
    for column in range(first.shape[1]):
        # A label's minimum is counted once, at its first occurrence in `first`.
        label = first[:, column : column + 1]
        is_first = ~(first[:, :column] == label).any(1) & (label[:, 0] >= 0)
        common = torch.minimum((first == label).sum(1), (second == label).sum(1))
        total += torch.where(is_first, common, 0)
    return total


def edge_overlaps(edge_index: Tensor, num_points: int, visible: Visible, windows: Tensor) -> tuple[Tensor, Tensor]:
    """One image's contribution to the sums.

    Args:
        edge_index: [2, E] of the point graph.
        windows: [M, t*t] of :func:`label_windows`.

    Returns:
        ([S] int64, [S] float64): the edges that the image has something to say about, ascending (both ends are
        visible and have a labelled window), and their overlaps, rounded to OVERLAP_RESOLUTION.
    """
    slot = torch.full((num_points,), -1, dtype=torch.int64)
    slot[visible.point] = torch.arange(visible.point.shape[0])
    first, second = slot[edge_index[0]], slot[edge_index[1]]
    seen = torch.nonzero((first >= 0) & (second >= 0)).squeeze(1)
    overlap = window_overlap(windows[first[seen]], windows[second[seen]])
    labelled = ~overlap.isnan()
    return seen[labelled], (overlap[labelled] / OVERLAP_RESOLUTION).round() * OVERLAP_RESOLUTION


def disagreement(views: Tensor, overlap_sum: Tensor, num_images: int, config: PropagationConfig) -> Tensor:
    """The images' disagreement r of each edge (eq. 6), in [0, 1]; 1 - r_o where no image sees both ends.

    With `normalization: all` the paper's letter, r = 1 - r_o + (v r_o - sum o) / L with L = `num_images`. In hundreds
    of images v / L is tiny and r nearly constant; `saturating` is r = 1 - r_o + min(v / s, 1) (r_o - sum o / v).

    Args:
        views: [E] v, number of images that see both ends.
        overlap_sum: [E] float64, sum of their overlaps.
        num_images: L, the number of images.

    Returns:
        [E] float32.
    """
    v = views.double()
    neutral = 1 - config.overlap_threshold
    if config.normalization == "all":
        return (neutral + (v * config.overlap_threshold - overlap_sum) / max(num_images, 1)).float()
    trust = (v / config.saturation).clamp(max=1)
    mean_overlap = overlap_sum / v.clamp(min=1)
    return (neutral + trust * (config.overlap_threshold - mean_overlap)).float()
