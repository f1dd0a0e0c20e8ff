"""Step 7: pairs of visible points that are close in the image (eq. 7-9)."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torchjoint.ops.internal import pair_counts
from torchjoint.views.visibility import Visible

#: R, pixels: about the spacing of projected points in an image of 640 x 480. With a larger R it takes longer.
RADIUS = 3.0


class PixelPairs(NamedTuple):
    """Counts of E^R, the pairs of visible points that are close in the image, by segments and 3D labels (eq. 7-9).

    A pair is internal if its two 3D labels are equal, else external. Three kinds of pairs are not counted: internal
    pairs inside one image segment (most pairs; the later steps do not need them), pairs within one pixel (no cut can
    separate them), and pairs with a point outside all segments.
    """

    low_segment: Tensor  #: [G] int64, lower image segment of the two ends; groups are sorted by this, then by the next
    high_segment: Tensor  #: [G] int64, higher image segment of the two ends
    low_label: Tensor  #: [G] int64, lower 3D label of the two ends; its end may be in either segment
    high_label: Tensor  #: [G] int64, higher 3D label of the two ends
    num_pairs: Tensor  #: [G] int64, number of pairs in the group

    def select(self, mask: Tensor) -> PixelPairs:
        """The groups where `mask` [G] is True."""
        return PixelPairs(*(values[mask] for values in self))


def pixel_pairs(visible: Visible, segment: Tensor, point_labels: Tensor, width: int, radius: float) -> PixelPairs:
    """Counts the pairs of visible points at most `radius` pixels apart (eq. 7-9).

    Args:
        visible: M visible points.
        segment: [M] int64, image segment of each visible point, -1 = none.
        point_labels: [M] int64, 3D label of each visible point.
        width: width of the image, pixels.
        radius: R, pixels.
    """
    pixel = visible.row * width + visible.column
    group, num_pairs = pair_counts(visible.u, visible.v, pixel, segment, point_labels, radius)
    return PixelPairs(group[0], group[1], group[2], group[3], num_pairs)
