"""The nearest neighbours of all points: those of the twin, with ties, copies, and points far apart."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from reference.nearest_neighbors import nearest_neighbors_reference

from torchjoint.ops import nearest_neighbors


def cloud(kind: str, num_points: int, seed: int, dtype: torch.dtype) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    points = torch.rand(num_points, 3, generator=generator, dtype=torch.float64)
    if kind == "lattice":  # equal distances wherever one looks
        points = (points * 5).round() / 10
    elif kind == "plane":
        points[:, 2] = 0
    elif kind == "copies":
        points = points[torch.randint(1 + num_points // 20, (num_points,), generator=generator)]
    elif kind == "outliers":
        points = (points - 0.5) ** 9 * 1e6
    elif kind == "cluster":  # most points lie in a tiny part of the room, with a cluster inside
        points[num_points // 5 :] *= 1e-5
        points[num_points // 2 :] *= 1e-5
        points = points[torch.randperm(num_points, generator=generator)]
    elif kind == "far away":  # rounded to few different coordinates in float32
        points += 1e5
    elif kind == "tiny":  # squares vanish in float32, and some in float64
        points = (points * 5).round() * 10.0 ** torch.randint(-170, -20, (num_points, 1), generator=generator)
    return points.to(dtype)


KINDS = ("random", "lattice", "plane", "copies", "outliers", "cluster", "far away", "tiny")


def check(points: torch.Tensor, *counts: int) -> None:
    expected, measured = nearest_neighbors_reference(points, max(counts))
    for count in counts:
        indices, distances = nearest_neighbors(points, count)
        assert torch.equal(indices, expected[:, :count])
        rtol = 1e-15 if points.dtype == torch.float64 else 1e-6
        torch.testing.assert_close(distances, measured[:, :count], rtol=rtol, atol=0)


@given(
    st.sampled_from(KINDS), st.integers(0, 100), st.integers(0, 40), st.integers(0, 10_000),
    st.sampled_from([torch.float32, torch.float64]),
)  # fmt: skip
def test_neighbours_are_the_twin_s(kind: str, num_points: int, count: int, seed: int, dtype: torch.dtype) -> None:
    check(cloud(kind, num_points, seed, dtype), count)


@pytest.mark.parametrize("kind", KINDS)
def test_neighbours_in_a_deep_tree_are_the_twin_s(kind: str) -> None:
    check(cloud(kind, 700, 0, torch.float32), 1, 16, 130)  # the last is more than are sorted by rank


@given(
    st.sampled_from(KINDS), st.integers(1, 200), st.integers(1, 20), st.integers(0, 10_000),
    st.sampled_from([torch.float32, torch.float64]),
)  # fmt: skip
def test_neighbours_within_limits_are_the_twin_s(
    kind: str, num_points: int, count: int, seed: int, dtype: torch.dtype
) -> None:
    points = cloud(kind, num_points, seed, dtype)
    # The limits are distances that occur, or shares of them: from 0 to beyond the last wanted neighbour.
    limits = torch.cdist(points.double(), points.double())[:, seed % num_points] * (seed % 7) / 6
    expected, measured = nearest_neighbors_reference(points, count, limits=limits)
    indices, distances = nearest_neighbors(points, count, limits=limits)
    assert torch.equal(indices, expected)
    torch.testing.assert_close(distances, measured, rtol=1e-15 if dtype == torch.float64 else 1e-6, atol=0)


def test_a_point_takes_the_place_of_neighbours_beyond_its_limit() -> None:
    points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    indices, distances = nearest_neighbors(points, 2, limits=torch.tensor([0.9, 1.0, 3.0], dtype=torch.float64))
    assert indices.tolist() == [[0, 0], [0, 1], [1, 0]]
    assert distances.tolist() == [[torch.inf, torch.inf], [1, torch.inf], [2, 3]]


def test_of_equally_far_points_the_smaller_number_comes_first() -> None:
    cross = torch.tensor([[0.0, 1, 0], [1, 0, 0], [0, 0, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1]])
    indices, distances = nearest_neighbors(cross, 4, 2)
    assert indices[2].tolist() == [0, 1, 3, 4]
    assert distances[2].tolist() == [1, 1]
    assert nearest_neighbors(cross.flip(0), 4)[0][3].tolist() == [0, 1, 2, 4]


def test_copies_are_neighbours_by_number() -> None:
    points = torch.cat([torch.zeros(10_000, 3), torch.ones(10_000, 3)])[torch.arange(20_000).view(2, -1).t().flatten()]
    indices, distances = nearest_neighbors(points, 3)
    assert indices[:4].tolist() == [[2, 4, 6], [3, 5, 7], [0, 4, 6], [1, 5, 7]]
    assert (indices[8:] == torch.tensor([[0, 2, 4], [1, 3, 5]]).repeat(10_000 - 4, 1)).all()
    assert not distances.any()


def test_any_strides() -> None:
    points = cloud("random", 100, 0, torch.float32)
    assert torch.equal(nearest_neighbors(points.t().contiguous().t(), 5)[0], nearest_neighbors(points, 5)[0])


@pytest.mark.parametrize("others", [30, 6000])
def test_a_dense_cluster_in_a_room(others: int) -> None:
    """In a balanced tree it takes quadratic time: twenty seconds."""
    points = torch.cat([torch.rand(others, 3) * 4 - 2, torch.rand(40_000, 3) * 1e-5])
    _, distances = nearest_neighbors(points, 16)
    some = torch.cat([torch.arange(10), torch.arange(others, others + 10)])
    expected = torch.cdist(points[some].double(), points.double()).sort().values[:, 1:17]
    torch.testing.assert_close(distances[some].double(), expected, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize(("dtype", "size"), [(torch.float32, 1e-18), (torch.float32, 1e-25), (torch.float64, 1e-140)])
def test_a_clump_whose_squared_distances_vanish(dtype: torch.dtype, size: float) -> None:
    """Each of its points was a candidate of each other one: 40,000 points took two minutes."""
    clump = cloud("random", 10_000, 0, torch.float32).to(dtype)
    found, _ = nearest_neighbors(clump * size, 16)
    assert found.shape == (10_000, 16)
    room = torch.cat([clump[:500] * 4 - 2, clump[500:700] * size])
    check(room, 16)
