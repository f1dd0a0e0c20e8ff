"""Step 6, method learned: what images say about points: agreement, counts and colours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.ops.internal import agreement_sums
from torchjoint.runtime.groups import counted_pairs
from torchjoint.runtime.threads import all_threads, parallel_map
from torchjoint.segments.learned.region_statistics import sum_by
from torchjoint.views.observations import Observation, Observations
from torchjoint.views.propagation import OVERLAP_RESOLUTION

#: Number of frames that are read at a time.
BLOCK = 8


def image_colors(num_points: int, observations: Observations) -> Tensor | None:
    """The mean colour of the pixels in which each point is visible.

    All sums are of whole numbers, so the order of the frames does not matter.

    Args:
        num_points: N, number of points of the cloud.
        observations: the frames.

    Returns:
        [N, 3] RGB in [0, 1], NaN for a point that no frame sees; None if no frame sees a point.
    """
    total = torch.zeros(num_points, 3, dtype=torch.int64)
    views = torch.zeros(num_points, dtype=torch.int64)
    for start in range(0, len(observations), BLOCK):
        for point, color in parallel_map(_seen_colors, observations[start : start + BLOCK]):
            total.index_add_(0, point, color)
            views += torch.bincount(point, minlength=num_points)
    return total.float() / (255 * views)[:, None] if views.any() else None


def _seen_colors(seen: Observation) -> tuple[Tensor, Tensor]:
    """The visible points [V] of a frame, and the colours of their pixels, [V, 3] int64 in 0 ... 255."""
    visible = seen.visible
    return visible.point, seen.image[:, visible.row, visible.column].T.long()


class ImageCounts(NamedTuple):
    """How many points of each superpoint lie in each segment of each image: I pairs that have points.

    All L segments of all images are numbered together, 0 ... L - 1, image by image.
    """

    superpoint: Tensor  #: [I] int32
    segment: Tensor  #: [I] int32
    num_points: Tensor  #: [I] int32, visible points of the superpoint in the segment
    segment_size: Tensor  #: [L] int64, visible points in the segment
    frame_of_segment: Tensor  #: [L] int64, ascending

    def grouped(self, of_superpoint: Tensor) -> ImageCounts:
        """The counts of groups of superpoints; `of_superpoint` [P] int64: the group of each. Rows may repeat."""
        num_groups = int(of_superpoint.max()) + 1
        of_row = of_superpoint.index_select(0, self.superpoint)
        if 2 * num_groups > len(of_superpoint):  # few rows would become one, and the operator adds them, too
            return self._replace(superpoint=of_row.int())
        key, row = torch.unique(self.segment.long() * num_groups + of_row, return_inverse=True)
        num_points = sum_by(row, self.num_points, len(key))
        group, segment = (key % num_groups).int(), (key // num_groups).int()
        return self._replace(superpoint=group, segment=segment, num_points=num_points)

    @classmethod
    def union(cls, counts: Sequence[ImageCounts], starts: Sequence[int]) -> ImageCounts:
        """Counts of the same images as one; the superpoints of number k are numbered from `starts[k]` on."""
        return counts[0]._replace(
            superpoint=torch.cat([one.superpoint + start for one, start in zip(counts, starts, strict=True)]),
            segment=torch.cat([one.segment for one in counts]),
            num_points=torch.cat([one.num_points for one in counts]),
        )


def segments_of_superpoints(superpoint: Tensor, observations: Sequence[Observation]) -> ImageCounts:
    """Counts the visible points of each superpoint in each image segment.

    Args:
        superpoint: [N] int64, superpoint of each point, 0 ... P - 1.
        observations: the frames, at least one.
    """

    def count_points(seen: Observation) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        point, label = seen.labelled_points()
        superpoints, labels, counts = counted_pairs(superpoint[point], label).int()
        return superpoints, labels, counts, torch.bincount(label)

    superpoints, labels, counts, sizes = zip(*parallel_map(count_points, observations), strict=True)
    num_labels = torch.tensor([len(size) for size in sizes])
    first = num_labels.cumsum(0) - num_labels
    segment = torch.cat([label + start for label, start in zip(labels, first.tolist(), strict=True)])
    frame_of_segment = torch.repeat_interleave(torch.arange(len(sizes)), num_labels)
    return ImageCounts(torch.cat(superpoints), segment, torch.cat(counts), torch.cat(sizes), frame_of_segment)


#: An image counts for a region only if it sees at least this many points of the region.
MIN_POINTS = 3


def image_agreement(images: ImageCounts, num_regions: int, pairs: Tensor) -> dict[str, Tensor]:
    """Measures how far the images show two regions as one, for each pair of regions.

    Args:
        images: the image segments in which the regions lie.
        num_regions: R.
        pairs: [2, B] int64, pairs of regions.

    Returns:
        [B] float64 each: agreement over all images, weighted by the products of visible points; its mean over the
        images; its standard deviation; log(1 + number of images that see both); the gain of the union in best overlap
        (intersection over union) with an image segment, over the better region; best overlap of the better region, and
        of the other; range of the agreement. NaN where no image sees both regions.
    """
    with all_threads():
        sums = agreement_sums(*images, num_regions, pairs, min_points=MIN_POINTS, resolution=OVERLAP_RESOLUTION)
    best, (best_union, low, high), (common, product, rounded, squares, num_views) = sums
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


def without_dropouts(colors: Tensor, edge_index: Tensor) -> Tensor:
    """Colours [N, 3], NaN for points that have none.

    A point has none if it is exactly black or white, and fewer than half of its neighbours are. So a black thing stays
    black.

    Args:
        colors: [N, 3] RGB in [0, 1], NaN = none.
        edge_index: [2, E] int64, edges of the point graph.
    """
    is_blank = (colors == 0).all(1) | (colors == 1).all(1)
    if not is_blank.any():
        return colors
    point, neighbor = torch.cat([edge_index, edge_index.flip(0)], 1)
    blank = torch.bincount(point[is_blank[neighbor]], minlength=len(colors))
    is_alone = is_blank & (2 * blank < torch.bincount(point, minlength=len(colors)))
    return colors.masked_fill(is_alone[:, None], torch.nan)
