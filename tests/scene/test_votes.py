"""The confidence that follows from the votes of members."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import torchjoint as tj
from torchjoint.scene import Hierarchy
from torchjoint.scene.hierarchy import OFFSET, PER_IOU, PER_LOG_POINTS, Votes


def by_hand(votes, of_superpoint):
    """The same with sets of points."""
    points, start = [], 0
    for size in votes.size.tolist():
        points.append(set(range(start, start + size)))
        start += size

    def segment(labels, number):
        return set().union(*(points[p] for p in range(len(points)) if labels[p] == number))

    of_segment, of_superpoint_ = {}, [0.0] * len(points)
    for number in sorted(set(of_superpoint)):
        own, ious, partners = segment(of_superpoint, number), [], []
        for member in votes.segments.tolist():
            found = [
                (len(own & other) / len(own | other), -k) for k in sorted(set(member)) for other in [segment(member, k)]
            ]
            iou, partner = max(found)
            ious.append(iou)
            partners.append(-partner)
        log_odds = OFFSET + PER_IOU * sum(ious) / len(ious) + PER_LOG_POINTS * math.log(len(own))
        of_segment[number] = 1 / (1 + math.exp(-log_odds))
        for superpoint in range(len(points)):
            if of_superpoint[superpoint] == number:
                there = [
                    member[superpoint] == one for member, one in zip(votes.segments.tolist(), partners, strict=True)
                ]
                of_superpoint_[superpoint] = of_segment[number] * sum(there) / len(there)
    return [of_segment[number] for number in sorted(of_segment)], of_superpoint_


@given(st.data())
def test_by_hand(data):
    count = data.draw(st.integers(1, 6))
    labels = st.lists(st.integers(0, count - 1), min_size=count, max_size=count)
    members = data.draw(st.lists(labels, min_size=1, max_size=4))
    size = data.draw(st.lists(st.integers(1, 5), min_size=count, max_size=count))
    of_superpoint = torch.unique(torch.tensor(data.draw(labels)), return_inverse=True)[1]
    votes = Votes(torch.tensor(members), torch.tensor(size))
    found, expected = votes.confidence(of_superpoint), by_hand(votes, of_superpoint.tolist())
    assert found.of_segment.tolist() == pytest.approx(expected[0])
    assert found.of_superpoint.tolist() == pytest.approx(expected[1])


def test_other_numbers_of_the_superpoints_give_the_same():
    votes = Votes(torch.tensor([[0, 0, 1, 1], [0, 1, 1, 2]]), torch.tensor([40, 30, 20, 10]))
    number, of_superpoint = torch.tensor([2, 0, 3, 1]), torch.tensor([0, 0, 1, 1])
    renumbered = torch.empty(4, dtype=torch.int64)
    renumbered[number] = of_superpoint
    expected, found = votes.confidence(of_superpoint), votes.renumbered(number).confidence(renumbered)
    assert torch.equal(found.of_segment, expected.of_segment)
    assert torch.equal(found.of_superpoint[number], expected.of_superpoint)


def segmentation(votes):
    superpoint = torch.tensor([0, 1, 1, 2])
    merges, heights = torch.tensor([[0, 1]]), torch.tensor([0.4], dtype=torch.float64)
    return tj.Segmentation(torch.tensor([0, 0, 0, 1]), (), hierarchy=Hierarchy(superpoint, merges, heights, 0.5, votes))


def test_of_a_segmentation_and_its_levels():
    result = segmentation(Votes(torch.tensor([[0, 0, 1], [0, 1, 2]]), torch.tensor([100, 200, 300])))
    both, apart = result.confidence, result.at(1.0).confidence
    assert both.shape == (2,)
    assert both[1] > both[0]  # the members agree on the second segment
    assert apart.shape == (3,)
    assert result.point_confidence.tolist() == pytest.approx(
        [float(both[0]) / 2, *[float(both[0])] * 2, float(both[1])]
    )


def test_without_members_there_is_none():
    for result in (segmentation(None), tj.Segmentation(torch.zeros(3, dtype=torch.int64), ())):
        assert result.confidence is None
        assert result.point_confidence is None


@pytest.mark.parametrize(
    ("segments", "size", "message"),
    [
        ([[0, 1]], [1, 1, 1], r"votes: expected segments \[T, 3\] int64, got torch.int64 \[1, 2\]"),
        ([[0.0, 1, 2]], [1, 1, 1], r"votes: expected segments \[T, 3\] int64, got torch.float32"),
        ([[0, 1, 3]], [1, 1, 1], r"votes: expected segments in \[0, 3\)"),
        ([[0, 1, 2]], [1, 1, 0], r"votes: expected sizes \[3\] int64 of at least 1 point"),
    ],
)
def test_wrong_votes(segments, size, message):
    with pytest.raises(ValueError, match=message):
        segmentation(Votes(torch.tensor(segments), torch.tensor(size)))


def test_members_of_a_small_room(scene_of):
    scene = scene_of(3).scene
    result = tj.JointSegmenter()(scene)
    assert result.confidence.shape == (result.num_point_segments,)
    assert ((result.confidence > 0) & (result.confidence < 1)).all()
    assert (result.point_confidence <= result.confidence[result.points] + 1e-12).all()
    counts = torch.bincount(result.points)
    assert result.confidence[counts.argmax()] > result.confidence[counts.argmin()]
    seen = [tj.Masks.from_labels(labels) for labels in scene.truth.images]
    frames = [replace(frame, masks=masks) for frame, masks in zip(scene.frames, seen, strict=True)]
    masked = tj.JointSegmenter()(tj.Scene(scene.points, frames, colors=scene.colors))
    assert masked.hierarchy.votes.segments.shape == (15, masked.hierarchy.num_superpoints)
    assert torch.equal(masked.hierarchy.votes.size, torch.bincount(masked.hierarchy.superpoint))
    assert masked.confidence.shape == (masked.num_point_segments,)
    assert tj.JointSegmenter(tj.Config.from_preset("paper"))(scene).confidence is None
