"""Levels: by hand, nested in points and images, errors; with superpoints, merges and images that are drawn."""

import dataclasses

import numpy as np
import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st

from torchjoint.scene import Hierarchy, LabelImages, Segmentation
from torchjoint.scene.hierarchy import check_granularity

#: Six points in four superpoints; 0 and 2 merge at .25, with 3 at .5; 1 joins at .75.
BY_HAND = Hierarchy(
    torch.tensor([0, 0, 1, 2, 3, 2]),
    torch.tensor([[0, 2], [2, 3], [1, 0]]),
    torch.tensor([0.25, 0.5, 0.75], dtype=torch.float64),
)


def random_hierarchy(generator, num_points, num_superpoints, default=0.5):
    """Merges of random trees, with heights that never fall on the way up; some heights are equal."""
    order = torch.randint(num_superpoints, (num_points,), generator=generator)
    number = {}
    superpoint = torch.tensor([number.setdefault(int(p), len(number)) for p in order])
    num_superpoints = len(number)
    merges, heights, group = [], [], list(range(num_superpoints))
    for height in sorted((torch.randint(1, 9, (num_superpoints,), generator=generator) / 8).tolist()):
        a, b = torch.randint(num_superpoints, (2,), generator=generator).tolist()
        if group[a] != group[b]:
            group = [group[a] if g == group[b] else g for g in group]
            merges.append((a, b))
            heights.append(height)
    merges = torch.tensor(merges, dtype=torch.int64).view(-1, 2)
    return Hierarchy(superpoint, merges, torch.tensor(heights, dtype=torch.float64), default)


def random_segmentation(seed, num_points=60, num_superpoints=20, default=0.5):
    """Points and two images of the default level; images also have pixels without a label, and ids of their own."""
    generator = torch.Generator().manual_seed(seed)
    hierarchy = random_hierarchy(generator, num_points, num_superpoints, default)
    points = hierarchy.at()
    first_private = int(points.max()) + 1
    of_superpoint = hierarchy.segments_of_superpoints(default)
    images, superpoints = [], []
    for private in ([0, 1], [2]):
        superpoint = torch.randint(-1, hierarchy.num_superpoints, (6, 7), generator=generator)
        labels = torch.where(superpoint < 0, -1, of_superpoint[superpoint])
        for number in private:
            labels[number] = first_private + number
            superpoint[number] = -1
        images.append(labels)
        superpoints.append(superpoint)
    return Segmentation(
        points, LabelImages(images), names=("a", "b"), hierarchy=hierarchy, superpoint_images=superpoints
    )


def is_inside(fine, coarse):
    """Whether each label of one tensor occurs together with one label of the other only."""
    return len(torch.unique(torch.stack([fine, coarse]), dim=1).T) == len(torch.unique(fine))


def numbered_by_first_appearance(labels):
    first = [int((labels == label).nonzero()[0]) for label in range(int(labels.max()) + 1)]
    return first == sorted(first)


@pytest.mark.parametrize(
    ("granularity", "labels"),
    [
        (0.0, [0, 0, 0, 0, 0, 0]),
        (0.25, [0, 0, 0, 0, 0, 0]),
        (0.26, [0, 0, 1, 0, 0, 0]),
        (0.5, [0, 0, 1, 0, 0, 0]),
        (0.51, [0, 0, 1, 0, 2, 0]),
        (0.75, [0, 0, 1, 0, 2, 0]),
        (0.76, [0, 0, 1, 2, 3, 2]),
        (1.0, [0, 0, 1, 2, 3, 2]),
        (1, [0, 0, 1, 2, 3, 2]),
    ],
)
def test_by_hand(granularity, labels):
    assert BY_HAND.at(granularity).tolist() == labels
    assert Segmentation(BY_HAND.at(), (), hierarchy=BY_HAND).at(granularity).points.tolist() == labels


