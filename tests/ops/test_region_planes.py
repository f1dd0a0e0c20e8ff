"""region_planes: by hand, against its slow twin, and the same on any number of threads."""

from __future__ import annotations

import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st
from reference.region_planes import region_planes_reference
from torch import Tensor

from torchjoint.ops import fit_normals
from torchjoint.ops.internal import region_planes

UP = torch.tensor([0.0, 0.0, 1.0])


def random_cloud(seed: int, num_points: int, num_neighbors: int, num_regions: int) -> tuple[Tensor, ...]:
    """Points, table, regions and normals, all at random: neighbours may come twice."""
    generator = torch.Generator().manual_seed(seed)
    points = torch.rand(num_points, 3, generator=generator) * torch.tensor([3.0, 2.0, 1.0])
    neighbors = torch.randint(num_points, (num_points, num_neighbors), generator=generator)
    region = torch.randint(num_regions, (num_points,), generator=generator) - 1
    normals = torch.nn.functional.normalize(torch.randn(num_points, 3, generator=generator), dim=1)
    return points, neighbors, region, normals


def scatters(points: Tensor, neighbors: Tensor, region: Tensor) -> Tensor:
    """[N, 3, 3] float64 of the points that count."""
    own = torch.cat([torch.arange(len(points))[:, None], neighbors.long()], 1)
    counts = (region[own] == region[:, None]).double()[:, :, None]
    around = points[own].double()
    centred = (around - (around * counts).sum(1, keepdim=True) / counts.sum(1, keepdim=True)) * counts
    return centred.transpose(1, 2) @ centred


@few_and_many(
    40,
    150,
    seed=st.integers(0, 2**32 - 1),
    num_points=st.integers(1, 30),
    num_neighbors=st.integers(0, 12),
    num_regions=st.integers(1, 4),
    min_points=st.sampled_from([3, 4, 6, 20]),
    dtype=st.sampled_from([torch.int32, torch.int64]),
)
def test_the_twin(
    seed: int, num_points: int, num_neighbors: int, num_regions: int, min_points: int, dtype: torch.dtype
) -> None:
    points, neighbors, region, normals = random_cloud(seed, num_points, num_neighbors, num_regions)
    mean, normal = region_planes(points, neighbors.to(dtype), region, normals, min_points)
    expected_mean, expected = region_planes_reference(points, neighbors, region, normals, min_points)
    torch.testing.assert_close(mean, expected_mean, rtol=0, atol=1e-6)
    kept = (expected == normals).all(1)
    assert torch.equal(normal[kept], normals[kept])
    torch.testing.assert_close(normal.norm(dim=1), torch.ones(num_points))
    assert ((normal * normals).sum(1) >= -1e-6).all()
    # Where no one direction is the flattest any may come: what is left to see is that it is as flat as the twin's.
    scatter = scatters(points, neighbors, region)
    spread, least = (torch.einsum("ni,nij,nj->n", n, scatter, n) for n in (normal.double(), expected.double()))
    torch.testing.assert_close(spread, least, rtol=0, atol=1e-5)
    eigenvalues = torch.linalg.eigvalsh(scatter)
    sure = (eigenvalues[:, 1] - eigenvalues[:, 0] > 0.01) & ((expected * normals).sum(1).abs() > 1e-3)
    torch.testing.assert_close(normal[sure], expected[sure], rtol=0, atol=1e-4)


def crease(side: int) -> tuple[Tensor, Tensor, Tensor]:
    """A floor and a wall, `side` x `side` points each, that meet along the y axis; their regions, and all others as
    neighbours."""
    along, out = (grid.flatten() for grid in torch.meshgrid(*[torch.arange(side).float()] * 2, indexing="ij"))
    floor = torch.stack([out + 1, along, torch.zeros_like(out)], 1)
    wall = torch.stack([torch.zeros_like(out), along, out + 1], 1)
    count = 2 * side * side
    everyone = torch.arange(count).expand(count, count)
    others = everyone[~torch.eye(count, dtype=torch.bool)].view(count, count - 1)
    return torch.cat([floor, wall]), torch.arange(count) // (side * side), others


