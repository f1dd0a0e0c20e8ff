"""Corrections by hand (output after step 8): segments joined, split, gathered and named, on top of the labels.

An edit names a segment by one of its pieces, so it means the same at every level. A name also has the level at which it
was given: it belongs to that segment and to finer ones. edits.json holds the edits; the labels on disk stay the same.
It also holds the checksum of the result's manifest: another result of as many pieces has other pieces.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from torchjoint import ops
from torchjoint.results.manifest import manifest_checksum
from torchjoint.runtime.files import write_text
from torchjoint.runtime.foreign_files import damage_is, has_file, read_json
from torchjoint.runtime.messages import printable
from torchjoint.scene import Hierarchy
from torchjoint.scene.hierarchy import check_granularity

Table = npt.NDArray[np.int64]
#: A split gives parts with at least this share of the points, if possible. The last merges of a large segment often add
#: tiny parts: in 15 of the demo's 25 largest segments the last merge adds less than a twentieth of the points.
LEAST_SHARE = 0.05


def split(table: Table, pieces: tuple[int, ...], hierarchy: Hierarchy | None) -> Table:
    """Splits a segment.

    Args:
        table: [P] the segment of each piece; the number of a segment is that of its first piece.
        pieces: one piece: its segment is divided where its last merge, or a join by hand, joined it. Three pieces: the
            segment of the first is divided at the merge of the other two; if that merge is not in it, nothing changes.
        hierarchy: of the pieces.

    Returns:
        [P] the table after the split; the part without the segment's first piece is the new segment.
    """
    if hierarchy is None:
        raise ValueError("split: expected a hierarchy, got none; point_segments.method paper makes none")
    inside = table == table[pieces[0]]
    merges, heights = hierarchy.merges.numpy(), hierarchy.heights.numpy()
    own = np.nonzero(inside[merges].all(axis=1))[0]
    if len(pieces) == 3:
        cut = np.nonzero((merges == pieces[1:]).all(axis=1))[0]
        if not len(cut):
            raise ValueError(f"split: expected a merge of the hierarchy, got pieces {pieces[1]} and {pieces[2]}")
        if cut[0] not in own:
            return table
        parts = _parts(np.delete(merges[own], np.searchsorted(own, cut[0]), axis=0), len(table))
        away = pieces[1] if parts[pieces[2]] == parts[table[pieces[0]]] else pieces[2]
        rest = inside & (parts == parts[away])
    else:
        if inside.sum() < 2:
            raise ValueError(f"split: expected a segment of several pieces, got {int(table[pieces[0]])} with one")
        parts = _parts(merges[own], len(table))
        if len(np.unique(parts[inside])) == 1:  # undo the last merge
            parts = _parts(np.delete(merges[own], _last(heights[own]), axis=0), len(table))
        rest = inside & (parts != parts[table[pieces[0]]])
    table = table.copy()
    table[rest] = np.nonzero(rest)[0][0]
    return table


def place_to_split(table: Table, piece: int, sizes: Table, hierarchy: Hierarchy | None) -> tuple[int, ...]:
    """Chooses where to split a segment; returns the argument `pieces` of :func:`split`.

    If the segment was joined by hand, the join is undone. Otherwise it is the last merge whose removal leaves two parts
    with at least LEAST_SHARE of the points each; if there is no such merge, the last merge.

    Args:
        table: [P] the segment of each piece.
        piece: of the segment.
        sizes: [P] points of each piece.
        hierarchy: of the pieces.
    """
    inside = table == table[piece]
    if hierarchy is None or inside.sum() < 2:
        return (piece,)  # split() raises the error
    merges, heights = hierarchy.merges.numpy(), hierarchy.heights.numpy()
    own = np.nonzero(inside[merges].all(axis=1))[0]
    if len(own) < inside.sum() - 1:  # not connected by merges: joined by hand
        return (piece,)
    smaller = _smaller_sides(merges[own], np.where(inside, sizes, 0), int(table[piece]))
    large = smaller >= LEAST_SHARE * sizes[inside].sum()
    cut = own[large][_last(heights[own[large]])] if large.any() else own[_last(heights[own])]
    return piece, *(int(end) for end in merges[cut])


def _last(heights: npt.NDArray[np.float64]) -> int:
    """The index of the last merge: of the greatest height, and of equal heights the last."""
    return len(heights) - 1 - int(np.argmax(heights[::-1]))


def _smaller_sides(tree: Table, sizes: Table, root: int) -> Table:
    """[M] for each merge of a tree [M, 2], the points of the smaller part that remains without this merge."""
    count = len(sizes)
    graph = coo_array((np.ones(len(tree), dtype=bool), (tree[:, 0], tree[:, 1])), shape=(count, count))
    order, parent = breadth_first_order(graph.tocsr(), root, directed=False)
    below = sizes.copy()
    for node in order[:0:-1]:  # from the leaves up to the root
        below[parent[node]] += below[node]
    child = np.where(parent[tree[:, 0]] == tree[:, 1], tree[:, 0], tree[:, 1])
    return np.minimum(below[child], below[root] - below[child])


def _parts(merges: Table, count: int) -> Table:
    parts: Table = ops.connected_components(torch.from_numpy(merges).t(), count).numpy()
    return parts


FILE = "edits.json"
#: Most characters of a segment's name.
LONGEST = 200


@dataclass(frozen=True)
class Edit:
    """One correction.

    Attributes:
        kind: join: the segments of two pieces become one. split: the segment of a piece is divided where its last merge
            joined it; with three pieces, where the merge of the other two joined it. gather: these pieces leave their
            segments and become one. name: the segment of a piece gets a name; "" removes its name.
        pieces: one piece, the two of a join, the three of a split at a merge, or all of a gathered segment.
        name: of a segment.
        granularity: the level at which the name was given; None: the labels of the result.
    """

    kind: Literal["join", "split", "gather", "name"]
    pieces: tuple[int, ...]
    name: str = ""
    granularity: float | None = None


@dataclass(frozen=True)
class Edits:
    """Corrections, in the order in which they were made."""

    num_pieces: int  #: number of pieces of the result's hierarchy; without a hierarchy, of its segments
    granularity: float | None = None  #: the level that was corrected; None: the labels of the result
    steps: tuple[Edit, ...] = ()  #: the corrections
    of: str | None = None  #: the checksum of the result's manifest; None: not known

    def apply(self, table: Table, hierarchy: Hierarchy | None) -> Table:
        """Applies the corrections to a level.

        Args:
            table: [P] the segment of each piece, any numbers.
            hierarchy: of the pieces; if None, no segment can be split.

        Returns:
            [P] the segment of each piece; the number of a segment is that of its first piece.
        """
        table = first_pieces(table)
        for step in self.steps:
            if step.kind == "join":
                ends = [table[piece] for piece in step.pieces]
                table[np.isin(table, ends)] = min(ends)
            elif step.kind == "split":
                table = split(table, step.pieces, hierarchy)
            elif step.kind == "gather":
                inside = np.flatnonzero(np.isin(table, table[list(step.pieces)]))  # others stay as they are
                table[list(step.pieces)] = len(table)
                table[inside] = inside[first_pieces(table[inside])]
        return table


def first_pieces(table: Table) -> Table:
    """Numbers each segment by its first piece: [P] any numbers -> [P]."""
    _, first, inverse = np.unique(table, return_index=True, return_inverse=True)
    return first[inverse].astype(np.int64)


def write_edits(folder: Path, edits: Edits) -> None:
    """Writes edits.json into a result's folder; the file is replaced as a whole."""
    steps = [asdict(one) if one.kind == "name" else {"kind": one.kind, "pieces": one.pieces} for one in edits.steps]
    lines = ",\n".join(json.dumps(step, ensure_ascii=False) for step in steps)
    head = f'"result": {json.dumps(edits.of)}, "pieces": {edits.num_pieces}'
    head = f'{head}, "granularity": {json.dumps(edits.granularity)}'
    write_text(folder / FILE, f'{{{head}, "edits": [\n{lines}\n]}}\n')


