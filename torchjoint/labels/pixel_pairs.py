"""Step 7: pairs of visible points that are close in the image (eq. 7-9)."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from torchjoint import ops
from torchjoint.views.visibility import Visible


class PixelPairs(NamedTuple):
    """E^R, counted: pairs of visible points that are close in the image, by what their ends belong to (eq. 7-9).

    A pair is internal if both 3D labels are one, else external. Internal pairs inside one image segment, which is
    most of all pairs, play no role in what follows and are not counted; nor are pairs within one pixel, which no cut
    can part, and points outside all segments.
    """

    low_segment: Tensor  #: [G] int64; groups are sorted by this, then by the following
    high_segment: Tensor  #: [G] int64
    low_label: Tensor  #: [G] int64, 3D labels of the ends; which end is in which segment does not matter
    high_label: Tensor  #: [G] int64
    num_pairs: Tensor  #: [G] int64

    def select(self, mask: Tensor) -> PixelPairs:
        """The groups where `mask` [G] is True."""
        return PixelPairs(*(values[mask] for values in self))


def pixel_pairs(visible: Visible, segment: Tensor, point_labels: Tensor, width: int, radius: float) -> PixelPairs:
    """Counts the pairs of visible points at most `radius` pixels apart (eq. 7-9).

    Args:
        segment: [M] int64, image segment that each visible point falls in, -1 = none.
        point_labels: [M] int64, 3D label of each visible point.
        width: of the image.
    """
    pixel = visible.row * width + visible.column
    group, num_pairs = ops.pair_counts(visible.u, visible.v, pixel, segment, point_labels, radius)
    return PixelPairs(group[0], group[1], group[2], group[3], num_pairs)
