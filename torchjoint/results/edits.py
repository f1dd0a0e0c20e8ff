"""Corrections by hand (output after step 8): segments joined, split, gathered and named, on top of the labels.

An edit names a segment by one of its superpoints, so it means the same at every level. A name also has the level at
which it was given: it belongs to that segment and to finer ones. edits.json holds the edits; the labels on disk stay.
It also holds the checksum of the result's manifest: another result of as many superpoints has other superpoints.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from torchjoint import ops
from torchjoint.results.manifest import check_same, manifest_checksum
from torchjoint.runtime import bounds
from torchjoint.runtime.files import write_text
from torchjoint.runtime.foreign_files import damage_is, has_file, read_json
from torchjoint.runtime.messages import printable
from torchjoint.scene import Hierarchy
from torchjoint.scene.hierarchy import check_granularity

Table = npt.NDArray[np.int64]
#: A split gives parts with at least this share of the points, if possible. The last merges of a large segment often add
#: tiny parts: in 15 of the demo's 25 largest segments the last merge adds less than a twentieth of the points.
LEAST_SHARE = 0.05


def split(table: Table, superpoints: tuple[int, ...], hierarchy: Hierarchy | None) -> Table:
    """Splits a segment.

    Args:
        table: [P] the segment of each superpoint; the number of a segment is that of its first superpoint.
        superpoints: one superpoint: its segment is divided where its last merge, or a join by hand, joined it. Three
            superpoints: the segment of the first is divided at the merge of the other two. Nothing changes if that
            merge is not in it, or if it is one superpoint, as at another level.
        hierarchy: of the superpoints.

    Returns:
        [P] the table after the split; the part without the segment's first superpoint is the new segment.
    """
    if hierarchy is None:
        raise ValueError("split: expected a hierarchy, got none; point_segments.method paper makes none")
    inside = table == table[superpoints[0]]
    merges, heights = hierarchy.merges.numpy(), hierarchy.heights.numpy()
    own = np.nonzero(inside[merges].all(axis=1))[0]
    if len(superpoints) == 3:
        cut = np.nonzero((merges == superpoints[1:]).all(axis=1))[0]
        if not len(cut):
            raise ValueError(f"split: expected a merge of the hierarchy, got superpoints {superpoints[1:]}")
        if cut[0] not in own:
            return table
        parts = _parts(np.delete(merges[own], np.searchsorted(own, cut[0]), axis=0), len(table))
        away = superpoints[1] if parts[superpoints[2]] == parts[table[superpoints[0]]] else superpoints[2]
        rest = inside & (parts == parts[away])
    elif inside.sum() < 2:
        return table
    else:
        parts = _parts(merges[own], len(table))
        if len(np.unique(parts[inside])) == 1:  # undo the last merge
            parts = _parts(np.delete(merges[own], _last(heights[own]), axis=0), len(table))
        rest = inside & (parts != parts[table[superpoints[0]]])
    table = table.copy()
    table[rest] = np.nonzero(rest)[0][0]
    return table


def place_to_split(table: Table, superpoint: int, sizes: Table, hierarchy: Hierarchy | None) -> tuple[int, ...]:
    """Chooses where to split a segment; returns the argument `superpoints` of :func:`split`.

    If the segment was joined by hand, the join is undone. Otherwise it is the last merge whose removal leaves two parts
    with at least LEAST_SHARE of the points each; if there is no such merge, the last merge.

    Args:
        table: [P] the segment of each superpoint.
        superpoint: of the segment.
        sizes: [P] points of each superpoint.
        hierarchy: of the superpoints.

    Raises:
        ValueError: the segment is one superpoint.
    """
    inside = table == table[superpoint]
    if hierarchy is None:
        return (superpoint,)  # split() raises the error
    if inside.sum() < 2:
        raise ValueError(f"split: expected a segment of several superpoints, got {table[superpoint]} with one")
    merges, heights = hierarchy.merges.numpy(), hierarchy.heights.numpy()
    own = np.nonzero(inside[merges].all(axis=1))[0]
    if len(own) < inside.sum() - 1:  # not connected by merges: joined by hand
        return (superpoint,)
    smaller = _smaller_sides(merges[own], np.where(inside, sizes, 0), int(table[superpoint]))
    large = smaller >= LEAST_SHARE * sizes[inside].sum()
    cut = own[large][_last(heights[own[large]])] if large.any() else own[_last(heights[own])]
    return superpoint, *(int(end) for end in merges[cut])


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
    return ops.connected_components(torch.from_numpy(merges).t(), count).numpy()


FILE = "edits.json"
#: Most characters of a segment's name.
LONGEST = 200


@dataclass(frozen=True)
class Edit:
    """One correction.

    Attributes:
        kind: join: the segments of two superpoints become one. split: the segment of a superpoint is divided where its
            last merge joined it; with three superpoints, where the merge of the other two joined it. gather: these
            superpoints leave their segments and become one. name: the segment of a superpoint gets a name; "" removes
            its name.
        superpoints: one, the two of a join, the three of a split at a merge, or all of a gathered segment.
        name: of a segment.
        granularity: the level at which the name was given; None: the labels of the result.
    """

    kind: Literal["join", "split", "gather", "name"]
    superpoints: tuple[int, ...]
    name: str = ""
    granularity: float | None = None


@dataclass(frozen=True)
class Edits:
    """Corrections, in the order in which they were made."""

    num_superpoints: int  #: number of superpoints of the result's hierarchy; without a hierarchy, of its segments
    granularity: float | None = None  #: the level that was corrected; None: the labels of the result
    steps: tuple[Edit, ...] = ()  #: the corrections
    of: str | None = None  #: the checksum of the result's manifest; None: not known

    def tables(self, table: Table, hierarchy: Hierarchy | None) -> Iterator[Table]:
        """The segment of each superpoint [P] before the corrections, and after each that changes it.

        Args:
            table: [P] the segments of a level, any numbers; a segment gets the number of its first superpoint.
            hierarchy: of the superpoints; if None, no segment can be split.
        """
        yield (table := first_superpoints(table))
        for step in (one for one in self.steps if one.kind != "name"):
            if step.kind == "join":
                one, other = sorted(table[list(step.superpoints)].tolist())
                if one == other:  # at most P - 1 joins change something
                    continue
                table = np.where(table == other, one, table)
            elif step.kind == "split":
                table = split(table, step.superpoints, hierarchy)
            elif step.kind == "gather":
                inside = np.flatnonzero(np.isin(table, table[list(step.superpoints)]))  # others stay as they are
                table = table.copy()
                table[list(step.superpoints)] = len(table)
                table[inside] = inside[first_superpoints(table[inside])]
            yield table


def first_superpoints(table: Table) -> Table:
    """Numbers each segment by its first superpoint: [P] any numbers -> [P]."""
    _, first, inverse = np.unique(table, return_index=True, return_inverse=True)
    return first[inverse].astype(np.int64)


def write_edits(folder: Path, edits: Edits) -> None:
    """Writes edits.json into a result's folder; the file is replaced as a whole."""
    steps = [{"kind": one.kind, "pieces": one.superpoints} | _named(one) for one in edits.steps]
    lines = ",\n".join(json.dumps(step, ensure_ascii=False) for step in steps)
    head = {"result": edits.of, "pieces": edits.num_superpoints, "granularity": edits.granularity}
    write_text(folder / FILE, f'{json.dumps(head)[:-1]}, "edits": [\n{lines}\n]}}\n')