def read_edits(folder: Path, num_pieces: int) -> Edits:
    """The corrections of a result; none without edits.json. Files of 0.1.0 do not say of which result they are."""
    file, own = folder / FILE, manifest_checksum(folder)
    if not has_file(file):
        return Edits(num_pieces, of=own)
    with damage_is(f"{file}: not a list of edits"):
        record = read_json(file, "a list of edits")
        granularity = _level(record["granularity"])
        # In files of 0.1.0 a name has no level of its own: the level of the file was the last to be seen.
        steps = tuple(_parse({"granularity": granularity, **step}, num_pieces) for step in record["edits"])
        found, of = _integer(record["pieces"]), record.get("result")
    if found != num_pieces:
        raise ValueError(f"{file}: expected edits of {num_pieces} pieces, got {found}; of another result?")
    if None not in (of, own) and of != own:
        raise ValueError(f"{file}: expected edits of this result, got those of another; move the file away")
    return Edits(num_pieces, granularity, steps, own)


def _parse(step: Mapping[str, Any], num_pieces: int) -> Edit:
    kind, pieces, name = step["kind"], tuple(_integer(piece) for piece in step["pieces"]), step.get("name", "")
    lengths = {"join": (2,), "split": (1, 3), "gather": range(1, num_pieces + 1), "name": (1,)}
    if len(pieces) not in lengths.get(kind, ()):
        raise ValueError(f"expected an edit, got {dict(step)}")
    if not all(0 <= piece < num_pieces for piece in pieces):
        raise ValueError(f"expected pieces below {num_pieces}, got {dict(step)}")
    if not isinstance(name, str) or printable(name) != name:
        raise ValueError(f"name: expected a text, got {name!r}")
    return Edit(kind, pieces, name, _level(step["granularity"])) if kind == "name" else Edit(kind, pieces)


def _level(value: Any) -> float | None:
    if value is not None:
        check_granularity(value)
    return None if value is None else float(value)


def _integer(value: object) -> int:
    if type(value) is not int:
        raise ValueError(f"pieces: expected an integer, got {value!r}")
    return value
