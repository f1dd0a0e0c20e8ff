"""Corrections of a result from boxes that were edited elsewhere (output after step 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from torchjoint.results.boxes import UNNAMED, Box, boxes_of
from torchjoint.results.edits import Edit
from torchjoint.results.result import Result

#: Smallest IoU, in points, of a box with that of its segment.
SAME = 0.1
#: A segment without a box joins the one in whose box it has more than this share of its points.
INSIDE = 0.5


class BoxEdits(NamedTuple):
    """What boxes change."""

    steps: tuple[Edit, ...]  #: joins, then names
    joined: int  #: segments that have joined others
    named: int  #: segments whose name has changed
    empty: tuple[int, ...]  #: boxes that are those of no segment


def edits_of_boxes(result: Result, boxes: Sequence[Box], piece: npt.NDArray[np.int64]) -> BoxEdits:
    """The corrections that edited boxes mean.

    Each box belongs to one segment: the pairs are taken by the IoU of the points in the box with those in the segment's
    own box, largest first (ties: the first box, the lowest id). So boxes that nobody edited change nothing. A segment
    whose box was deleted joins the segment of the smallest box that holds more than half of its points; otherwise it
    stays. The name of a box becomes that of the segment; UNNAMED removes it.

    Args:
        result: its labels are those from which the boxes were exported, with all corrections before.
        boxes: after the edits, in any order.
        piece: [N] the piece of each point, which does not change with corrections.
    """
    points, labels = result.scene.points.double().numpy(), result.points.numpy()
    inside = np.array([box.holds(points) for box in boxes], dtype=bool).reshape(len(boxes), len(points))
    own = {segment: box.holds(points) for segment, box in boxes_of(result).items()}
    segment_of = _matches(inside, own)
    first = {segment: int(piece[labels == segment].min()) for segment in own}
    steps, joined = [], 0
    by_size = sorted(segment_of, key=lambda number: (np.prod(boxes[number].size), number))
    for segment in sorted(own.keys() - set(segment_of.values())):
        of_segment = labels == segment
        holder = next((n for n in by_size if inside[n, of_segment].mean() > INSIDE), None)
        if holder is not None:
            steps.append(Edit("join", (first[segment_of[holder]], first[segment])))
            joined += 1
    named = 0
    for number, segment in sorted(segment_of.items()):
        if not boxes[number].name:
            continue
        name = "" if boxes[number].name == UNNAMED else boxes[number].name
        if _words(name) != _words(result.segment_names.get(segment, "")):
            steps.append(Edit("name", (first[segment],), name))
            named += 1
    return BoxEdits(tuple(steps), joined, named, tuple(n for n in range(len(boxes)) if n not in segment_of))


def _words(name: str) -> str:
    """A name as OpenPCDet's files have it, without spaces."""
    return "_".join(name.split())


def _matches(inside: npt.NDArray[np.bool_], own: Mapping[int, npt.NDArray[np.bool_]]) -> dict[int, int]:
    """The segment of each box that has one."""
    pairs = []
    for segment, of_segment in own.items():
        shared, either = (inside & of_segment).sum(1), (inside | of_segment).sum(1)
        iou = shared / np.maximum(either, 1)
        pairs += [(-float(iou[number]), int(number), segment) for number in np.flatnonzero(iou >= SAME)]
    found: dict[int, int] = {}
    for _, number, segment in sorted(pairs):
        if number not in found and segment not in found.values():
            found[number] = segment
    return found
