"""Corrections that came from other programs, or from several people at once."""

import csv
import io
import re
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.sparse import csr_array

from torchjoint.datasets.files.text import read_record
from torchjoint.results.boxes import UNNAMED, Box, boxes_of, upright_points
from torchjoint.results.edits import FILE, Edit, Edits, Table, first_superpoints, read_edits, write_edits
from torchjoint.results.parts import Parts
from torchjoint.results.result import Result
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import damage_is, dict_of, no_formula, read_text
from torchjoint.runtime.groups import best_of_groups, each_once
from torchjoint.runtime.messages import printable
from torchjoint.runtime.outputs import lock

Steps = tuple[Edit, ...]


class ForeignLabels(NamedTuple):
    """Objects of Segments.ai, by their ids."""

    of_point: Table  #: [N] the object of each point; 0: none
    names: Mapping[int, str]  #: of the objects whose attribute `name` is in the file


def read_point_labels(file: Path, num_points: int) -> ForeignLabels | None:
    """Reads a label of segmentation of Segments.ai (docs.segments.ai, label types); None: the file is none."""
    if file.suffix.lower() != ".json":
        return None
    record = read_record(file, "boxes or labels of points")
    record = record.record("attributes") if "attributes" in record else record  # of a whole label
    if "point_annotations" not in record:
        return None
    of_point, names = record.integers("point_annotations"), []
    if len(of_point) != num_points or (of_point < 0).any():
        got = f"{len(of_point)}, the least {of_point.min(initial=0)}"
        raise ValueError(f"{file}: point_annotations: expected ids >= 0 of {num_points} points, got {got}")
    for one in record.records("annotations"):
        if "attributes" in one and "name" in one.record("attributes"):
            names.append((int(one.number("id")), printable(one.record("attributes").text("name").strip())))
    return ForeignLabels(of_point, dict_of(names, f"{file}: object"))


def edits_of_points(parts: Parts, before: Edits, labels: ForeignLabels) -> tuple[tuple[Edit, ...], int]:
    """The corrections that edited labels mean.

    A superpoint belongs to the object that most of its points have; if that is none, to the object that most points of
    its segment have. All superpoints of an object become one segment, unless they are one already. So labels that
    nobody edited change nothing, and a segment whose points have no object any more stays.

    Args:
        parts: of the result.
        before: the corrections with which the labels were exported.
        labels: after the edits.

    Returns:
        the corrections; and how many points have another object than their superpoint.
    """
    table, labelled = parts.table(before), labels.of_point > 0
    of_superpoint = _most(parts.of_point, labels.of_point, parts.count)
    of_segment = _most(table[parts.of_point[labelled]], labels.of_point[labelled], parts.count)
    of_superpoint = np.where(of_superpoint > 0, of_superpoint, of_segment[table])
    found, sizes = np.unique(of_superpoint[parts.of_point], return_counts=True)
    largest_first = found[np.argsort(-sizes, kind="stable")]
    superpoints_of = {one: np.flatnonzero(of_superpoint == one) for one in largest_first if one > 0}
    gathered, kept = list[Edit](), set[int]()
    for superpoints in superpoints_of.values():
        segments = set(table[superpoints].tolist())
        if len(segments) == 1 and not segments & kept:
            kept |= segments  # the largest object of a segment is what the others leave
        else:
            gathered.append(Edit("gather", tuple(superpoints.tolist())))
    after = replace(before, steps=(*before.steps, *gathered))
    table, names = parts.table(after), parts.names(after)
    place = {one: parts.largest(superpoints) for one, superpoints in superpoints_of.items()}
    known = {one: names.get(int(table[place[one]]), "").strip() for one in sorted(labels.names) if one in place}
    _warn_of_emptied((labels.names[one], before) for one, before in known.items())
    named = [
        Edit("name", (place[one],), labels.names[one])
        for one, before in known.items()
        if _told(labels.names[one]) not in ("", before)
    ]
    return (*gathered, *named), int((labelled & (labels.of_point != of_superpoint[parts.of_point])).sum())


