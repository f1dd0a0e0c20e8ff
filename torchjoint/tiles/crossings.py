"""Small superpoints on the edge between two tiles: one of the tiles decides on the whole superpoint.

A point has the label of the tile that owns it. Where two tiles disagree, a superpoint of one tile would therefore end
at the edge: of 40 points that one tile sees as a superpoint, and the other as a part of the street, 15 would be a
superpoint, and 25 street. So a superpoint that both tiles see completely, and that has points of both, belongs to the
tile that owns most of them. Its home gives it the points on the other side. On the other side, the points of a
superpoint whose home is here get the labels of here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from torchjoint.tiles.tile import TileLabels

Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


class Changes(NamedTuple):
    """Points that get the label of a superpoint of a tile that does not own them."""

    point: Ints  #: [C] ascending
    tile: Ints  #: [C] 0: the first of two tiles, 1: the second
    superpoint: Ints  #: [C] of that tile


class _Side(NamedTuple):
    """What a tile says of the points that two tiles have in common."""

    label: Ints  #: [n] of each common point
    owned: Bools  #: [n] whether the tile owns it
    size: Ints  #: [K] points of each superpoint
    crosses: Bools  #: [K] seen completely by both tiles, with points of both, and without a partner
    is_home: Bools  #: [K] crosses, and this tile owns most of it


def changes_at_crossings(one: TileLabels, other: TileLabels, partners: Ints) -> Changes:
    """The points of two tiles that get the label of the tile that does not own them.

    Args:
        one, other: labels of two tiles.
        partners: [P, 2] superpoints that are the same, as of :func:`~torchjoint.tiles.stitching.matching_superpoints`.
    """
    common = np.intersect1d(one.shared, other.shared, assume_unique=True)
    owned = [_contains(tile.own, common) for tile in (one, other)]
    sides = [
        _side(tile, common, owned[number], owned[1 - number], partners[:, number], number == 0)
        for number, tile in enumerate((one, other))
    ]
    here, there = sides
    new = np.full(len(common), -1, np.int64)  # the tile whose label a point gets
    for number, (to, of) in enumerate(((here, there), (there, here))):
        inside, own = to.is_home[to.label], of.owned
        smaller = of.is_home[of.label] & (of.size[of.label] <= to.size[to.label])  # a hole in the larger one
        leaves = of.crosses[of.label] & ~of.is_home[of.label] & (to.size[to.label] > 0)
        new[own & ((inside & ~smaller) | leaves)] = number
    chosen = new >= 0
    label = np.where(new == 0, here.label, there.label)
    return Changes(common[chosen], new[chosen], label[chosen])


def _side(tile: TileLabels, common: Ints, owned: Bools, others: Bools, partnered: Ints, wins_ties: bool) -> _Side:
    label = tile.shared_label[np.searchsorted(tile.shared, common)].astype(np.int64)
    count = int(max(tile.own_label.max(initial=-1), tile.shared_label.max(initial=-1))) + 1
    buffer = tile.shared_label[~_contains(tile.own, tile.shared)]
    size = np.bincount(tile.own_label, minlength=count) + np.bincount(buffer, minlength=count)
    mine, theirs = np.bincount(label[owned], minlength=count), np.bincount(label[others], minlength=count)
    crosses = (np.bincount(label, minlength=count) == size) & (mine > 0) & (theirs > 0)
    crosses[partnered] = False
    return _Side(label, owned, size, crosses, crosses & ((mine >= theirs) if wins_ties else (mine > theirs)))


def _contains(numbers: Ints, wanted: Ints) -> Bools:
    """Whether each wanted number is among ascending numbers."""
    if not len(numbers):
        return np.zeros(len(wanted), bool)
    place = np.minimum(np.searchsorted(numbers, wanted), len(numbers) - 1)
    found: Bools = numbers[place] == wanted
    return found
