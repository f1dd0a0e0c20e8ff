"""The superpoints of a result, and the segments that they form: what can be joined and split (output after step 8)."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count, groupby

import numpy as np
import torch

from torchjoint.results.edits import Edits, Table, first_superpoints
from torchjoint.results.result import Result
from torchjoint.scene.segmentation import level_images


@dataclass(frozen=True)
class Parts:
    """The superpoints of a result: those of its hierarchy, or else its segments.

    If the first superpoint of a segment is the first one of a segment on disk, its id is the label of that segment. So
    no edit changes the ids of other segments, and the ids of files that were written before stay valid. Segments of
    another level that do not begin as one on disk have numbers of that level.
    """

    result: Result

    @cached_property
    def of_point(self) -> Table:
        """[N] the superpoint of each point."""
        hierarchy = self.result.hierarchy
        return (self.result.points if hierarchy is None else hierarchy.superpoint).numpy()

    @cached_property
    def count(self) -> int:
        """P, the number of superpoints."""
        return int(self.of_point.max()) + 1

    def middle(self, superpoint: int) -> int:
        """The point of a superpoint that is nearest to its centre."""
        own = np.flatnonzero(self.of_point == superpoint)
        points = self.result.scene.points.numpy()[own]
        return int(own[np.square(points - points.mean(0)).sum(1).argmin()])

    @cached_property
    def sizes(self) -> Table:
        """[P] the points of each superpoint."""
        return np.bincount(self.of_point, minlength=self.count)

    def largest(self, superpoints: Table) -> int:
        """The superpoint that has most points, of several the lowest: a name or a selection stays where it is."""
        return int(superpoints[self.sizes[superpoints].argmax()])

    @cached_property
    def stored(self) -> Table:
        """[P] the label on disk of each superpoint."""
        stored = np.zeros(self.count, dtype=np.int64)
        stored[self.of_point] = self.result.points.numpy()
        return stored

    def image(self, index: int) -> Table:
        """[H, W] the superpoint of each pixel; -1 = none."""
        if self.result.hierarchy is not None:
            return self.result.superpoint_images[index].numpy()
        labels = self.result.images[index].numpy()
        return np.where(labels < self.count, labels, -1)

    def table(self, edits: Edits) -> Table:
        """[P] the segment of each superpoint after the edits; its number is that of its first superpoint."""
        return deque(self.tables(edits), maxlen=1).pop()

    def tables(self, edits: Edits) -> Iterator[Table]:
        """The same before the edits, and after each that changes it."""
        return edits.tables(self.level(edits.granularity), self.result.hierarchy)

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
            named += [(number, np.flatnonzero(table == table[one.superpoints[0]]), one.name) for number, one in own]
        given = [(-1, np.flatnonzero(self.stored == one), name) for one, name in self.result.segment_names.items()]
        table, names = self.table(shaped), dict[int, str]()
        sizes = np.bincount(table)
        for _, superpoints, name in given + sorted(named, key=lambda one: (-len(one[1]), one[0])):
            found, counts = np.unique(table[superpoints], return_counts=True)
            names.update(dict.fromkeys(found[counts == sizes[found]].tolist(), name))
        return {segment: name for segment, name in names.items() if name}

    def level(self, granularity: float | None) -> Table:
        """[P] the segment of each superpoint at a level, without edits; None: as on disk."""
        hierarchy = self.result.hierarchy
        if granularity is None or hierarchy is None:
            return first_superpoints(self.stored)
        return first_superpoints(hierarchy.segments_of_superpoints(hierarchy.height_of(granularity)).numpy())

    def ids(self, edits: Edits) -> Table:
        """[P] the id of each superpoint's segment; new segments follow all on disk, in the order of the edits."""
        own, following = np.where(first_superpoints(self.stored) == np.arange(self.count), self.stored, -1), count()
        for table in self.tables(edits):
            for first in np.flatnonzero((table == np.arange(self.count)) & (own < 0)):
                own[first] = int(self.stored.max()) + 1 + next(following)
        return own[table]

    @cached_property
    def keys(self) -> Table:
        """[P] for each superpoint a number of the segment that begins with it, the same in all tables."""
        number = np.arange(self.count)
        return np.where(first_superpoints(self.stored) == number, self.stored, number + int(self.stored.max()) + 1)


def edited(result: Result, edits: Edits) -> Result:
    """Applies corrections by hand, and sets `segment_names`. Ids as those of :class:`Parts`; some may have no point."""
    parts = Parts(result)
    ids = torch.from_numpy(parts.ids(edits))
    superpoints = None if result.hierarchy is None else result.superpoint_images
    before = result.num_point_segments  # ids of image segments without points stay, too, unless there are new ones
    more = max(int(ids.max()) + 1 - before, 0)
    images = level_images(result.images, before, ids, before + more, superpoints) if len(result.images) else ()
    names = {int(ids[first]): name for first, name in parts.names(edits).items()}
    names |= {one + more: name for one, name in result.segment_names.items() if one >= before}
    return replace(result, points=ids[torch.from_numpy(parts.of_point)], images=images, segment_names=names)