def _most(group: Table, ids: Table, count: int) -> Table:
    """[count] the id that most members of a group have, the lowest of several; 0: the group has no members."""
    numbers, of_member = np.unique(ids, return_inverse=True)
    pairs, sizes = np.unique(group * len(numbers) + of_member, return_counts=True)
    groups, of_pair, sizes = map(torch.from_numpy, (*np.divmod(pairs, max(len(numbers), 1)), sizes))
    return np.append(numbers, 0)[best_of_groups(groups, of_pair, sizes, count)[0].numpy()]  # -1: the 0 at the end


#: Smallest IoU, in points, of a box with that of its segment.
SAME = 0.1
#: If at least this share of the segments in no mask has no box, `export --only-masked` has left them out.
LEFT_OUT = 0.75
#: A segment without a box joins the one in whose box it has more than this share of its points.
INSIDE = 0.5


class BoxEdits(NamedTuple):
    """What boxes change."""

    steps: Steps  #: joins, then names
    empty: tuple[int, ...]  #: boxes that are those of no segment
    stayed: int = 0  #: segments without a box, which lie in no other, or which `export --only-masked` left out


def edits_of_boxes(
    result: Result, boxes: Sequence[Box], superpoint: Table, is_text: bool = False, masked: Collection[int] = ()
) -> BoxEdits:
    """The corrections that edited boxes mean.

    Each box belongs to one segment: the pairs are taken by the IoU of the points in the box with those in the segment's
    own box, largest first (ties: the first box, the lowest id). So boxes that nobody edited change nothing. A segment
    whose box was deleted joins the segment of the smallest box that holds more than half of its points; otherwise it
    stays. The name of a box becomes that of the segment; without one, or with UNNAMED, the segment keeps its name: the
    file may be older than the name.

    Args:
        result: its labels are those from which the boxes were exported, with all corrections before.
        boxes: after the edits, in any order.
        superpoint: [N] the superpoint of each point, which does not change with corrections.
        is_text: they are OpenPCDet's, whose names have `_` for spaces.
        masked: what `export --only-masked` writes; if few others have a box, it was drawn anew, and none was deleted.
    """
    points, labels = upright_points(result.scene), result.points.numpy()
    own = boxes_of(result)
    inside = _members(boxes, points)
    segment_of = _matches(inside, _members([*own.values()], points), [*own])
    bare, others = own.keys() - segment_of.values(), own.keys() - masked
    left_out = bare & others if masked and len(bare & others) >= LEFT_OUT * len(others) else set()
    place, known = _places(result, superpoint), np.flatnonzero(labels >= 0)
    of_segment = csr_array((np.ones(len(known), np.int64), (known, labels[known])), shape=(len(points), len(place)))
    shares = ((inside @ of_segment) / np.maximum(of_segment.sum(0), 1)).tocsc()  # [B, S]
    steps: list[Edit] = []
    by_size = sorted(segment_of, key=lambda number: (np.prod(boxes[number].size), number))
    for segment in sorted(bare - left_out):
        held = shares[:, [segment]].toarray()[:, 0]
        if (holder := next((number for number in by_size if held[number] > INSIDE), None)) is not None:
            steps.append(Edit("join", (int(place[segment_of[holder]]), int(place[segment]))))
    empty = tuple(number for number in range(len(boxes)) if number not in segment_of)
    called = {one: _told(boxes[number].name) for number, one in segment_of.items()}
    _warn_of_emptied((name, result.segment_names.get(one, "")) for one, name in called.items())
    names = edits_of_names(result, called, superpoint, is_text)
    return BoxEdits((*steps, *names), empty, len(own) - len(segment_of) - len(steps))


