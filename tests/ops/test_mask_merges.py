"""mask_merges: by hand, against its slow twin exactly, and that the order of rows and frames changes nothing."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st
from reference.mask_merges import mask_merges_reference
from torch import Tensor

from torchjoint.ops.internal import WEIGHT_UNIT, mask_merges


def random_views(seed: int, num_regions: int, num_edges: int, num_frames: int) -> dict[str, Any]:
    """Regions on a multigraph; each frame sees some of the points of some of them, in masks that may overlap."""
    generator = torch.Generator().manual_seed(seed)

    def numbers(high: int, *shape: int) -> Tensor:
        return torch.randint(high, shape, generator=generator)

    size = numbers(4, num_regions) + 1
    frame_of_mask = numbers(num_frames, 2 * num_frames) if num_frames else numbers(1, 0)
    seen = (numbers(5, num_regions, num_frames) if num_frames else numbers(1, num_regions, 0)).minimum(size[:, None])
    inside = numbers(3, num_regions, len(frame_of_mask)).minimum(seen[:, frame_of_mask])
    in_frame = torch.stack([*seen.nonzero().t(), seen[seen > 0]])
    in_mask = torch.stack([*inside.nonzero().t(), inside[inside > 0]])
    return {
        "edge_index": numbers(num_regions, 2, num_edges),
        "cost": numbers(5, num_edges) / 4,
        "count": numbers(3, num_edges) + 1,
        "size": size,
        "in_mask": in_mask,
        "in_frame": in_frame,
        "weight": numbers(WEIGHT_UNIT + 1, len(frame_of_mask)),
        "frame_of_mask": frame_of_mask,
    }


@few_and_many(
    100,
    300,
    seed=st.integers(0, 2**32 - 1),
    num_regions=st.integers(1, 20),
    num_edges=st.integers(0, 40),
    num_frames=st.integers(0, 4),
    apart_weight=st.sampled_from([0.0, 0.6, 1.0]),
    prior_weight=st.sampled_from([0.01, 0.1, 1.0]),
    threshold=st.sampled_from([0.0, 0.3, 0.5, 0.75, math.inf]),
    min_size=st.sampled_from([0, 0, 3, 6]),
)
def test_the_twin(
    seed: int,
    num_regions: int,
    num_edges: int,
    num_frames: int,
    apart_weight: float,
    prior_weight: float,
    threshold: float,
    min_size: int,
) -> None:
    weights: dict[str, Any] = {"apart_weight": apart_weight, "prior_weight": prior_weight, "threshold": threshold}
    weights |= {"min_size": min_size, "stays": torch.arange(num_regions) % 3 == 0}
    views = random_views(seed, num_regions, num_edges, num_frames)
    merges, cost = mask_merges(**views, **weights)
    expected, expected_cost = mask_merges_reference(**views, **weights)
    assert torch.equal(merges, expected)
    assert torch.equal(cost, expected_cost)


@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_rows_and_masks_changes_nothing(seed: int) -> None:
    views = random_views(seed, 30, 80, 5)
    generator = torch.Generator().manual_seed(seed)
    order = torch.randperm(len(views["weight"]), generator=generator)
    place = torch.argsort(order)
    shuffled = views | {"weight": views["weight"][order], "frame_of_mask": views["frame_of_mask"][order]}
    in_mask = views["in_mask"].clone()
    in_mask[1] = place[in_mask[1]]
    shuffled["in_mask"] = in_mask[:, torch.randperm(in_mask.shape[1], generator=generator)]
    shuffled["in_frame"] = views["in_frame"][:, torch.randperm(views["in_frame"].shape[1], generator=generator)]
    both = (mask_merges(**one, apart_weight=0.6, prior_weight=0.1, threshold=1.0) for one in (shuffled, views))
    for got, want in zip(*both, strict=True):
        assert torch.equal(got, want)


def test_by_hand() -> None:
    # One frame sees both points of region 0 in the mask, and one of the two points of region 1.
    views = {
        "edge_index": torch.tensor([[0], [1]]),
        "cost": torch.tensor([0.5]),
        "count": torch.tensor([3]),
        "size": torch.tensor([2, 4]),
        "in_mask": torch.tensor([[0, 1], [0, 0], [2, 1]]),
        "in_frame": torch.tensor([[0, 1], [0, 0], [2, 2]]),
        "weight": torch.tensor([WEIGHT_UNIT // 2]),
        "frame_of_mask": torch.tensor([0]),
    }
    # Of four pairs of points that are seen, two have both points in the mask, and two one of them: A = 2/2, D = 2/2/2.
    pairs, agree, apart, prior = 2 * 4, 1.0, 0.5 * 0.5, 0.1 * 0.5
    merges, cost = mask_merges(**views, apart_weight=0.5, prior_weight=0.1, threshold=1.0)
    assert merges.tolist() == [[0], [1]]
    assert cost.item() == pytest.approx((apart / pairs + prior) / ((agree + apart) / pairs + 0.1), rel=1e-12)


def test_regions_that_do_not_touch_count() -> None:
    # 0 - 1 - 2: all views tell 0 from 2, and none says anything of 1. Once 0 and 1 are one, 2 stays apart.
    views = {
        "edge_index": torch.tensor([[0, 1], [1, 2]]),
        "cost": torch.tensor([0.1, 0.2]),
        "count": torch.tensor([1, 1]),
        "size": torch.tensor([2, 2, 2]),
        "in_mask": torch.tensor([[0, 2], [0, 1], [2, 2]]),
        "in_frame": torch.tensor([[0, 2], [0, 0], [2, 2]]),
        "weight": torch.tensor([WEIGHT_UNIT, WEIGHT_UNIT]),
        "frame_of_mask": torch.tensor([0, 0]),
    }
    merges, _ = mask_merges(**views, apart_weight=1, prior_weight=0.1, threshold=0.5)
    assert merges.tolist() == [[0], [1]]


def test_what_a_mask_has_that_its_frame_does_not_see() -> None:
    views = random_views(0, 3, 4, 0)
    views |= {"weight": torch.tensor([1]), "frame_of_mask": torch.tensor([7])}
    views["in_mask"] = torch.tensor([[0], [0], [1]])
    with pytest.raises(ValueError, match="region 0 has points in mask 0, but in_frame has none in frame 7"):
        mask_merges(**views, apart_weight=1, prior_weight=0.1, threshold=0.5)
    views["in_frame"] = torch.tensor([[0], [7], [1]])
    views["in_mask"] = torch.tensor([[0], [0], [2]])
    with pytest.raises(ValueError, match="region 0 has more points in mask 0 than in its frame"):
        mask_merges(**views, apart_weight=1, prior_weight=0.1, threshold=0.5)


def test_small_regions_join_and_large_ones_do_not() -> None:
    views = random_views(0, 4, 0, 0)
    views |= {"edge_index": torch.tensor([[0, 1, 2], [1, 2, 3]]), "cost": torch.tensor([0.9, 0.8, 0.1])}
    views["count"] = torch.tensor([1, 2, 3])
    views["size"] = torch.tensor([9, 2, 9, 9])
    weights = {"apart_weight": 1, "prior_weight": 1, "threshold": 1}
    merges, _ = mask_merges(**views, **weights, min_size=3)
    assert merges.tolist() == [[1], [2]]  # to its cheaper neighbour
    merges, _ = mask_merges(**views, **weights, min_size=3, stays=torch.tensor([False, True, False, False]))
    assert merges.tolist() == [[], []]
