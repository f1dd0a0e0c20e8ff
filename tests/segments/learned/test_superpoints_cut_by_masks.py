"""Superpoints that reach over the outlines of masks are cut there, before anything is judged."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

import torchjoint as tj
from torchjoint.scene import Masks
from torchjoint.segments.learned import masks as mask_superpoints
from torchjoint.segments.learned.masks import cut_by_masks
from torchjoint.views.observations import Observation

CHAIN = torch.stack([torch.arange(5), torch.arange(1, 6)])
WHOLE = [True] * 6
HALVES = [[True] * 3 + [False] * 3, [False] * 3 + [True] * 3]
SMALL = [[False, False, True, True, False, False]]  # and nothing else


@pytest.fixture
def cut(seen):
    """Six points in a chain, each in a pixel of its own, in frames with masks."""

    def superpoints(superpoint: list[int], frames: list[list[list[bool]]], edges: Tensor = CHAIN) -> list[int]:
        return cut_by_masks(torch.tensor(superpoint), edges, [with_masks(seen, stack) for stack in frames]).tolist()

    return superpoints


def with_masks(seen, stack: list[list[bool]]) -> Observation:
    masks = Masks.from_stack(torch.tensor(stack).view(-1, 1, 6))
    return replace(seen(range(6), range(6)), labels=masks.atom, masks=masks)


def test_a_superpoint_is_cut_where_masks_end(cut) -> None:
    assert cut([0] * 6, [HALVES]) == [0, 0, 0, 1, 1, 1]
    assert cut([0] * 6, [SMALL]) == [0, 0, 1, 1, 2, 2]  # parts without masks that do not touch


def test_only_mixed_superpoints_are_cut_and_only_inside(cut) -> None:
    assert cut([0, 0, 0, 1, 1, 1], [HALVES]) == [0, 0, 0, 1, 1, 1]
    assert cut([0, 0, 1, 1, 1, 1], [HALVES]) == [0, 0, 1, 2, 2, 2]
    # Points 2 and 3 lie in one mask, but not in one piece.
    assert cut([0, 0, 0, 1, 1, 1], [SMALL]) == [0, 0, 1, 2, 3, 3]


def test_most_frames_decide(cut) -> None:
    assert cut([0] * 6, [HALVES] + [[WHOLE]] * 3) == [0] * 6
    assert cut([0] * 6, [HALVES] * 3 + [[WHOLE]]) == [0, 0, 0, 1, 1, 1]
    # One point on another side in one frame of three does not move the cut.
    off = [[True] * 4 + [False] * 2, [False] * 4 + [True] * 2]
    assert cut([0] * 6, [HALVES, off, HALVES]) == [0, 0, 0, 1, 1, 1]
    assert cut([0] * 6, [off, HALVES, HALVES]) == [0, 0, 0, 1, 1, 1]


def test_points_that_no_frame_sees_stay_with_their_neighbours(seen) -> None:
    masks = Masks.from_stack(torch.tensor([[[True, True, False, False]], [[False, False, True, True]]]))
    frame = replace(seen([0, 1, 4, 5], [0, 0, 1, 1]), labels=masks.atom, masks=masks)
    superpoint = cut_by_masks(torch.zeros(6, dtype=torch.int64), CHAIN, [frame]).tolist()
    assert superpoint[0] == superpoint[1] != superpoint[4] == superpoint[5]
    assert set(superpoint) == {0, 1}


def test_only_the_frames_that_see_most_of_a_superpoint_count(cut, monkeypatch) -> None:
    monkeypatch.setattr(mask_superpoints, "MAX_FRAMES", 2)
    # All frames see as many points, so the first two count.
    assert cut([0] * 6, [HALVES] * 2 + [[WHOLE]] * 7) == [0, 0, 0, 1, 1, 1]
    assert cut([0] * 6, [[WHOLE]] * 2 + [HALVES]) == [0] * 6
    in_frame = torch.tensor([[0, 0, 0, 1, 1], [0, 1, 2, 1, 2], [3, 5, 4, 1, 1]])  # superpoints, frames, points
    most = mask_superpoints._frames_that_see_most(in_frame, 3, 3)
    assert most.tolist() == [[False, False, False], [True, True, False], [True, True, False]]


def test_without_masks_nothing_changes(seen) -> None:
    superpoint = torch.tensor([0, 0, 0, 1, 1, 1])
    assert cut_by_masks(superpoint, CHAIN, [seen(range(6), range(6))]) is superpoint


def test_a_thing_of_few_points_on_a_wall_is_found() -> None:
    x, y = torch.meshgrid(torch.linspace(-0.6, 0.6, 61), torch.linspace(-0.45, 0.45, 46), indexing="xy")
    points = torch.stack([x, y, torch.ones_like(x)], -1).view(-1, 3)
    size, camera = (60, 80), torch.tensor([[60.0, 0, 40], [0, 60, 30], [0, 0, 1]], dtype=torch.float64)
    small = torch.zeros(1, *size, dtype=torch.bool)
    small[:, 30:34, 40:44] = True  # 5 x 5 cm: some nine points of the wall, of 2 cm apart
    frames = [
        tj.Frame(
            torch.full((3, *size), 0.5), camera, torch.eye(4, dtype=torch.float64), masks=torch.cat([small, ~small])
        )
        for _ in range(3)
    ]
    labels = tj.JointSegmenter()(tj.Scene(points, frames)).points
    column, row = (60 * points[:, 0] + 40).floor(), (60 * points[:, 1] + 30).floor()
    inside = (column >= 40) & (column < 44) & (row >= 30) & (row < 34)
    found = labels == labels[inside].mode().values
    assert int((found & inside).sum()) / int((found | inside).sum()) > 0.7
