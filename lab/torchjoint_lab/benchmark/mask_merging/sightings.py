"""Which points are seen in which masks: what all ways of merging masks start from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import sparse

from torchjoint.scene.masks import Masks
from torchjoint.views.visibility import Visible

Array = npt.NDArray[Any]


class Sightings(NamedTuple):
    """S sightings, each of one point in one frame, frame after frame; masks are numbered over all frames."""

    point: Array  #: [S] int64
    frame: Array  #: [S] int64
    mask: Array  #: [S] int64, -1 = none
    frame_of_mask: Array  #: [M] int64
    num_points: int
    num_frames: int

    def in_masks(self) -> Sightings:
        """Those of points that are in a mask."""
        inside = self.mask >= 0
        return self._replace(point=self.point[inside], frame=self.frame[inside], mask=self.mask[inside])

    def points_by_masks(self) -> sparse.csr_array:
        """[N, M], 1 for each point in a mask."""
        kept = self.in_masks()
        ones = np.ones(len(kept.point), dtype=np.float32)
        return sparse.csr_array((ones, (kept.point, kept.mask)), (self.num_points, len(self.frame_of_mask)))

    def points_by_frames(self) -> sparse.csr_array:
        """[N, T], 1 for each point that a frame sees, in a mask or not."""
        ones = np.ones(len(self.point), dtype=np.float32)
        return sparse.csr_array((ones, (self.point, self.frame)), (self.num_points, self.num_frames))


def sightings(num_points: int, visible: Sequence[Visible], masks: Sequence[Masks]) -> Sightings:
    """Looks up the mask of each visible point in each frame.

    Args:
        num_points: N.
        visible: per frame the points that it sees.
        masks: per frame the masks; of several masks of one pixel, the smallest counts.

    Raises:
        ValueError: the numbers of frames differ.
    """
    if len(visible) != len(masks):
        raise ValueError(f"masks: expected those of {len(visible)} frames, got those of {len(masks)}")
    nothing = np.zeros(0, dtype=np.int64)
    points, frames, found, frame_of_mask = [nothing], [nothing], [nothing], [nothing]
    first = 0
    for index, (seen, of_frame) in enumerate(zip(visible, masks, strict=True)):
        mask = of_frame.labels()[seen.row, seen.column].numpy()
        points.append(seen.point.numpy())
        frames.append(np.full(len(mask), index))
        found.append(np.where(mask < 0, -1, mask + first))
        frame_of_mask.append(np.full(len(of_frame), index))
        first += len(of_frame)
    point, frame, mask, of_mask = (np.concatenate(parts) for parts in (points, frames, found, frame_of_mask))
    return Sightings(point, frame, mask, of_mask, num_points, len(visible))
