"""match_pixels: by hand, against its slow twin exactly, and in size against scipy's maximum matching."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st
from reference.match_pixels import match_pixels_reference
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching
from torch import Tensor

from torchjoint.ops import match_pixels

RADII = st.sampled_from([0.0, 0.5, 1.0, 1.5, 2.0, 2.3, 5.0, 1e9])


def pixels(*rows: str) -> Tensor:
    return torch.tensor([[character == "#" for character in row] for row in rows])


def random_maps(seed: int, height: int, width: int, density: float) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    pred, target = torch.rand(2, height, width, generator=generator) < density
    return pred, target


def maximum(pred: Tensor, target: Tensor, radius: float) -> int:
    p, t = pred.nonzero(), target.nonzero()
    near = (p[:, None] - t[None]).square().sum(2) <= radius**2
    return int((maximum_bipartite_matching(csr_matrix(near.numpy().astype(np.int8))) >= 0).sum())


def test_each_pixel_has_one_partner() -> None:
    pred, target = match_pixels(pixels("###."), pixels(".#.."), 1)
    assert torch.equal(pred, pixels(".#.."))
    assert torch.equal(target, pixels(".#.."))


@pytest.mark.parametrize(("radius", "is_matched"), [(0, False), (4.9, False), (5, True), (6, True)])
def test_the_radius_is_euclidean_and_inclusive(radius: float, is_matched: bool) -> None:
    pred, target = torch.zeros(2, 6, 6, dtype=torch.bool)
    pred[4, 0] = target[1, 4] = True
    pred_matched, target_matched = match_pixels(pred, target, radius)
    assert torch.equal(pred_matched, pred & is_matched)
    assert torch.equal(target_matched, target & is_matched)


def test_the_nearest_give_way_where_more_can_be_matched() -> None:
    # The middle pixel takes its own place first; a shortest path moves it to the left to let the right one in.
    pred, target = pixels("..##"), pixels(".##.")
    assert match_pixels(pixels("..#."), target, 1)[1].equal(pixels("..#."))
    assert match_pixels(pred, target, 1)[0].equal(pred)
    assert match_pixels(pred, target, 1)[1].equal(target)


def test_of_equally_near_pixels_upper_then_left_wins() -> None:
    assert match_pixels(pixels("...", ".#.", "..."), pixels(".#.", "#.#", ".#."), 1)[1].equal(
        pixels(".#.", "...", "...")
    )
    assert match_pixels(pixels("...", ".#.", "..."), pixels("...", "#.#", ".#."), 1)[1].equal(
        pixels("...", "#..", "...")
    )


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (5, 0), (1, 1)])
def test_tiny_maps(shape: tuple[int, int]) -> None:
    full = torch.ones(shape, dtype=torch.bool)
    for result in match_pixels(full, full, 3.0):
        assert torch.equal(result, full)
    for result in match_pixels(full, ~full, 3.0):
        assert torch.equal(result, ~full)


@few_and_many(
    60,
    300,
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(1, 14),
    width=st.integers(1, 14),
    density=st.sampled_from([0.05, 0.2, 0.5, 0.9]),
    radius=RADII,
)
def test_the_twin_and_scipy(seed: int, height: int, width: int, density: float, radius: float) -> None:
    pred, target = random_maps(seed, height, width, density)
    got = match_pixels(pred, target, radius)
    for one, other in zip(got, match_pixels_reference(pred, target, radius), strict=True):
        assert torch.equal(one, other)
    pred_matched, target_matched = got
    assert not (pred_matched & ~pred).any()
    assert not (target_matched & ~target).any()
    assert int(pred_matched.sum()) == int(target_matched.sum()) == maximum(pred, target, radius)


def test_any_strides() -> None:
    pred, target = random_maps(0, 9, 13, 0.3)
    for one, other in zip(
        match_pixels(pred.T.contiguous().T, target.flip(0).flip(0), 2), match_pixels(pred, target, 2), strict=True
    ):
        assert torch.equal(one, other)


def test_maps_of_an_image_s_size() -> None:
    pred, target = random_maps(1, 240, 320, 0.05)
    pred_matched, target_matched = match_pixels(pred, target, 3.0)
    assert int(pred_matched.sum()) == int(target_matched.sum()) == maximum(pred, target, 3.0)
