"""Masks in step 6: they overrule geometry as views add up, wrong masks only shift a mean, and far parts join."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torchjoint_lab.synthetic import with_network_masks

import torchjoint as tj
from torchjoint.scene import Hierarchy, Masks
from torchjoint.segments.learned import masks as mask_majority
from torchjoint.segments.learned.masks import MaskLinkage, move_to_majority
from torchjoint.segments.learned.superpoint_graph import MaskCounts, masks_of_superpoints
from torchjoint.views.observations import Observation


def with_masks(seen: Observation, masks: Masks) -> Observation:
    return replace(seen, labels=masks.atom, masks=masks)


def test_points_of_superpoints_in_masks(seen) -> None:
    # Points 0, 1, 2 of superpoints 0, 0, 1 in three pixels: the first mask has pixels 0 and 1, the second, nested,
    # pixel 1.
    stack = torch.tensor([[[True, True, False]], [[False, True, False]]])
    one = with_masks(seen([0, 1, 2], [0, 0, 0]), Masks.from_stack(stack, torch.tensor([1.0, 0.5])))
    plain = seen([0, 1, 2], [0, 0, 0])
    evidence = masks_of_superpoints(torch.tensor([0, 0, 1]), [plain, one, one])
    assert evidence is not None
    assert evidence.weight.tolist() == [256, 128, 256, 128]
    dimmed = with_masks(plain, Masks.from_stack(stack, torch.tensor([0.4, 0.2])))
    nothing = with_masks(plain, Masks.from_stack(stack[:0]))
    also = masks_of_superpoints(torch.tensor([0, 0, 1]), [dimmed, nothing, nothing])
    assert also is not None
    assert also.weight.tolist() == [256, 128]  # scores compare masks with each other
    assert also.unmasked(torch.arange(2)).tolist() == [True, True]  # no point counts for two masks
    assert evidence.frame_of_mask.tolist() == [1, 1, 2, 2]  # the first frame has no masks
    rows = sorted(evidence.in_mask.t().tolist())
    assert rows == [[0, 0, 2], [0, 1, 1], [0, 2, 2], [0, 3, 1]]
    assert sorted(evidence.in_frame.t().tolist()) == [[0, 1, 2], [0, 2, 2], [1, 1, 1], [1, 2, 1]]
    in_mask, in_frame = evidence.of_regions(torch.tensor([0, 0]))
    assert in_mask.t().tolist() == rows
    assert in_frame.t().tolist() == [[0, 1, 3], [0, 2, 3]]
    assert masks_of_superpoints(torch.tensor([0, 0, 1]), [plain]) is None


SIZE = (60, 80)
INTRINSICS = torch.tensor([[60.0, 0, 40], [0, 60, 30], [0, 0, 1]], dtype=torch.float64)


def wall(shift: float = 0.0) -> Tensor:
    """A flat wall at z = 1, with nothing that geometry could tell apart."""
    x, y = torch.meshgrid(torch.linspace(-0.6, 0.6, 61), torch.linspace(-0.45, 0.45, 46), indexing="xy")
    return torch.stack([x + shift, y, torch.ones_like(x)], -1).view(-1, 3)


def halves(columns: int = 40) -> Tensor:
    """Two masks: the pixels to the left of a column, and the others."""
    left = (torch.arange(SIZE[1]) < columns).expand(SIZE)
    return torch.stack([left, ~left])


def segments(points: Tensor, stacks: list[Tensor]) -> Tensor:
    pose = torch.eye(4, dtype=torch.float64)
    image = torch.full((3, *SIZE), 0.5)
    frames = [tj.Frame(image, INTRINSICS, pose, masks=stack, name=str(i)) for i, stack in enumerate(stacks)]
    return tj.JointSegmenter()(tj.Scene(points, frames)).points


def share_of_one_label(labels: Tensor) -> float:
    return float(torch.bincount(labels).max() / len(labels))


def test_masks_cut_what_geometry_cannot() -> None:
    points = wall()
    labels = segments(points, [halves()] * 3)
    left, right = points[:, 0] < -0.02, points[:, 0] > 0.02
    assert share_of_one_label(labels[left]) > 0.97
    assert share_of_one_label(labels[right]) > 0.97
    assert labels[left].mode().values != labels[right].mode().values


def test_one_wrong_mask_of_five_is_outvoted() -> None:
    points, merged = wall(), torch.ones(1, *SIZE, dtype=torch.bool)
    labels = segments(points, [halves()] * 4 + [merged])
    assert labels[points[:, 0] < -0.02].mode().values != labels[points[:, 0] > 0.02].mode().values


@pytest.mark.parametrize("others", [0, 3])
def test_a_mask_that_splits_an_object_in_some_frames_is_outvoted(others: int) -> None:
    points, whole = wall(), torch.ones(1, *SIZE, dtype=torch.bool)
    labels = segments(points, [whole] * others + [halves()])
    assert (share_of_one_label(labels) > 0.97) == (others == 3)


def test_parts_that_do_not_touch_join_in_one_mask() -> None:
    points = torch.cat([part for part in (wall(),) for part in (part[part[:, 0] < -0.2], part[part[:, 0] > 0.2])])
    whole = torch.ones(1, *SIZE, dtype=torch.bool)
    assert share_of_one_label(segments(points, [whole] * 2)) > 0.97
    assert share_of_one_label(segments(points, [halves()] * 2)) < 0.6


@pytest.mark.slow
def test_only_small_regions_in_masks_join_their_neighbour() -> None:
    # Superpoints: a wall, and three crumbs beside it, which one frame sees. A mask has the wall, the whole first crumb
    # and 4 of 10 points of the second; another mask has nearly only the third.
    size = torch.tensor([1000, 10, 10, 10])
    in_mask = torch.tensor([[0, 1, 2, 3], [0, 0, 0, 1], [500, 10, 4, 9]])
    in_frame = torch.tensor([[0, 1, 2, 3], [0, 0, 0, 0], [500, 10, 10, 10]])
    masks = MaskCounts(in_mask, in_frame, torch.full((2,), 256), torch.tensor([0, 0]), torch.tensor([[2, 3], [6, 1]]))
    ends = torch.tensor([[0, 0, 0], [1, 2, 3]])
    joined, _ = MaskLinkage(masks, size).merges_of_small(torch.arange(4), ends, torch.ones(3), torch.ones(3).long())
    assert joined.tolist() == [[0], [1]]


def test_small_things_without_masks_stay() -> None:
    # Regions: a thing in its mask; a crumb of it; a small thing that no view shows in a mask; a crumb of that.
    size = torch.tensor([100, 20, 20, 10])
    in_mask = torch.tensor([[0, 1], [0, 0], [100, 15]])
    in_frame = torch.tensor([[0, 1, 2, 3], [0, 0, 0, 0], [100, 20, 20, 10]])
    bare = torch.tensor([[1, 2, 3], [5, 20, 10]])
    linkage = MaskLinkage(MaskCounts(in_mask, in_frame, torch.full((1,), 256), torch.tensor([0]), bare), size)
    assert linkage.confirmed(torch.arange(4)).tolist() == [True, False, False, False]
    assert linkage.stays_small(torch.arange(4)).tolist() == [True, False, True, False]


def test_strays_in_masks_are_no_noise() -> None:
    # Regions: a floor, and a thing, of whose 100 points the masks of two frames miss 10. A third frame has no masks.
    in_frame = torch.tensor([[0, 0, 0, 1, 1], [0, 1, 2, 0, 1], [500, 500, 500, 100, 100]])
    in_mask, bare = torch.tensor([[1, 1], [0, 1], [90, 90]]), torch.tensor([[0, 1], [1496, 20]])
    masks = MaskCounts(in_mask, in_frame, torch.full((2,), 256), torch.arange(2), bare)
    strays = masks._replace(in_mask=torch.tensor([[1, 1, 0, 0], [0, 1, 0, 1], [90, 90, 2, 2]]))
    assert strays.unmasked(torch.arange(2)).tolist() == [True, False]
    for one in (masks, strays):
        linkage = MaskLinkage(one, torch.tensor([500, 100])).calibrated(torch.arange(2))
        assert linkage.prior_weight == pytest.approx(2 * (1 - 90 * 90 / (90 * 100)))


@pytest.mark.parametrize("keeps", [False, True])
def test_what_a_mask_confirms_keeps_its_outline(keeps: bool) -> None:
    # Regions: a thing in a mask of its own, a second one, a part of the second's mask, and a floor without masks.
    size = torch.tensor([100, 80, 20, 100])
    in_mask = torch.tensor([[0, 1, 2], [0, 1, 1], [100, 80, 20]])
    in_frame = torch.tensor([[0, 1, 2, 3], [0, 0, 0, 0], [100, 80, 20, 100]])
    masks = MaskCounts(in_mask, in_frame, torch.full((2,), 256), torch.tensor([0, 0]), torch.tensor([[3], [100]]))
    linkage = MaskLinkage(masks, size, keeps_outlines=keeps)
    assert linkage.confirmed(torch.arange(4)).tolist() == [True, True, False, False]
    ends = torch.tensor([[0, 0, 1, 1], [1, 3, 2, 3]])
    joined, _ = linkage.merges(torch.arange(4), ends, torch.zeros(4), torch.ones(4).long(), threshold=1.0)
    group = tj.ops.connected_components(joined, 4).tolist()
    assert group == ([0, 1, 1, 2] if keeps else [0, 0, 0, 0])  # only the part joins its whole


@pytest.mark.slow
def test_frames_in_any_order_and_in_parts_give_the_same_labels(scene_of) -> None:
    scene = with_network_masks(scene_of(0, num_points=6000).scene, "hard", seed=3)
    whole = tj.JointSegmenter()(scene)
    assert whole.hierarchy is not None
    backwards, other = tj.JointSegmenter(), tj.JointSegmenter()
    for one in (backwards, other):
        one.reset(scene.points, scene.colors)
    for frame in reversed(scene.frames[3:]):
        backwards.update(frame)
    other.update(scene.frames[:3])
    backwards.merge(other)
    assert torch.equal(backwards.compute(images=False).points, whole.points)
    # The levels nest, with masks as without.
    fine, coarse = whole.at(0.8).points, whole.at(0.3).points
    assert len(torch.unique(torch.stack([fine, whole.points]), dim=1).t()) == int(fine.max()) + 1
    assert len(torch.unique(torch.stack([whole.points, coarse]), dim=1).t()) == int(whole.points.max()) + 1


def test_a_part_in_its_whole_is_a_finer_level() -> None:
    points, whole = wall(), torch.ones(1, *SIZE, dtype=torch.bool)
    pose, image = torch.eye(4, dtype=torch.float64), torch.full((3, *SIZE), 0.5)
    masks = torch.cat([whole, halves()[:1]])
    frames = [tj.Frame(image, INTRINSICS, pose, masks=masks, name=str(i)) for i in range(3)]
    result = tj.JointSegmenter()(tj.Scene(points, frames))
    assert share_of_one_label(result.points) > 0.97
    finer = result.at(0.89).points
    left, right = finer[points[:, 0] < -0.02], finer[points[:, 0] > 0.02]
    assert share_of_one_label(left) > 0.9
    assert share_of_one_label(right) > 0.9
    assert left.mode().values != right.mode().values


CHAIN = torch.stack([torch.arange(5), torch.arange(1, 6)])
HALVES = torch.tensor([[[True, True, True, False, False, False]], [[False, False, False, True, True, True]]])


def moved(seen, superpoint: list[int], stacks: list[Tensor], edges: Tensor = CHAIN) -> list[int]:
    """Six points in a chain, each in a pixel of its own; the superpoints are the segments."""
    number = torch.tensor(superpoint)
    hierarchy = Hierarchy(number, torch.empty(0, 2, dtype=torch.int64), torch.empty(0, dtype=torch.float64))
    frames = [with_masks(seen(range(6), range(6)), Masks.from_stack(stack)) for stack in stacks]
    frames.insert(1, seen(range(6), range(6)))  # without masks: does not count
    masks = masks_of_superpoints(number, frames)
    assert masks is not None
    return move_to_majority(hierarchy, edges, masks, frames).superpoint.tolist()


def test_a_point_moves_to_where_most_frames_see_it(seen) -> None:
    nothing = torch.zeros(0, 1, 6, dtype=torch.bool)
    assert moved(seen, [0, 0, 0, 0, 1, 1], [HALVES]) == [0, 0, 0, 1, 1, 1]
    assert moved(seen, [0, 0, 0, 0, 1, 1], [nothing, HALVES, HALVES]) == [0, 0, 0, 1, 1, 1]
    assert moved(seen, [0, 0, 0, 0, 1, 1], [nothing, HALVES]) == [0, 0, 0, 0, 1, 1]  # half of the frames are not most
    smaller = torch.cat([HALVES, HALVES[:1]])
    smaller[2, 0, 2] = False
    assert moved(seen, [0, 0, 0, 0, 1, 1], [smaller]) == [0, 0, 0, 1, 1, 1]  # nested masks stand for one region


def test_a_point_moves_only_to_a_neighbour(seen) -> None:
    apart = torch.tensor([[0, 1, 2, 4], [1, 2, 3, 5]])
    assert moved(seen, [0, 0, 0, 0, 1, 1], [HALVES], apart) == [0, 0, 0, 0, 1, 1]
    assert moved(seen, [0, 0, 0, 1, 2, 2], [HALVES]) == [0, 0, 0, 1, 2, 2]


def test_a_superpoint_that_a_lost_one_would_fill_is_not_lost(seen, monkeypatch) -> None:
    # Point 2, all of superpoint 1, would go to superpoint 2, and point 3, all of superpoint 2, to superpoint 3.
    wanted = torch.tensor([-1, -1, 2, 3, -1, -1])
    monkeypatch.setattr(mask_majority, "_wanted_regions", lambda *_: wanted)
    assert moved(seen, [0, 0, 1, 2, 3, 3], [HALVES]) == [0, 0, 1, 2, 3, 3]
