"""Measures segments for the viewer's table: points, size, frames that see them."""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.results.edits import Table
from torchjoint.results.objects import oriented_box
from torchjoint.results.parts import Parts
from torchjoint.runtime.groups import each_once
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene.hierarchy import Confidence


@dataclass(frozen=True)
class Row:
    """One segment in the table."""

    key: int  #: see :class:`~torchjoint.results.parts.Parts`
    hue: int  #: number of its colour
    name: str
    points: int
    size: tuple[float, float, float]  #: metres, of its upright box
    frames: int | None  #: number of frames that see it; None before all frames were read, and without frames
    sure: float | None  #: probability that it is an object; None: no ensemble


class Measures:
    """Measures the segments of a table on demand, and caches the measures.

    Args:
        parts: superpoints of the points and images.
        up: [3] upward direction, unit length.

    Attributes:
        hues: [P] the number of the colour of each segment, at its first superpoint.
        ids: [P] the id of each superpoint's segment.
    """

    def __init__(self, parts: Parts, up: npt.NDArray[np.float64]) -> None:
        self._parts, self._up, self.hues = parts, up, parts.keys
        self._frames: list[tuple[Table, Table]] | None = None  # per frame: its superpoints, and their numbers of pixels

    def of_table(self, table: Table, ids: Table) -> None:
        """Changes the tables: [P] the segment of each superpoint, and its id."""
        self._table, self.ids = table, ids
        self._rows: dict[int, Row] = {}
        self._number = np.unique(table, return_inverse=True)[1]  # of the segment of each superpoint
        self.__dict__.pop("confidence", None)  # of the table before
        of_point = table[self._parts.of_point]
        self._order = np.argsort(of_point, kind="stable")
        self._firsts, self._starts, self._counts = np.unique(
            of_point[self._order], return_index=True, return_counts=True
        )

    def read_frames(self, is_stopped: Callable[[], bool] = lambda: False) -> None:
        """Counts the pixels of each superpoint in all frames, unless it is stopped; before that, no frame is listed."""

        def count(index: int) -> tuple[Table, Table]:
            image = np.empty(0, dtype=np.int64) if is_stopped() else self._parts.image(index)
            superpoints, pixels = np.unique(image, return_counts=True)
            return superpoints[superpoints >= 0], pixels[superpoints >= 0]

        self._frames = parallel_map(count, range(len(self._parts.result.images)))
        self._rows.clear()

    def frames_of(self, segment: int) -> list[tuple[int, int]]:
        """(frame, pixels) of the frames that see a segment, most pixels first."""
        frames = enumerate(self._frames or [])
        found = [(index, int(pixels[self._table[seen] == segment].sum())) for index, (seen, pixels) in frames]
        return sorted((one for one in found if one[1]), key=lambda one: (-one[1], one[0]))

    def row(self, segment: int, name: str) -> Row:
        """Measures one segment."""
        if segment not in self._rows:
            place = int(np.searchsorted(self._firsts, segment))
            start, count = int(self._starts[place]), int(self._counts[place])
            x, y, z = oriented_box(self._points[self._order[start : start + count]], self._up).size.tolist()
            frames = len(self.frames_of(segment)) if self._frames else None
            sure = None if self.confidence is None else float(self.confidence.of_segment[self._number[segment]])
            key, hue = int(self.ids[segment]), int(self.hues[segment])
            self._rows[segment] = Row(key, hue, name, count, (x, y, z), frames, sure)
        return replace(self._rows[segment], name=name)

    def rows(self, names: Mapping[int, str], search: str, order: str, most: int) -> tuple[list[Row], int]:
        """See :meth:`~torchjoint.viewer.model.Model.rows`; `names`: by segment."""
        keys, counts = self.ids, dict(zip(self._firsts.tolist(), self._counts.tolist(), strict=True))
        found = [one for one in counts if search.lower() in names.get(one, "").lower() or search == str(keys[one])]
        places: dict[str, Callable[[int], object]] = {
            "id": lambda one: 0,
            "name": lambda one: names.get(one, "\uffff").lower(),
            "points": lambda one: -counts[one],
        }
        place = places.get(order, lambda one: -float(np.prod(getattr(self.row(one, ""), order) or 0)))
        found.sort(key=lambda one: (place(one), keys[one]))
        return [self.row(one, names.get(one, "")) for one in found[:most]], len(found)

    @cached_property
    def confidence(self) -> Confidence | None:
        """That the segments, in ascending order, are objects; None: no ensemble."""
        votes = getattr(self._parts.result.hierarchy, "votes", None)
        return None if votes is None else votes.confidence(torch.from_numpy(self._number))

    @cached_property
    def _points(self) -> npt.NDArray[np.float64]:
        return self._parts.result.scene.points.double().numpy()


def kept_numbers(segment: Table, before: Table, number: Table) -> Table:
    """Numbers of segments, so that they keep those of the earlier segments that they match.

    Pairs of a segment and an earlier segment are sorted by the number of common points, largest first (ties: the lower
    segment, then the lower earlier segment). If neither is in a pair yet, the segment gets the number of the earlier
    segment. The remaining segments get the lowest free numbers, in their order.

    Args:
        segment: [N] of each point, 0 ... P - 1.
        before: [N] the earlier number of each point, >= 0.
        number: [P] numbers of those that have no point.

    Example:
        >>> kept_numbers(np.array([0, 0, 1, 1, 2]), np.array([5, 5, 5, 3, 3]), np.zeros(3, int)).tolist()
        [5, 3, 0]
    """
    count = int(before.max()) + 1
    pairs, shared = np.unique(segment * count + before, return_counts=True)  # ascending
    found = each_once(zip(*np.divmod(pairs[np.argsort(-shared, kind="stable")], count), strict=True))
    taken = set(found.values())
    free = (candidate for candidate in itertools.count() if candidate not in taken)
    numbers = number.copy()
    for one in np.unique(segment):
        numbers[one] = found[one] if one in found else next(free)
    return numbers


def hues_of_keys(hues: Table, keys: Table) -> Table:
    """The hues [P] of keys [P]: those of the S segments, `hues` [S]; others that no segment has for all other keys.

    Example:
        >>> hues_of_keys(np.array([4, 0]), np.array([1, 0, 2, 3])).tolist()
        [0, 4, 7, 8]
    """
    return np.where(keys < len(hues), np.append(hues, 0)[np.minimum(keys, len(hues))], keys + hues.max(initial=-1) + 1)