def test_another_default():
    hierarchy = dataclasses.replace(BY_HAND, default=0.3)
    assert [hierarchy.height_of(g) for g in (0, 0.5, 1)] == [1, 0.3, 0]
    assert hierarchy.height_of(0.25) == pytest.approx(0.65)
    assert hierarchy.height_of(0.75) == pytest.approx(0.15)
    assert hierarchy.at().tolist() == [0, 0, 1, 0, 2, 0]
    for default in (0.0, 1.0):
        assert dataclasses.replace(BY_HAND, default=default).height_of(0.5) == default


def test_one_superpoint():
    hierarchy = Hierarchy(torch.zeros(3, dtype=torch.int64), torch.empty(0, 2).long(), torch.empty(0).double())
    assert hierarchy.at(0.2).tolist() == [0, 0, 0]


@few_and_many(
    60,
    200,
    seed=st.integers(0, 2**32 - 1),
    one=st.integers(0, 20),
    other=st.integers(0, 20),
    default=st.sampled_from([0.5, 0.3, 1.0]),
)
def test_levels_are_nested(seed, one, other, default):
    """In points and images; whether levels come from the default, or from one another."""
    result = random_segmentation(seed, default=default)
    num_private = 3
    coarse, fine = (result.at(step / 20) for step in sorted((one, other)))
    assert is_inside(fine.points, coarse.points)
    assert numbered_by_first_appearance(fine.points)
    everywhere = [torch.cat([level.points, *(image.flatten() for image in level.images)]) for level in (fine, coarse)]
    assert is_inside(*everywhere)  # one id space
    for level, labels in zip((fine, coarse), everywhere, strict=True):
        assert labels.dtype == torch.int64
        assert int(labels.max()) == level.num_point_segments + num_private - 1  # private ids follow, without gaps
    for before, after in zip(result.images, coarse.images, strict=True):
        own = before >= result.num_point_segments
        assert torch.equal(before[own] - result.num_point_segments, after[own] - coarse.num_point_segments)
        assert torch.equal(before < 0, after < 0)
    for start, end in ((fine, coarse), (coarse, fine)):
        again = start.at(sorted((one, other))[int(end is fine)] / 20)
        assert torch.equal(again.points, end.points)
        assert all(torch.equal(a, b) for a, b in zip(again.images, end.images, strict=True))


def test_other_points_by_hand():
    other, number = BY_HAND.transferred(torch.tensor([4, 3, 3, 0, 2]))
    assert other.superpoint.tolist() == [0, 1, 1, 2, 3]
    assert number.tolist() == [2, 3, 1, 0]
    assert other.merges.tolist() == [[2, 1], [1, 0], [3, 2]]
    assert other.at(0.5).tolist() == [0, 0, 0, 0, 1]
    with pytest.raises(ValueError, match="of_point: expected points of all 4 superpoints"):
        BY_HAND.transferred(torch.tensor([0, 1, 2, 3]))


@few_and_many(30, 100, seed=st.integers(0, 2**32 - 1), granularity=st.floats(0, 1))
def test_other_points_have_the_same_levels(seed, granularity):
    generator = torch.Generator().manual_seed(seed)
    hierarchy = random_hierarchy(generator, 40, 12)
    of_point = torch.cat([torch.arange(40), torch.randint(40, (30,), generator=generator)])
    of_point = of_point[torch.randperm(70, generator=generator)]
    other, number = hierarchy.transferred(of_point)
    expected, got = hierarchy.at(granularity)[of_point], other.at(granularity)
    assert is_inside(got, expected)
    assert is_inside(expected, got)
    assert numbered_by_first_appearance(got)
    assert torch.equal(number[hierarchy.superpoint[of_point]], other.superpoint)


@few_and_many(30, 100, seed=st.integers(0, 2**32 - 1), granularity=st.floats(0, 1))
def test_the_default_is_as_it_was(seed, granularity):
    result = random_segmentation(seed)
    for level in (result.at(), result.at(0.5), result.at(granularity).at(0.5)):
        assert torch.equal(level.points, result.points)
        assert all(torch.equal(a, b) for a, b in zip(level.images, result.images, strict=True))
        assert level.names == result.names


