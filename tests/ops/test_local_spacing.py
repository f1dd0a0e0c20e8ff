"""The spacing of points where it matters: against the slow twin, exactly."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st
from reference.local_spacing import local_spacing_reference

from torchjoint.ops.internal import local_spacing


def cloud(seed: int, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn(count, 3, generator=generator)
    if seed % 3 == 0:  # equal distances and copies
        points = (2 * points).round()
    points[: count // 4] *= 20  # some stand alone
    return points, 4 * torch.rand(count, generator=generator, dtype=torch.float64).square()


@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.sampled_from([0.0, 0.3, 0.6, 1.0]), st.integers(1, 8))
def test_distances_are_those_of_the_twin(seed: int, size: int, share: float, count: int) -> None:
    arguments = (*cloud(seed, size), share, count)
    assert torch.equal(local_spacing(*arguments), local_spacing_reference(*arguments))


def test_dense_points_need_no_search() -> None:
    points = torch.cat([torch.rand(1000, 3, generator=torch.Generator().manual_seed(0)), torch.full((1, 3), 50.0)])
    found = local_spacing(points, torch.full((1001,), 10.0, dtype=torch.float64), 0.5, 4)
    assert (found[:1000] == 0).all()
    assert found[1000] == torch.inf


def test_threads_change_nothing(set_threads) -> None:
    arguments, found = (*cloud(1, 20_000), 0.1, 4), []
    for threads in (1, 2, 4):
        set_threads(threads)
        found.append(local_spacing(*arguments))
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[0], found[2])
    assert ((found[0] > 0) & (found[0] < torch.inf)).any()
