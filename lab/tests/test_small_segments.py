"""Step 6, regions: which small segments are joined, and to which neighbour."""

import pytest
import torch
from torchjoint_lab.regions.small_segments import join_small

EDGES = torch.tensor([[0, 1, 2, 3, 4, 5], [1, 2, 3, 4, 5, 6]])
COST = torch.tensor([1.0, 0.9, 1.0, 0.8, 0.7, 1.0])
SEGMENT = torch.tensor([0, 0, 1, 2, 2, 3, 3])


@pytest.mark.parametrize(
    ("stays", "min_size", "expected"),
    [
        ([False] * 4, 0, [0, 0, 1, 2, 2, 3, 3]),
        ([False] * 4, 1, [0, 0, 1, 2, 2, 3, 3]),
        ([False] * 4, 2, [0, 0, 0, 1, 1, 2, 2]),  # across 0.9, not across 1.0
        ([False, True, False, False], 2, [0, 0, 1, 2, 2, 3, 3]),
        ([False] * 4, 3, [0, 0, 0, 1, 1, 1, 1]),
        ([True] * 4, 100, [0, 0, 1, 2, 2, 3, 3]),
        ([True, False, True, True], 100, [0, 0, 0, 1, 1, 2, 2]),
    ],
)
def test_by_hand(stays, min_size, expected):
    got = join_small(SEGMENT, EDGES, COST, torch.tensor(stays), min_size)
    assert got.tolist() == expected


def test_what_stays_may_still_take_others_in():
    stays = torch.tensor([False, False, True, False])
    got = join_small(SEGMENT, EDGES, COST, stays, 100)
    assert got.tolist() == [0] * 7
