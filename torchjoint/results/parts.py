"""The pieces of a result, and the segments that they form: what can be joined and split (output after step 8)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import numpy as np
import torch

from torchjoint.results.edits import Edits, Table, first_pieces
from torchjoint.results.result import Result
from torchjoint.scene.segmentation import level_images


@dataclass(frozen=True)
class Parts:
    """The pieces of a result: those of its hierarchy, or else its segments.

    Each segment has a key. If its first piece is the first piece of a segment on disk, the key is the label of that
    segment. Otherwise the key is the number of its first piece + the number of segments on disk. So neither an edit nor
    another level changes the keys of other segments.
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

    def middle(self, piece: int) -> int:
        """The point of a piece that is nearest to its centre."""
        own = np.flatnonzero(self.of_point == piece)
        points = self.result.scene.points.numpy()[own]
        return int(own[np.square(points - points.mean(0)).sum(1).argmin()])

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
        """[P] the segment of each piece after the edits; the number of a segment is that of its first piece."""
        return edits.apply(self.level(edits.granularity), self.result.hierarchy)

    def names(self, edits: Edits) -> dict[int, str]:
        """The names of segments after the edits, by the number of a segment in :meth:`table`.

        A name belongs to the segment that got it, at its level and after all edits, and to the segments within it. Of
        several names, that of the smallest named segment counts, then the latest. Names of the result, which masks
        gave, count less.
        """
        shaped = replace(edits, steps=tuple(step for step in edits.steps if step.kind != "name"))
        steps = [(number, step) for number, step in enumerate(edits.steps) if step.kind == "name"]
        steps.sort(key=lambda one: -1.0 if one[1].granularity is None else one[1].granularity)
        named = []
        for level, own in groupby(steps, lambda one: one[1].granularity):
            table = self.table(replace(shaped, granularity=level))
            named += [(number, np.flatnonzero(table == table[one.pieces[0]]), one.name) for number, one in own]
        given = [(-1, np.flatnonzero(self.stored == one), name) for one, name in self.result.segment_names.items()]
        table, names = self.table(shaped), dict[int, str]()
        sizes = np.bincount(table)
        for _, pieces, name in given + sorted(named, key=lambda one: (-len(one[1]), one[0])):
            found, counts = np.unique(table[pieces], return_counts=True)
            names.update(dict.fromkeys(found[counts == sizes[found]].tolist(), name))
        return {segment: name for segment, name in names.items() if name}

    def level(self, granularity: float | None) -> Table:
        """[P] the segment of each piece at a level, without edits; None: as on disk."""
        hierarchy = self.result.hierarchy
        if granularity is None or hierarchy is None:
            return first_pieces(self.stored)
        return first_pieces(hierarchy.segments_of_pieces(hierarchy.height_of(granularity)).numpy())

    @cached_property
    def keys(self) -> Table:
        """[P] for each piece, the key of the segment that begins with this piece."""
        number = np.arange(self.count)
        return np.where(first_pieces(self.stored) == number, self.stored, number + int(self.stored.max()) + 1)


def edited(result: Result, edits: Edits) -> Result:
    """Applies corrections by hand: renumbers the labels by first appearance, and sets `segment_names`."""
    parts = Parts(result)
    table = parts.table(edits)
    firsts, of_piece = np.unique(table, return_inverse=True)  # ascending: in the order of first appearance
    names = {int(np.searchsorted(firsts, first)): name for first, name in parts.names(edits).items()}
    segments = torch.from_numpy(of_piece.astype(np.int64))
    pieces = None if result.hierarchy is None else result.piece_images
    images = level_images(result.images, result.num_point_segments, segments, len(firsts), pieces)
    points = segments[torch.from_numpy(parts.of_point)]
    return replace(result, points=points, images=images if len(result.images) else (), segment_names=names)
