"""Step 6, method learned: measures whether the images show two regions in the same image segments.

Each image segment contains some share of a region's visible points. The agreement of two regions in an image is the sum
of the smaller of their two shares over all segments (histogram intersection).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.ops.internal import agreement_sums
from torchjoint.runtime.threads import all_threads
from torchjoint.segments.learned.image_counts import ImageCounts
from torchjoint.views.propagation import OVERLAP_RESOLUTION

#: An image counts for a region only if it sees at least this many points of the region.
MIN_POINTS = 3


def image_agreement(images: ImageCounts, of_piece: Tensor, num_regions: int, pairs: Tensor) -> dict[str, Tensor]:
    """Measures how far the images show two regions as one, for each pair of regions.

    Args:
        images: the image segments in which the pieces lie.
        of_piece: [P] int64, region of each piece.
        num_regions: R.
        pairs: [2, B] int64, pairs of regions.

    Returns:
        [B] float64 each: agreement over all images, weighted by the products of visible points; its mean over the
        images; its standard deviation; log(1 + number of images that see both); the gain of the union in best overlap
        (intersection over union) with an image segment, over the better region; best overlap of the better region, and
        of the other; range of the agreement. NaN where no image sees both regions.
    """
    with all_threads():
        best, (best_union, low, high), (common, product, rounded, squares, num_views) = agreement_sums(
            *images, of_piece, num_regions, pairs, min_points=MIN_POINTS, resolution=OVERLAP_RESOLUTION
        )
    views = num_views.double()
    mean = rounded.double() * OVERLAP_RESOLUTION / views
    mean_square = squares.double() * OVERLAP_RESOLUTION**2 / views
    better, worse = torch.maximum(*best[pairs]), torch.minimum(*best[pairs])
    return {
        "agreement": common.double() / product,
        "agreement_mean": mean,
        "agreement_deviation": (mean_square - mean.square()).clamp(min=0).sqrt(),
        "agreement_log_views": torch.log1p(views),
        "overlap_gain": best_union - better,
        "better_overlap": better,
        "worse_overlap": worse,
        "agreement_range": torch.where(num_views > 0, high - low, torch.nan),
    }
