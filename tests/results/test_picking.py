"""Segments by points and pixels that somebody chose."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import torchjoint as tj
from torchjoint.scene import Hierarchy

#: Six superpoints, one point each: ((0 1) .2, (2 3) .4) .6, (4 5) .3, and all at .9.
MERGES = torch.tensor([[0, 1], [2, 3], [1, 2], [4, 5], [0, 5]])
HEIGHTS = torch.tensor([0.2, 0.4, 0.6, 0.3, 0.9], dtype=torch.float64)


def result_of(hierarchy, image=None):
    points = torch.arange(len(hierarchy.superpoint), dtype=torch.float32)[:, None] * torch.tensor([1.0, 0, 0])
    frames = [] if image is None else [tj.Frame(torch.zeros(3, *image.shape), torch.eye(3), torch.eye(4))]
    labels = hierarchy.at()
    images = [] if image is None else [torch.where(image >= 0, labels[image.clamp(min=0)], 9)]
    segmentation = tj.Segmentation(labels, images, names=("a",) * len(images), hierarchy=hierarchy)
    segmentation = (
        segmentation
        if image is None
        else tj.Segmentation(labels, images, names=("a",), hierarchy=hierarchy, superpoint_images=[image])
    )
    return tj.Result.of(segmentation, tj.Scene(points, frames))


def by_hand():
    return result_of(Hierarchy(torch.arange(6), MERGES, HEIGHTS, 0.5), torch.tensor([[0, 1, 2], [3, 5, -1]]))


@pytest.mark.parametrize(
    ("chosen", "negative", "expected"),
    [
        ([0], [], [0, 1]),  # the default level
        ([0, 1], [], [0, 1]),
        ([0, 3], [], [0, 1, 2, 3]),  # the smallest segment with both
        ([0, 4], [], [0, 1, 2, 3, 4, 5]),
        ([0], [1], [0]),
        ([0, 3], [1], [0, 2, 3]),  # no single segment: the largest parts without the negative
        ([0, 3], [5], [0, 1, 2, 3]),
        ([2], [0], [2, 3]),
    ],
)
def test_by_hand(chosen, negative, expected):
    picked = by_hand().pick(torch.tensor(chosen), negative=torch.tensor(negative, dtype=torch.int64))
    assert picked.superpoints.tolist() == expected
    assert picked.points.nonzero().flatten().tolist() == expected


def test_corrections_count():
    """By hand 2 has joined 0, and 4 has left 5; with a negative the hierarchy decides."""
    result = replace(by_hand(), points=torch.tensor([0, 0, 0, 1, 2, 3]))
    assert result.pick(torch.tensor([1])).superpoints.tolist() == [0, 1, 2]
    assert result.pick(torch.tensor([4])).superpoints.tolist() == [4]
    assert result.pick(torch.tensor([2, 3])).superpoints.tolist() == [2, 3]
    assert result.pick(torch.tensor([0]), negative=torch.tensor([5])).superpoints.tolist() == [0, 1]


def test_positions_and_pixels():
    result = by_hand()
    assert result.pick(torch.tensor([[0.4, 5, 0], [2.8, 0, 0]])).superpoints.tolist() == [0, 1, 2, 3]
    assert result.pick(pixels=[(0, 1, 0)]).superpoints.tolist() == [0, 1]
    assert result.pick(pixels=[(0, 1, 0)], negative_pixels=[(0, 0, 0)]).superpoints.tolist() == [1]
    mask = torch.isin(result.superpoint_images[0], result.pick(torch.tensor([3])).superpoints)
    assert mask.tolist() == [[False, False, True], [True, False, False]]


def test_a_point_without_a_label_is_no_pick():
    result = tj.Result.of(tj.Segmentation(torch.tensor([0, -1, -1, 1]), ()), tj.Scene(torch.rand(4, 3)))
    for chosen in ([1], [0, 2]):
        with pytest.raises(
            ValueError, match=r"points, pixels: expected at least one point, each of a segment, got \[-1"
        ):
            result.pick(torch.tensor(chosen))
    assert result.pick(torch.tensor([0]), negative=torch.tensor([1])).superpoints.tolist() == [0]


def test_without_a_hierarchy_there_are_whole_segments():
    result = tj.Result.of(tj.Segmentation(torch.tensor([0, 0, 1, 1]), ()), tj.Scene(torch.rand(4, 3)))
    assert result.pick(torch.tensor([1])).points.tolist() == [True, True, False, False]
    with pytest.raises(ValueError, match="negative: expected points apart from the chosen ones"):
        result.pick(torch.tensor([1]), negative=torch.tensor([0]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "points, pixels: expected at least one"),
        ({"points": [1]}, "points: expected a torch.Tensor, got list"),
        ({"points": torch.tensor([6])}, r"points: expected indices in \[0, 6\), got 6 to 6"),
        ({"points": torch.tensor([True])}, r"points: expected indices of shape \[K\], int64"),
        ({"points": torch.rand(3)}, r"points: expected finite positions of shape \[K, 3\], got \[3\]"),
        ({"pixels": [(1, 0, 0)]}, "pixels: expected a frame from 0 to 0, got 1"),
        ({"pixels": [(0, 3, 0)]}, "pixels: expected a pixel of 3 x 2, got 3, 0"),
        ({"pixels": [(0, 2, 1)]}, "pixels: expected a pixel of a segment of the cloud; 2, 1 is of none"),
        ({"pixels": [(0.5, 2, 1)]}, r"pixels: expected \(frame, column, row\), got"),
        ({"points": torch.tensor([1]), "negative": torch.tensor([1])}, "both are in superpoint 1"),
        ({"points": torch.tensor([1]), "negative": torch.tensor([-1])}, r"negative: expected indices in \[0, 6\)"),
    ],
)
def test_what_is_refused(arguments, message):
    with pytest.raises((ValueError, TypeError), match=message):
        by_hand().pick(**arguments)


@st.composite
def hierarchies(draw):
    count = draw(st.integers(2, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    merges = np.array([[i, rng.integers(i)] for i in range(1, count)])[rng.permutation(count - 1)]
    heights = np.sort(rng.integers(0, 6, count - 1)) / 5  # many are equal
    keep = rng.random(count - 1) < 0.9
    merges, heights = torch.from_numpy(merges[keep]), torch.from_numpy(heights[keep])
    return Hierarchy(torch.arange(count), merges, heights, draw(st.sampled_from([0.0, 0.3, 0.5, 1.0])))


@given(hierarchies(), st.data())
def test_every_pick_is_as_large_as_it_may_be(hierarchy, data):
    """Against all segments of all levels: the largest that have a chosen superpoint, no other, and are not too high."""
    count = hierarchy.num_superpoints
    chosen = data.draw(st.sets(st.integers(0, count - 1), min_size=1, max_size=3))
    negative = data.draw(st.sets(st.integers(0, count - 1), max_size=3)) - chosen
    levels = [float(one) for one in hierarchy.heights.unique()]
    whole = [one for one in levels if len({int(hierarchy.cut(one)[i]) for i in chosen}) == 1]
    limit = max(hierarchy.default, min(whole, default=0.0)) if len(chosen) > 1 else hierarchy.default
    expected = set(chosen)
    for height in levels:
        if height <= limit:
            labels = hierarchy.cut(height)
            for i in chosen:
                members = set((labels == labels[i]).nonzero().flatten().tolist())
                if not members & negative:
                    expected |= members
    picked = result_of(hierarchy).pick(
        torch.tensor(sorted(chosen)), negative=torch.tensor(sorted(negative), dtype=torch.int64)
    )
    found = set(picked.superpoints.tolist())
    assert chosen <= found
    assert not found & negative
    assert expected <= found  # merges of equal height come one after the other, so it may be larger
    if len(levels) == len(hierarchy.heights):
        assert found == expected
