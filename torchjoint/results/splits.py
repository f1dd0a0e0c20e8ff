"""Splits by hand (output after step 8): where in the tree of merges a segment falls in two."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from torchjoint import ops
from torchjoint.scene import Hierarchy

Table = npt.NDArray[np.int64]
#: A split gives parts with at least this share of the points, if any does. The last merges of a large segment mostly
#: add crumbs: of the 25 largest segments of the demo, the last merge of 15 adds less than a twentieth of the points.
LEAST_SHARE = 0.05


def split(table: Table, pieces: tuple[int, ...], hierarchy: Hierarchy | None) -> Table:
    """Splits a segment.

    Args:
        table: [P] the segment of each piece, which has the number of its first piece.
        pieces: one piece: its segment falls in two at its last merge, or in what was joined by hand. Three pieces: its
            segment falls in two at the merge of the other two; if these are in other segments already, nothing changes.
        hierarchy: of the pieces.

    Returns:
        [P] the table after the split; the part without the segment's first piece is the new segment.

    Raises:
        ValueError: there is no hierarchy, no merge of the two pieces, or the segment is a single piece.
    """
    if hierarchy is None:
        raise ValueError("split: the result has no hierarchy; only point_segments.method learned makes one")
    inside = table == table[pieces[0]]
    merges, heights = hierarchy.merges.numpy(), hierarchy.heights.numpy()
    own = np.nonzero(inside[merges].all(axis=1))[0]
    if len(pieces) == 3:
        cut = np.nonzero((merges == pieces[1:]).all(axis=1))[0]
        if not len(cut):
            raise ValueError(f"split: pieces {pieces[1]} and {pieces[2]} are no merge of the hierarchy")
        if cut[0] not in own:
            return table
        parts = _parts(np.delete(merges[own], np.searchsorted(own, cut[0]), axis=0), len(table))
        away = pieces[1] if parts[pieces[2]] == parts[table[pieces[0]]] else pieces[2]
        rest = inside & (parts == parts[away])
    else:
        if inside.sum() < 2:
            raise ValueError(f"split: segment {int(table[pieces[0]])} is one piece, the smallest part there is")
        parts = _parts(merges[own], len(table))
        if len(np.unique(parts[inside])) == 1:  # undo the last merge
            parts = _parts(np.delete(merges[own], _last(heights[own]), axis=0), len(table))
        rest = inside & (parts != parts[table[pieces[0]]])
    table = table.copy()
    table[rest] = np.nonzero(rest)[0][0]
    return table


def place_to_split(table: Table, piece: int, sizes: Table, hierarchy: Hierarchy | None) -> tuple[int, ...]:
    """The pieces that say where to split a segment, for :func:`split`.

    It is the last merge of two parts of which each has at least LEAST_SHARE of the points, as far as one merge takes
    them apart; the last merge, if there is none like this; or what was joined by hand.

    Args:
        table: [P] the segment of each piece.
        piece: of the segment.
        sizes: [P] points of each piece.
        hierarchy: of the pieces.
    """
    inside = table == table[piece]
    if hierarchy is None or inside.sum() < 2:
        return (piece,)  # which raises what is wrong
    merges, heights = hierarchy.merges.numpy(), hierarchy.heights.numpy()
    own = np.nonzero(inside[merges].all(axis=1))[0]
    if len(own) < inside.sum() - 1:  # not connected by merges
        return (piece,)
    smaller = _smaller_sides(merges[own], np.where(inside, sizes, 0), int(table[piece]))
    large = smaller >= LEAST_SHARE * sizes[inside].sum()
    cut = own[large][_last(heights[own[large]])] if large.any() else own[_last(heights[own])]
    return piece, *(int(end) for end in merges[cut])


def _last(heights: npt.NDArray[np.float64]) -> int:
    """The place of the last merge; of equal heights, of the later one."""
    return len(heights) - 1 - int(np.argmax(heights[::-1]))


def _smaller_sides(tree: Table, sizes: Table, root: int) -> Table:
    """[M] the points of the smaller part, if one merge of a tree [M, 2] is taken away."""
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
