"""A result as its smallest parts and the segments they form (output after step 8): what can be joined and split."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch

from torchjoint.results.edits import Edits, Table, first_pieces
from torchjoint.results.result import Result
from torchjoint.scene.level_images import LevelImages


@dataclass(frozen=True)
class Parts:
    """The pieces of a result: those of its hierarchy, or else its segments.

    A segment made of pieces has a key. It is the segment's label, as on disk, if it begins with the same piece as a
    segment on disk. Else, a part of one, it is the number of its first piece + the number of segments on disk. So an
    edit and another level change no other segment's key.
    """

    result: Result

    @cached_property
    def of_point(self) -> Table:
        """[N] the piece of each point."""
        hierarchy = self.result.hierarchy
        return (self.result.points if hierarchy is None else hierarchy.piece).numpy()

    @cached_property
    def count(self) -> int:
        """P, the number of pieces."""
        return int(self.of_point.max()) + 1

    @cached_property
    def stored(self) -> Table:
        """[P] the label on disk of each piece."""
        stored = np.zeros(self.count, dtype=np.int64)
        stored[self.of_point] = self.result.points.numpy()
        return stored

    def image(self, index: int) -> Table:
        """[H, W] the piece of each pixel; -1 = none."""
        if self.result.hierarchy is not None:
            return self.result.piece_images[index].numpy()
        labels = self.result.images[index].numpy()
        return np.where(labels < self.count, labels, -1)

    def table(self, edits: Edits) -> Table:
        """[P] the segment of each piece after the edits, which has the number of its first piece.

        Raises:
            ValueError: an edit that is not possible.
        """
        return edits.apply(self.level(edits.granularity), self.result.hierarchy)

    def level(self, granularity: float | None) -> Table:
        """[P] the segment of each piece at a level, without edits; None: as on disk."""
        hierarchy = self.result.hierarchy
        if granularity is None or hierarchy is None:
            return first_pieces(self.stored)
        return first_pieces(hierarchy.segments_of_pieces(hierarchy.height_of(granularity)).numpy())

    @cached_property
    def keys(self) -> Table:
        """[P] the key of a segment, by its first piece."""
        number = np.arange(self.count)
        return np.where(first_pieces(self.stored) == number, self.stored, number + int(self.stored.max()) + 1)


def edited(result: Result, edits: Edits) -> Result:
    """A result after corrections by hand: labels numbered by first appearance again, and `segment_names`.

    Raises:
        ValueError: an edit that is not possible.
    """
    parts = Parts(result)
    table = parts.table(edits)
    firsts, of_piece = np.unique(table, return_inverse=True)  # first pieces ascend: numbers by first appearance
    names = {int(np.searchsorted(firsts, first)): name for first, name in edits.names(table).items()}
    segments = torch.from_numpy(of_piece.astype(np.int64))
    pieces = None if result.hierarchy is None else result.piece_images
    images = LevelImages(result.images, result.num_point_segments, segments, len(firsts), pieces)
    points = segments[torch.from_numpy(parts.of_point)]
    return replace(result, points=points, images=images if len(result.images) else (), segment_names=names)
