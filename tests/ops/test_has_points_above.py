"""What rises from points of a grid: against the slow twin, exactly."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st
from reference.has_points_above import EXAMPLE, has_points_above_reference

from torchjoint.ops.internal import has_points_above


def grid(seed: int, count: int, num_columns: int, num_rows: int) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)
    column = torch.randint(num_columns, (count,), generator=generator)
    row = torch.randint(num_rows, (count,), generator=generator)
    height = torch.randint(12, (count,), generator=generator).double() / 4
    used = torch.rand(count, generator=generator) < 0.8
    return column, row, height, used, torch.randperm(count, generator=generator)[: count // 2 + 1]


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 12), st.integers(1, 5))
def test_it_says_what_the_twin_says(seed: int, count: int, num_columns: int, num_rows: int) -> None:
    arguments = (*grid(seed, count, num_columns, num_rows), num_columns, num_rows, 0.5, 1.25)
    assert torch.equal(has_points_above(*arguments), has_points_above_reference(*arguments))


def test_by_hand() -> None:
    # The second point is in the column before the first one, across the seam, and half a metre higher.
    assert has_points_above(**EXAMPLE).tolist() == [True, False]
    assert has_points_above(**EXAMPLE | {"least": 0.5}).tolist() == [False, False]
    assert has_points_above(**EXAMPLE | {"least": 0.5, "most": 3.5}).tolist() == [True, False]
    assert has_points_above(**EXAMPLE | {"used": torch.zeros(4, dtype=torch.bool)}).tolist() == [False, False]


def test_threads_change_nothing(set_threads) -> None:
    arguments, found = (*grid(0, 50_000, 360, 200), 360, 200, 0.5, 1.25), []
    for threads in (1, 2, 4):
        set_threads(threads)
        found.append(has_points_above(*arguments))
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])
    assert 0 < found[0].double().mean() < 1