def test_neighbours_in_another_region_do_not_count() -> None:
    points, region, others = crease(3)
    diagonal = torch.tensor([1.0, 0.0, 1.0]).expand(18, 3) / 2**0.5
    mean, normal = region_planes(points, others, region, diagonal)
    torch.testing.assert_close(normal[:9], UP.expand(9, 3))
    torch.testing.assert_close(normal[9:], torch.tensor([1.0, 0.0, 0.0]).expand(9, 3))
    torch.testing.assert_close(mean[:9], torch.tensor([2.0, 1.0, 0.0]).expand(9, 3))
    assert (fit_normals(points, others)[:9] - UP).norm(dim=1).min() > 0.5  # plain ones are in between


def test_normals_show_to_the_given_ones_side() -> None:
    points, region, others = crease(3)
    down = torch.tensor([-0.1, 0.0, -1.0])
    normal = region_planes(points, others, region, down.expand(18, 3))[1]
    torch.testing.assert_close(normal[:9], -UP.expand(9, 3))
    torch.testing.assert_close(normal[9:], torch.tensor([-1.0, 0.0, 0.0]).expand(9, 3))


@pytest.mark.parametrize(("min_points", "is_fitted"), [(9, True), (10, False)])
def test_the_point_itself_is_one_of_those_that_must_be(min_points: int, is_fitted: bool) -> None:
    points, region, others = crease(3)
    given = torch.nn.functional.normalize(torch.tensor([0.3, 0.2, 0.4]), dim=0).expand(18, 3)
    mean, normal = region_planes(points, others, region, given, min_points)
    torch.testing.assert_close(normal[:9], UP.expand(9, 3) if is_fitted else given[:9])
    torch.testing.assert_close(mean[0], torch.tensor([2.0, 1.0, 0.0]))  # the mean is that of however few there are


def test_without_neighbours_all_is_kept() -> None:
    points, *_, normals = random_cloud(0, 5, 0, 2)
    for row_length in (0, 4):
        others = torch.tensor([[1, 2, 3, 4], [0, 2, 3, 4], [0, 1, 3, 4], [0, 1, 2, 4], [0, 1, 2, 3]])[:, :row_length]
        mean, normal = region_planes(points, others, torch.arange(5), normals, 3)
        assert torch.equal(mean, points)
        assert torch.equal(normal, normals)


def test_no_points() -> None:
    none = torch.empty(0, 3)
    for result in region_planes(none, torch.empty(0, 4, dtype=torch.int32), torch.empty(0).long(), none):
        assert result.shape == (0, 3)


def test_far_from_the_origin() -> None:
    """Coordinates as in a survey: what is lost to float32 is lost before, and nothing more."""
    points, region, others = crease(3)
    offset = torch.tensor([4e5, -5e5, 300.0])
    mean, normal = region_planes(points + offset, others, region, UP.expand(18, 3))
    torch.testing.assert_close(normal[:9], UP.expand(9, 3))
    torch.testing.assert_close(mean[0] - offset, torch.tensor([2.0, 1.0, 0.0]))


@pytest.mark.parametrize("dtype", [torch.int32, torch.int64])
def test_the_number_of_threads_changes_nothing(dtype: torch.dtype, set_threads) -> None:
    points, neighbors, region, normals = random_cloud(1, 50_000, 12, 3)
    set_threads(1)
    expected = region_planes(points, neighbors.to(dtype), region, normals, 4)
    for count in (2, 4):
        set_threads(count)
        for one, other in zip(region_planes(points, neighbors.to(dtype), region, normals, 4), expected, strict=True):
            assert torch.equal(one, other)


def test_any_strides() -> None:
    points, neighbors, region, normals = random_cloud(2, 40, 8, 2)
    strided = (
        points.T.contiguous().T,
        neighbors.T.contiguous().T,
        region.repeat_interleave(2)[::2],
        normals.flip(0).flip(0),
    )
    for one, other in zip(
        region_planes(*strided, 4), region_planes(points, neighbors, region, normals, 4), strict=True
    ):
        assert torch.equal(one, other)
