"""Corrections of a result from labels of its points that were edited elsewhere (output after step 8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from torchjoint.datasets.files.text import read_record
from torchjoint.results.edits import Edit, Edits
from torchjoint.results.parts import Parts
from torchjoint.runtime.messages import printable

Array = npt.NDArray[np.int64]


class PointLabels(NamedTuple):
    """Objects of Segments.ai, by their ids."""

    of_point: Array  #: [N] the object of each point; 0: none
    names: Mapping[int, str]  #: of the objects whose attribute `name` is in the file


def read_point_labels(file: Path, num_points: int) -> PointLabels | None:
    """Reads a label of segmentation of Segments.ai (docs.segments.ai, label types); None: the file is none.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    if file.suffix.lower() != ".json":
        return None
    record = read_record(file, "boxes or labels of points")
    record = record.record("attributes") if "attributes" in record else record  # of a whole label
    if "point_annotations" not in record:
        return None
    of_point, names = record.integers("point_annotations"), {}
    if len(of_point) != num_points:
        raise ValueError(f"{file}: point_annotations: expected ids >= 0 of {num_points} points, got {len(of_point)}")
    if (lowest := int(of_point.min(initial=0))) < 0:
        raise ValueError(f"{file}: point_annotations: expected ids >= 0, got {lowest}")
    for one in record.records("annotations"):
        if "attributes" in one and "name" in one.record("attributes"):
            name = one.record("attributes").text("name").strip()
            names[int(one.number("id"))] = printable(name)
    return PointLabels(of_point, names)


def edits_of_points(parts: Parts, before: Edits, labels: PointLabels) -> tuple[tuple[Edit, ...], int]:
    """The corrections that edited labels mean.

    A piece belongs to the object that most of its points have; if that is none, to the object that most points of its
    segment have. All pieces of an object become one segment, unless they are one already. So labels that nobody edited
    change nothing, and a segment whose points have no object any more stays.

    Args:
        parts: of the result.
        before: the corrections with which the labels were exported.
        labels: after the edits.

    Returns:
        the corrections; and how many points have another object than their piece.
    """
    table = parts.table(before)
    labelled = labels.of_point > 0
    of_piece = _most(parts.of_point, labels.of_point, parts.count)
    of_segment = _most(table[parts.of_point[labelled]], labels.of_point[labelled], parts.count)
    of_piece = np.where(of_piece > 0, of_piece, of_segment[table])
    found, sizes = np.unique(of_piece[parts.of_point], return_counts=True)
    pieces_of = {one: np.flatnonzero(of_piece == one) for one in found[np.argsort(-sizes, kind="stable")] if one > 0}
    gathered: list[Edit] = []
    kept: set[int] = set()
    for pieces in pieces_of.values():
        segments = set(table[pieces].tolist())
        if len(segments) == 1 and not segments & kept:
            kept |= segments  # the largest object of a segment is what the others leave
        else:
            gathered.append(Edit("gather", tuple(pieces.tolist())))
    after = replace(before, steps=(*before.steps, *gathered))
    table, names = parts.table(after), parts.names(after)
    first = {one: int(pieces[0]) for one, pieces in pieces_of.items()}
    named = [
        Edit("name", (first[one],), name)
        for one, name in sorted(labels.names.items())
        if one in first and name != names.get(int(table[first[one]]), "")
    ]
    lost = int((labelled & (labels.of_point != of_piece[parts.of_point])).sum())
    return (*gathered, *named), lost


def _most(group: Array, ids: Array, count: int) -> Array:
    """[count] the id that most members of a group have, the lowest of several; 0: the group has no members."""
    numbers, of_member = np.unique(ids, return_inverse=True)
    pairs, sizes = np.unique(group * len(numbers) + of_member, return_counts=True)
    groups, of_pair = np.divmod(pairs, max(len(numbers), 1))
    order = np.lexsort((-of_pair, sizes))
    most = np.zeros(count, dtype=np.int64)
    most[groups[order]] = numbers[of_pair[order]]  # the last of a group stays
    return most
