"""Splits a segment by hand, at a merge of the hierarchy (output after step 8)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from torchjoint import ops
from torchjoint.scene import Hierarchy

SplitTable = npt.NDArray[np.int64]
#: A split gives parts with at least this share of the points, if possible. The last merges of a large segment often add
#: tiny parts: in 15 of the demo's 25 largest segments the last merge adds less than a twentieth of the points.
LEAST_SHARE = 0.05


def split(table: SplitTable, pieces: tuple[int, ...], hierarchy: Hierarchy | None) -> SplitTable:
    """Splits a segment.

    Args:
        table: [P] the segment of each piece; the number of a segment is that of its first piece.
        pieces: one piece: its segment is divided where its last merge, or a join by hand, joined it. Three pieces: the
            segment of the first is divided at the merge of the other two; if that merge is not in it, nothing changes.
        hierarchy: of the pieces.

    Returns:
        [P] the table after the split; the part without the segment's first piece is the new segment.

    Raises:
        ValueError: there is no hierarchy, the two pieces are no merge, or the segment is a single piece.
    """
    if hierarchy is None:
        raise ValueError("split: expected a hierarchy, got none; only point_segments.method learned makes one")
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


def place_to_split(table: SplitTable, piece: int, sizes: SplitTable, hierarchy: Hierarchy | None) -> tuple[int, ...]:
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


def _smaller_sides(tree: SplitTable, sizes: SplitTable, root: int) -> SplitTable:
    """[M] for each merge of a tree [M, 2], the points of the smaller part that remains without this merge."""
    count = len(sizes)
    graph = coo_array((np.ones(len(tree), dtype=bool), (tree[:, 0], tree[:, 1])), shape=(count, count))
    order, parent = breadth_first_order(graph.tocsr(), root, directed=False)
    below = sizes.copy()
    for node in order[:0:-1]:  # from the leaves up to the root
        below[parent[node]] += below[node]
    child = np.where(parent[tree[:, 0]] == tree[:, 1], tree[:, 0], tree[:, 1])
    return np.minimum(below[child], below[root] - below[child])


def _parts(merges: SplitTable, count: int) -> SplitTable:
    parts: SplitTable = ops.connected_components(torch.from_numpy(merges).t(), count).numpy()
    return parts