def read_names(file: Path, result: Result) -> dict[int, str] | None:
    """Reads new names of segments in a table of `export`, format csv or geojson; None: the file has another suffix.

    An empty name changes nothing: the table may be older. Programs may have written ; for , and may have left out rows,
    or columns other than id, name and points.

    Raises:
        ValueError: it has no such columns, or a name is that of no segment of the result, or of one with other points.
    """
    rows: Iterable[Mapping[str, Any]]
    if (suffix := file.suffix.lower()) not in (".csv", ".geojson"):
        return None
    if suffix == ".geojson":
        rows = [one.record("properties").values for one in read_record(file, "footprints").records("features")]
    else:
        text = read_text(file, "a table of segments (save it as CSV UTF-8)", bounds.JSON_BYTES)
        rows = csv.DictReader(io.StringIO(text), delimiter=max(",;", key=text.partition("\n")[0].count))
    sizes = dict(enumerate(np.bincount(result.points[result.points >= 0].numpy()).tolist()))
    names, unchanged = [], []
    with damage_is(str(file), csv.Error):
        for number, row in enumerate(rows, 1 + (suffix == ".csv")):  # as QGIS and spreadsheets count
            if not {"id", "name", "points"} <= row.keys():
                raise ValueError(f"expected id, name and points of `export`, got {', '.join(map(str, row))[:100]}")
            segment, points = (_count(str(row[column])) for column in ("id", "points"))
            value, before = row["name"], result.segment_names.get(segment, "").strip()
            name = "" if value is None else printable(str(value).strip())  # a house number may be the integer 0
            if name in ("", before, no_formula(before)):
                unchanged.append((name, before))
                continue
            name = name[1:] if no_formula(name[1:]) == name else name  # csv_text's, before what is computed
            told = f"row {number}: {name!r}: segment {str(row['id'])[:20]}"
            if segment not in sizes:
                raise ValueError(f"{told}: expected the id of a segment; is it a table of another result?")
            if sizes[segment] != points:
                raise ValueError(f"{told}: {sizes[segment]} points, the table says {points}; export it again")
            names.append((segment, name))
    _warn_of_emptied(unchanged)
    return dict_of(names, f"{file}: id")


def _warn_of_emptied(names: Iterable[tuple[str, str]]) -> None:
    """Warns of empty names of a file, each of which comes with that of its segment."""
    if count := sum(bool(_told(before)) and not _told(name) for name, before in names):
        warnings.warn(f"{count} empty names change nothing; the viewer removes names", stacklevel=4)


def _count(text: str) -> int:
    """A whole number from 0, which a program may have written as 3.0; -1: anything else."""
    match = re.fullmatch(r"\s*(\d{1,9})([.,]0*)?\s*", text)
    return int(match[1]) if match else -1


def edits_of_names(result: Result, names: Mapping[int, str], superpoint: Table, is_text: bool = False) -> Steps:
    """The corrections that give segments their names; arguments as of :func:`edits_of_boxes`."""
    place, before = _places(result, superpoint), {one: name.strip() for one, name in result.segment_names.items()}
    return tuple(
        Edit("name", (int(place[segment]),), name.strip())
        for segment, name in sorted(names.items())
        if name.strip() not in ("", "_".join(before.get(segment, "").split()) if is_text else before.get(segment, ""))
    )


def without_older(steps: Steps, parts: Parts, before: Edits, file: Path) -> Steps:
    """Leaves out, with a warning, the steps of a file that take later corrections back: it was exported before these.

    They join a segment that a correction has made, or give a name that another by hand has replaced.

    Raises:
        ValueError: the segments that the file gathers are more like those before the last corrections.
    """
    after, table = parts.table(replace(before, steps=before.steps + steps)), parts.table(before)
    joined = {one: one.superpoints[1] for one in steps if one.kind == "join"}
    differences, older = [], set[Edit]()
    for now in parts.tables(before):
        both, own = (np.bincount(first_superpoints(one), parts.sizes) for one in (now * parts.count + after, now))
        differences.append(float(own @ own - 2 * both @ both))  # pairs of points of one segment in one table only
        older |= {one for one, place in joined.items() if ((now == now[place]) != (table == table[place])).any()}
    late = differences[::-1].index(min(differences))
    if late and any(step.kind == "gather" for step in steps):
        told = f"its things are more like those before the last joins or splits by hand ({late})"
        raise ValueError(f"{file}: {told}; export again, or undo these in the viewer, import, and make them again")
    by_hand = [(now[one.superpoints[0]], one.name.strip()) for one in before.steps if one.kind == "name"]
    names, given = parts.names(before), parts.result.segment_names
    for step in [one for one in steps if one.kind == "name"]:
        segment = now[step.superpoints[0]]
        if earlier := {name for place, name in by_hand if place == segment}:
            earlier |= {given.get(int(parts.stored[step.superpoints[0]]), "")}
            replaced = ("_".join(name.split()) for name in earlier - {names.get(segment, "").strip()})  # as OpenPCDet
            older |= {step} if "_".join(step.name.split()) in replaced else set()
    if older:
        told = ", ".join(sorted(repr(step.name) if step.name else "a join" for step in older))[:300]
        warnings.warn(f"{file}: as before later corrections, which stay (the viewer undoes them): {told}", stacklevel=3)
    return tuple(step for step in steps if step not in older)


