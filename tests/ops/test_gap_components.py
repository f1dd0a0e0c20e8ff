"""Points that are connected over gaps: against the slow twin, exactly."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from reference.gap_components import gap_components_reference

from torchjoint.ops import nearest_neighbors
from torchjoint.ops.internal import gap_components


def cloud(seed: int, count: int, side: int = 6) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)
    points = torch.randint(side, (count, 3), generator=generator).float()  # many equal distances, and copies
    if seed % 2:
        points += torch.rand(count, 3, generator=generator)
    gap = 2 * torch.rand(count, generator=generator, dtype=torch.float64)
    gap[torch.rand(count, generator=generator) < 0.1] = 0
    used = torch.rand(count, generator=generator) < 0.9
    return points, gap, nearest_neighbors(points, 5, 0)[0], used


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(0, 8), st.sampled_from([1.0, 1.7]))
def test_labels_are_those_of_the_twin(seed: int, count: int, min_size: int, joining: float) -> None:
    arguments = (*cloud(seed, count), min_size, joining)
    assert torch.equal(gap_components(*arguments), gap_components_reference(*arguments))


@pytest.mark.parametrize(
    ("min_size", "joining", "labels"),
    [(0, 1.0, [0, 0, 1, 2, 2]), (2, 1.5, [0, 0, 1, 2, 2]), (2, 1.6, [0, 0, 0, 1, 1]), (3, 1.6, [0, 0, 0, 1, 1])],
)
def test_by_hand(min_size: int, joining: float, labels: list[int]) -> None:
    # The third point is 1.6 gaps after the second; the fourth 3 gaps after the third.
    points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2.6, 0, 0], [5.6, 0, 0], [6.6, 0, 0]])
    gap, used = torch.tensor([2.0, 1, 1, 1, 1]).double(), torch.ones(5, dtype=torch.bool)
    neighbors = nearest_neighbors(points, 4, 0)[0]
    assert gap_components(points, gap, neighbors, used, min_size, joining + 1e-6).tolist() == labels
    used[1] = False
    assert gap_components(points, gap, neighbors, used).tolist() == [0, 1, 2, 3, 3]


def test_threads_change_nothing(set_threads) -> None:
    arguments, found = (*cloud(1, 20_000, side=30), 4, 1.7), []
    for threads in (1, 2, 4):
        set_threads(threads)
        found.append(gap_components(*arguments))
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])