def test_images_are_a_sequence():
    level = random_segmentation(3).at(0.9)
    assert len(level.images) == 2
    assert torch.equal(level.images[-1], level.images[1])
    assert [image.tolist() for image in level.images[:]] == [image.tolist() for image in level.images]
    with pytest.raises(IndexError):
        level.images[2]


@pytest.mark.parametrize("granularity", [-0.01, 1.01, float("nan"), float("inf")])
def test_granularities_out_of_range(granularity):
    with pytest.raises(ValueError, match=r"granularity: expected a number from 0 \(coarse\) to 1 \(fine\), got"):
        random_segmentation(0).at(granularity)
    with pytest.raises(ValueError, match="--granularity: expected a number"):
        check_granularity(granularity, "--granularity")


@pytest.mark.parametrize("granularity", ["0.5", None, True])
def test_granularities_that_are_no_numbers(granularity):
    with pytest.raises(TypeError, match="granularity: expected a number from 0"):
        BY_HAND.at(granularity)


def test_a_level_of_numpy():
    heights = torch.tensor([0.3, 0.7 * 0.7 + 1e-10], dtype=torch.float64)
    hierarchy = Hierarchy(torch.arange(3), torch.tensor([[0, 1], [0, 2]]), heights, default=0.7)
    for granularity in np.linspace(0, 1, 21).astype(np.float32):
        assert torch.equal(hierarchy.at(granularity), hierarchy.at(float(granularity)))


def test_without_a_hierarchy():
    with pytest.raises(ValueError, match="hierarchy: expected a segmentation with levels, got one level"):
        Segmentation(torch.zeros(3, dtype=torch.int64), ()).at(0.5)


def test_finer_images_need_the_superpoints():
    result = dataclasses.replace(random_segmentation(0), superpoint_images=())
    result.at(0.1)
    with pytest.raises(
        ValueError, match=r"superpoint_images: expected one for each of 2 images \(finer levels need them\), got 0"
    ):
        result.at(1.0)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            {"superpoint": BY_HAND.superpoint.int()},
            TypeError,
            "superpoint: expected a torch.int64 tensor of 1 dimensions, got",
        ),
        ({"superpoint": [0, 1]}, TypeError, "superpoint: expected a torch.Tensor, got list"),
        (
            {"superpoint": torch.empty(0).long()},
            ValueError,
            "superpoint: expected numbers >= 0, or -1 = none, of which the first is 0",
        ),
        ({"superpoint": BY_HAND.superpoint - 2}, ValueError, "superpoint: expected numbers >= 0"),
        ({"superpoint": torch.tensor([0, 2, 1, 3])}, ValueError, "superpoint: expected numbers by first appearance"),
        ({"merges": BY_HAND.merges[:2]}, ValueError, "merges: expected shape"),
        ({"merges": BY_HAND.merges.t()}, ValueError, "merges: expected shape"),
        ({"merges": BY_HAND.merges + 1}, ValueError, r"merges: expected superpoints in \[0, 4\)"),
        ({"superpoint": torch.tensor([0, 1, 2])}, ValueError, "merges: expected shape .* below 3 superpoints"),
        ({"merges": torch.tensor([[0, 2], [2, 0], [1, 0]])}, ValueError, "merges: expected each to join two segments"),
        ({"merges": torch.tensor([[0, 2], [2, 3], [1, 1]])}, ValueError, "merges: expected each to join two segments"),
        ({"heights": BY_HAND.heights.float()}, TypeError, "heights: expected a torch.float64 tensor"),
        ({"heights": BY_HAND.heights * 2}, ValueError, r"heights: expected numbers in \[0, 1\]"),
        ({"heights": BY_HAND.heights * torch.nan}, ValueError, r"heights: expected numbers in \[0, 1\]"),
        ({"default": 2.0}, ValueError, r"default: expected a height in \[0, 1\], got 2.0"),
    ],
)
def test_what_is_no_hierarchy(change, error, message):
    with pytest.raises(error, match=message):
        dataclasses.replace(BY_HAND, **change)