def _places(result: Result, superpoint: Table) -> Table:
    """The largest superpoint of each segment, by which corrections know it: after a split a name stays with it."""
    labels = result.points.numpy()
    return _most(labels[labels >= 0], superpoint[labels >= 0], int(labels.max()) + 1)


def _members(boxes: Sequence[Box], points: npt.NDArray[np.float64]) -> csr_array:
    """[B, N] 1: the point is in the box. A table of all would fill the memory: most points are in few boxes."""
    inside = [np.flatnonzero(box.holds(points)) for box in boxes]
    ends, columns = np.cumsum([0, *map(len, inside)]), np.concatenate([np.empty(0, np.int64), *inside])
    return csr_array((np.ones(len(columns), np.int64), columns, ends), shape=(len(boxes), len(points)))


def _told(name: str) -> str:
    """A name as it comes back in a file."""
    return "" if name.strip() == UNNAMED else name.strip()


def _matches(inside: csr_array, own: csr_array, segments: Sequence[int]) -> dict[int, int]:
    """The segment of each box that has one; `own`: the members of each segment's box."""
    shared = (inside @ own.T).tocoo()
    either = inside.sum(1)[shared.row] + own.sum(1)[shared.col] - shared.data
    pairs = zip(-shared.data / either, shared.row.tolist(), shared.col.tolist(), strict=True)
    found = each_once((number, place) for iou, number, place in sorted(pairs) if -iou >= SAME)
    return {number: segments[place] for number, place in found.items()}


#: Longest time to wait until another program has saved, seconds: a viewer saves each correction once.
PATIENCE = 5.0


def save_edits(folder: Path, edits: Edits, before: Edits, parts: Parts) -> Edits:
    """Saves corrections together with those that others have saved meanwhile.

    Args:
        folder: the result.
        edits: the corrections.
        before: those that were read, or saved last, before they became `edits`.
        parts: of the result.

    Returns:
        what edits.json now holds: the corrections of the others, then the own ones.
    """
    with lock(folder / f".{FILE}.lock", f"{folder / FILE}: another program is saving; save again", PATIENCE):
        saved = read_edits(folder, edits.num_superpoints)
        theirs = saved.steps if (folder / FILE).exists() else before.steps  # who has moved the file, has undone nothing
        if saved.of != edits.of:
            raise ValueError(f"{folder}: expected the result that was opened, got another; not saved, open it again")
        merged = replace(edits, steps=merged_steps(before.steps, theirs, edits.steps))
        try:
            parts.names(merged)
        except ValueError as error:
            expected = "expected corrections that go with those that others have saved meanwhile"
            raise ValueError(f"{folder / FILE}: {expected}: {error}; undo some, and save again") from error
        write_edits(folder, merged)
    return merged


def merged_steps(before: Steps, theirs: Steps, own: Steps) -> Steps:
    """What two made of the same corrections, in one: what either has undone is undone; then theirs, then the own.

    What both have added first counts once.

    Example:
        >>> a, b, c = (Edit("join", (0, superpoint)) for superpoint in (1, 2, 3))
        >>> merged_steps((a,), (a, b), (c,)) == (b, c)
        True
    """
    of_theirs, of_own = _common(before, theirs), _common(before, own)
    added = tuple(one for one in theirs[of_theirs:] if one in own or one not in before[of_theirs:])
    return (*before[: min(of_theirs, of_own)], *added, *own[of_own + _common(added, own[of_own:]) :])


def _common(one: Steps, other: Steps) -> int:
    """The number of steps with which both begin."""
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(one, other, strict=False)))