def _named(one: Edit) -> dict[str, Any]:
    return {"name": one.name, "granularity": one.granularity} if one.kind == "name" else {}


def read_edits(folder: Path, num_superpoints: int, opened: str | None = None) -> Edits:
    """The corrections of a result; none without edits.json. Files of 0.1.0 do not say of which result they are.

    `opened` is the manifest of the result that was read before, which must still be there.
    """
    file, own = folder / FILE, manifest_checksum(folder)
    check_same(folder, opened)
    if not has_file(file):
        return Edits(num_superpoints, of=own)
    with damage_is(f"{file}: not a list of edits"):
        record = read_json(file, "a list of edits")
        granularity = _level(record["granularity"])
        # In files of 0.1.0 a name has no level of its own: the level of the file was the last to be seen.
        steps = tuple(_parse({"granularity": granularity, **step}, num_superpoints) for step in record["edits"])
        found, of = _integer(record["pieces"]), record.get("result")
        levels = {one.granularity for one in steps if one.kind == "name"}
        bounds.check(len(levels) * len(steps), bounds.LEVEL_STEPS, "corrections times levels of names")
    if found != num_superpoints:
        raise ValueError(f"{file}: expected edits of {num_superpoints} superpoints, got {found}; of another result?")
    if None not in (of, own) and of != own:
        raise ValueError(f"{file}: expected edits of this result, got those of another; move the file away")
    return Edits(num_superpoints, granularity, steps, own)


def _parse(step: Mapping[str, Any], num_superpoints: int) -> Edit:
    kind, name = step["kind"], step.get("name", "")
    superpoints = tuple(_integer(superpoint) for superpoint in step["pieces"])
    lengths = {"join": (2,), "split": (1, 3), "gather": range(1, num_superpoints + 1), "name": (1,)}
    if len(superpoints) not in lengths.get(kind, ()):
        raise ValueError(f"expected an edit, got {dict(step)}")
    if not all(0 <= superpoint < num_superpoints for superpoint in superpoints):
        raise ValueError(f"expected superpoints below {num_superpoints}, got {dict(step)}")
    if not isinstance(name, str) or printable(name) != name:
        raise ValueError(f"name: expected a text, got {name!r}")
    return Edit(kind, superpoints, name, _level(step["granularity"])) if kind == "name" else Edit(kind, superpoints)


def _level(value: Any) -> float | None:
    if value is not None:
        check_granularity(value)
    return None if value is None else float(value)


def _integer(value: object) -> int:
    if type(value) is not int:
        raise ValueError(f"superpoints: expected an integer, got {value!r}")
    return value
