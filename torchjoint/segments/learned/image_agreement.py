"""Step 6, method learned: measures whether the images show two regions in the same image segments.

Each image segment contains some share of a region's visible points. The agreement of two regions in an image is the sum
of the smaller of their two shares over all segments (histogram intersection).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.runtime.sorted_groups import find, members_of_groups
from torchjoint.runtime.threads import num_threads, parallel_map
from torchjoint.segments.learned.image_counts import ImageCounts
from torchjoint.segments.learned.summaries import sum_by
from torchjoint.views.propagation import OVERLAP_RESOLUTION

#: An image counts for a region only if it sees at least this many points of the region.
MIN_POINTS = 3
#: Number of values of :func:`image_agreement`.
NUM_VALUES = 8


#: Largest number of frames, and of pairs (piece, image segment), that one block holds, so that memory does not grow
#: with the number of frames.
FRAMES, ROWS = 32, 1 << 18


class _Sums(NamedTuple):
    """The evidence of some frames about R regions and B pairs of regions.

    All values are sums of whole numbers, or extremes, so frames can be added in any order.
    """

    best: Tensor  #: [R] float64, best overlap with an image segment
    best_union: Tensor  #: [B] float64, best overlap of the union
    common: Tensor  #: [B] int64, sum of agreement x product
    product: Tensor  #: [B] int64, sum of the products of both numbers of visible points
    rounded: Tensor  #: [B] int64, sum of the agreements, in units of OVERLAP_RESOLUTION
    squares: Tensor  #: [B] int64, sum of their squares
    views: Tensor  #: [B] int64, number of images that see both
    low: Tensor  #: [B] float64, smallest agreement
    high: Tensor  #: [B] float64, largest agreement

    def plus(self, other: _Sums) -> _Sums:
        """The evidence of the frames of both."""
        added = {name: getattr(self, name) + getattr(other, name) for name in _ADDED}
        larger = {name: torch.maximum(getattr(self, name), getattr(other, name)) for name in _LARGEST}
        return _Sums(low=torch.minimum(self.low, other.low), **added, **larger)


_ADDED, _LARGEST = ("common", "product", "rounded", "squares", "views"), ("best", "best_union", "high")


def image_agreement(images: ImageCounts, of_piece: Tensor, num_regions: int, pairs: Tensor) -> Tensor:
    """Measures how far the images show two regions as one, for each pair of regions.

    Args:
        images: the image segments in which the pieces lie.
        of_piece: [P] int64, region of each piece.
        num_regions: R.
        pairs: [2, B] int64, pairs of regions.

    Returns:
        [B, NUM_VALUES] float64: agreement over all images, weighted by the products of visible points; its mean over
        the images; its standard deviation; log(1 + number of images that see both); the gain of the union in best
        overlap (intersection over union) with an image segment, over the better region; best overlap of the better
        region, and of the other; range of the agreement. NaN where no image sees both regions.
    """
    blocks = _blocks(images)
    parallel = num_threads()  # one block per thread is in memory
    sums = None
    for start in range(0, len(blocks), parallel):
        found = parallel_map(lambda block: _sums(block, of_piece, num_regions, pairs), blocks[start : start + parallel])
        for one in found:
            sums = one if sums is None else sums.plus(one)
    assert sums is not None  # there is at least one frame
    views = sums.views.double()
    mean = sums.rounded.double() * OVERLAP_RESOLUTION / views
    mean_square = sums.squares.double() * OVERLAP_RESOLUTION**2 / views
    better, worse = torch.maximum(*sums.best[pairs]), torch.minimum(*sums.best[pairs])
    return torch.stack(
        [
            sums.common.double() / sums.product,
            mean,
            (mean_square - mean.square()).clamp(min=0).sqrt(),
            torch.log1p(views),
            sums.best_union - better,
            better,
            worse,
            torch.where(sums.views > 0, sums.high - sums.low, torch.nan),
        ],
        dim=1,
    )


def _blocks(images: ImageCounts) -> list[ImageCounts]:
    """Splits the counts into blocks of consecutive frames."""
    frame_of_row = images.frame_of_segment[images.segment.long()]  # ascending
    frames = torch.arange(images.num_frames + 1)
    first_row, first_segment = (torch.searchsorted(of, frames) for of in (frame_of_row, images.frame_of_segment))
    blocks, start = [], 0
    while start < images.num_frames:
        end = int(torch.searchsorted(first_row, first_row[start] + ROWS, right=True)) - 1
        end = max(start + 1, min(end, start + FRAMES, images.num_frames))
        rows, segments = (slice(int(first[start]), int(first[end])) for first in (first_row, first_segment))
        blocks.append(
            ImageCounts(
                images.piece[rows],
                images.segment[rows] - first_segment[start],
                images.num_points[rows],
                images.segment_size[segments],
                images.frame_of_segment[segments] - start,
                end - start,
            )
        )
        start = end
    return blocks


def _sums(images: ImageCounts, of_piece: Tensor, num_regions: int, pairs: Tensor) -> _Sums:
    num_segments, num_frames, num_pairs = len(images.segment_size), images.num_frames, pairs.shape[1]
    # Rows (region, segment) and views (region, frame), both sorted. All counts are whole numbers, so sums are exact.
    row, inverse = torch.unique(of_piece[images.piece.long()] * num_segments + images.segment, return_inverse=True)
    count = sum_by(inverse, images.num_points.long(), len(row))
    of_region, segment = row // max(num_segments, 1), row % max(num_segments, 1)
    frame = images.frame_of_segment[segment]
    view, of_view = torch.unique(of_region * num_frames + frame, return_inverse=True)
    seen_in_view = sum_by(of_view, count, len(view))
    seen = seen_in_view[of_view]
    size = images.segment_size[segment]
    overlap = torch.where(seen >= MIN_POINTS, count.double() / (seen + size - count), 0.0)
    best = torch.zeros(num_regions, dtype=torch.float64).scatter_reduce_(0, of_region, overlap, "amax")

    # For each pair, the rows of the region with fewer rows are searched among the rows of the other region.
    num_rows = torch.bincount(of_region, minlength=num_regions)
    fewer = num_rows[pairs[0]] > num_rows[pairs[1]]
    one, other = torch.where(fewer, pairs[1], pairs[0]), torch.where(fewer, pairs[0], pairs[1])

    pair, first = members_of_groups(num_rows, one)
    second, found = find(row, other[pair] * num_segments + segment[first])
    pair, first, second = pair[found], first[found], second[found]
    enough = (seen[first] >= MIN_POINTS) & (seen[second] >= MIN_POINTS)
    pair, first, second = pair[enough], first[enough], second[enough]
    common = torch.minimum(count[first] * seen[second], count[second] * seen[first])
    both = count[first] + count[second]
    union = both.double() / (seen[first] + seen[second] + size[first] - both)
    best_union = torch.zeros(num_pairs, dtype=torch.float64).scatter_reduce_(0, pair, union, "amax")

    view_pair, view_first = members_of_groups(torch.bincount(view // num_frames, minlength=num_regions), one)
    view_second, found = find(view, other[view_pair] * num_frames + view[view_first] % num_frames)
    found = found & (seen_in_view[view_first] >= MIN_POINTS)
    found = torch.nonzero(found).squeeze(1)
    found = found[seen_in_view[view_second[found]] >= MIN_POINTS]
    view_pair, view_first, view_second = view_pair[found], view_first[found], view_second[found]
    product = seen_in_view[view_first] * seen_in_view[view_second]
    # Sorted by pair and frame, because the views of each region are.
    key = view_pair * num_frames + view[view_first] % num_frames
    in_view, _ = find(key, pair * num_frames + frame[first])
    common_in_view = sum_by(in_view, common, len(key))

    agreement = common_in_view.double() / product
    rounded = (agreement / OVERLAP_RESOLUTION).round().long()
    low, high = (
        torch.full((num_pairs,), start, dtype=torch.float64).scatter_reduce_(0, view_pair, agreement, reduce)
        for start, reduce in ((torch.inf, "amin"), (-torch.inf, "amax"))
    )
    return _Sums(
        best,
        best_union,
        sum_by(view_pair, common_in_view, num_pairs),
        sum_by(view_pair, product, num_pairs),
        # Whole multiples of the resolution, so that the sums are exact in any order of the frames.
        sum_by(view_pair, rounded, num_pairs),
        sum_by(view_pair, rounded.square(), num_pairs),
        torch.bincount(view_pair, minlength=num_pairs),
        low,
        high,
    )
