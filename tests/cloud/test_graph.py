import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from reference.fit_normals import fit_normals_reference
from reference.neighbor_edges import neighbor_edges_reference

from torchjoint import ops
from torchjoint.cloud.edge_weights import EdgeWeights, discounted_angle, geometric_weights
from torchjoint.cloud.graph import undirected_edges
from torchjoint.cloud.neighbors import nearest_neighbors, order_along_space
from torchjoint.cloud.normals import angle_between, estimate_normals


def random_points(count, seed=0):
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(seed))


def test_nearest_neighbors_against_all_distances():
    points = random_points(200)
    neighbors = nearest_neighbors(points, 7)
    distances = torch.cdist(points.double(), points.double()).fill_diagonal_(torch.inf)
    expected = distances.sort(dim=1)
    assert torch.equal(neighbors.indices, expected.indices[:, :7])
    torch.testing.assert_close(neighbors.spacing.double(), expected.values[:, :4].mean(dim=1))


def test_duplicate_points_are_never_their_own_neighbours():
    points = torch.cat([torch.zeros(10, 3), random_points(5)])
    neighbors = nearest_neighbors(points, 4)
    assert neighbors.indices.shape == (15, 4)
    assert not (neighbors.indices == torch.arange(15)[:, None]).any()
    assert (neighbors.indices[:10] < 10).all()
    assert (neighbors.spacing[:10] == 0).all()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_fewer_points_than_neighbours(count):
    points = random_points(count)
    neighbors = nearest_neighbors(points, 16)
    assert neighbors.indices.shape == (count, count - 1)
    assert neighbors.spacing.shape == (count,)
    assert undirected_edges(neighbors.indices).shape == (2, count * (count - 1) // 2)
    assert estimate_normals(points, neighbors.indices).norm(dim=1).tolist() == pytest.approx([1.0] * count)


@given(st.integers(2, 40), st.integers(1, 12), st.integers(0, 10_000))
def test_undirected_edges_are_the_symmetrised_graph_once(num_points, count, seed):
    generator = np.random.default_rng(seed)
    count = min(count, num_points - 1)
    rows = [generator.permutation(np.delete(np.arange(num_points), i))[:count] for i in range(num_points)]
    edges = undirected_edges(torch.from_numpy(np.stack(rows)))
    expected = {(min(i, j), max(i, j)) for i in range(num_points) for j in rows[i].tolist()}
    assert (edges[0] < edges[1]).all()
    assert edges.shape[1] == len(expected)
    assert {tuple(edge) for edge in edges.T.tolist()} == expected


def beams(gap, step=0.01, length=3.0):
    """Five straight beams on the ground, `gap` apart, with a point every `step`."""
    x, y = torch.meshgrid(torch.arange(0, length, step), torch.arange(5) * gap, indexing="ij")
    return torch.stack([x, y, torch.zeros_like(x)], dim=-1).view(-1, 3)


def test_neighbors_that_reach_across_beams():
    points = beams(gap=0.2)
    y = points[:, 1]
    nearest = nearest_neighbors(points, 8).indices.long()
    assert (y[nearest] == y[:, None]).all()  # all along the beam
    far = nearest_neighbors(points, 8, reach=0.2).indices.long()
    assert ((y[far] != y[:, None]).any(dim=1)).float().mean() > 0.95
    # No point is its own neighbour, none comes twice, and they come nearest first.
    assert (far != torch.arange(len(points))[:, None]).all()
    assert (far.sort(dim=1).values.diff(dim=1) > 0).all()
    assert ((points[far] - points[:, None]).norm(dim=2).diff(dim=1) >= -1e-6).all()
    # Where they reached far enough at first, nothing has changed.
    assert torch.equal(nearest_neighbors(points, 8, reach=0.03).indices.long(), nearest)


def test_neighbors_reach_no_farther_than_there_are_points():
    points = random_points(40)
    everything = nearest_neighbors(points, 30).indices
    assert torch.equal(nearest_neighbors(points, 30, reach=100.0).indices, everything)  # half of them are too few
    assert nearest_neighbors(points[:1], 5, reach=1.0).indices.shape == (1, 0)
    spread = nearest_neighbors(points, 8, reach=100.0).indices
    assert len(spread.unique()) <= 20  # of half of the points


@given(st.integers(1, 40), st.integers(0, 70), st.integers(0, 10_000), st.sampled_from([torch.int32, torch.int64]))
def test_edges_are_their_twin_s(num_points, count, seed, dtype):
    # Any table: rows that name themselves, or a neighbour twice, and more columns than points.
    neighbors = torch.randint(
        num_points, (num_points, count), generator=torch.Generator().manual_seed(seed), dtype=dtype
    )
    assert torch.equal(ops.neighbor_edges(neighbors), neighbor_edges_reference(neighbors))
    assert torch.equal(ops.neighbor_edges(neighbors.T.contiguous().T), neighbor_edges_reference(neighbors))


@given(
    st.integers(3, 60), st.integers(2, 20), st.integers(0, 10_000), st.sampled_from(["blob", "plane", "line", "grid"])
)
def test_normals_are_their_twin_s(num_points, count, seed, kind):
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn(num_points, 3, generator=generator, dtype=torch.float64)
    if kind == "grid":  # many neighbourhoods that vary alike in several directions, or coincide
        points = points.round()
    elif kind != "blob":
        thin = torch.tensor([1.0, 1.0, 1e-4]) if kind == "plane" else torch.tensor([1.0, 1e-4, 1e-5])
        points = (points * thin) @ torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))[0]
    neighbors = torch.randint(num_points, (num_points, count), generator=generator)
    normals, expected = ops.fit_normals(points, neighbors), fit_normals_reference(points, neighbors)
    assert torch.equal(ops.fit_normals(points, neighbors.int()), normals)
    torch.testing.assert_close(normals.norm(dim=1), torch.ones(num_points))
    around = torch.cat([points[:, None], points[neighbors]], dim=1)
    covariance = torch.linalg.matmul((around - around.mean(1, keepdim=True)).mT, around - around.mean(1, keepdim=True))
    values = torch.linalg.eigvalsh(covariance)
    # Whatever direction it is, the points vary no more in it than they must.
    variance = torch.einsum("ni,nij,nj->n", normals.double(), covariance, normals.double())
    rounding = 1e-25  # of the mean above, where the points coincide
    assert (variance <= values[:, 0] + 1e-6 * values[:, 2] + rounding).all()
    one_way = values[:, 1] - values[:, 0] > 1e-6 * values[:, 2] + rounding  # and where there is only one:
    same = (normals * expected).sum(dim=1)
    assert (same[one_way].abs() > 1 - 1e-4).all()
    assert (same[one_way & (expected[:, 2] > 1e-3)] > 0).all()
    assert (normals[:, 2] >= 0).all()


def test_degenerate_neighbourhoods():
    up = [0.0, 0.0, 1.0]
    everyone = torch.tensor([[1, 2], [0, 2], [0, 1]])
    assert ops.fit_normals(torch.zeros(3, 3), everyone).tolist() == [up] * 3
    assert ops.fit_normals(torch.eye(3), everyone[:, :1]).tolist() == [up] * 3  # two points are no plane
    for direction in torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 2, 3], [-1, 1e-3, 0]]):
        line = torch.arange(3.0)[:, None] * direction
        assert (ops.fit_normals(line, everyone) @ direction).abs().max() < 1e-6
    octahedron = torch.cat([torch.eye(3), -torch.eye(3)])  # no direction differs from another
    rows = torch.arange(6).repeat(6, 1)
    assert (ops.fit_normals(octahedron, rows).norm(dim=1) - 1).abs().max() < 1e-6
    tiny = 1e-18 * torch.tensor([[0.0, 0, 0], [0, 0, 1], [0, 2, 0]])
    assert ops.fit_normals(tiny, everyone).tolist() == [[1.0, 0.0, 0.0]] * 3


def test_threads_and_order_do_not_change_the_graph(set_threads):
    points = random_points(5000) ** 3
    results = []
    for threads in (1, 2, 5):
        set_threads(threads)
        neighbors = nearest_neighbors(points, 12)
        indices = neighbors.indices
        results.append((*neighbors, ops.fit_normals(points, indices), ops.neighbor_edges(indices)))
    order = torch.randperm(5000, generator=torch.Generator().manual_seed(0)).int()
    results.append((*neighbors, ops.fit_normals(points, indices, order), ops.neighbor_edges(indices, order)))
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


@pytest.mark.parametrize("extent", [1.0, 1e-30, 1e30, 0.0])
def test_the_order_along_space_is_one_of_cells(extent, monkeypatch):
    monkeypatch.setattr("torchjoint.cloud.neighbors.ORDERED", 2)
    points = torch.cartesian_prod(*[torch.tensor([0.1, 0.9])] * 3)[:, [2, 1, 0]]  # x changes first
    shuffled = torch.randperm(8, generator=torch.Generator().manual_seed(0))
    order = order_along_space(extent * points[shuffled])
    assert shuffled[order.long()].tolist() == (list(range(8)) if extent else shuffled.tolist())


def test_points_are_asked_for_in_superpoints(monkeypatch):
    points, expected = random_points(500), nearest_neighbors(random_points(500), 6, reach=0.3)
    normals = torch.nn.functional.normalize(random_points(500, 1), dim=1)
    edges, known = undirected_edges(expected.indices), torch.ones(500, dtype=torch.bool)
    terms = EdgeWeights(discounted_angle(0.05), distance=0.2)
    whole = geometric_weights(points, edges, normals, known, terms)
    monkeypatch.setattr("torchjoint.cloud.neighbors.QUERIES", 64)
    monkeypatch.setattr("torchjoint.cloud.edge_weights.EDGES", 128)
    superpoints = nearest_neighbors(points, 6, reach=0.3)
    assert torch.equal(superpoints.indices, expected.indices)
    assert torch.equal(superpoints.spacing, expected.spacing)
    assert torch.equal(
        geometric_weights(points, edges, normals, known, EdgeWeights(discounted_angle(0.05), distance=0.2)), whole
    )


def test_normals_of_a_tilted_plane():
    normal = torch.tensor([1.0, 2.0, -2.0]) / 3
    u, v = torch.tensor([2.0, -1.0, 0.0]), torch.linalg.cross(normal, torch.tensor([2.0, -1.0, 0.0]))
    spots = random_points(300)[:, :2]
    points = 100.0 + spots[:, :1] * u + spots[:, 1:] * v  # far from the origin: float32 must not suffer
    normals = estimate_normals(points, nearest_neighbors(points, 20).indices)
    assert (normals @ normal).abs().min() > 0.9999


def test_theta_by_hand():
    first = torch.tensor([[1.0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0]])
    second = torch.tensor([[0.0, 1, 0], [-1, 0, 0], [-1, 0, 0], [math.cos(2.5), math.sin(2.5), 0]])
    oriented = torch.tensor([True, True, False, False])
    expected = torch.tensor([math.pi / 2, math.pi, 0.0, math.pi - 2.5])
    torch.testing.assert_close(angle_between(first, second, oriented), expected)


def test_theta_is_exact_for_small_angles():
    # arccos of a float32 dot product would give 0 here.
    second = torch.tensor([[math.cos(1e-4), math.sin(1e-4), 0.0]])
    theta = angle_between(torch.tensor([[1.0, 0, 0]]), second, torch.tensor([True]))
    assert theta.item() == pytest.approx(1e-4, rel=1e-4)


def test_eq_3_by_hand():
    points = torch.tensor([[0.0, 0, 0], [3.0, 4, 0]])  # 5 m apart
    normals = torch.tensor([[1.0, 0, 0], [0, 0, 1.0]])  # pi / 2
    colors = torch.tensor([[0.0, 0, 0], [0.6, 0.0, 0.8]])  # 1 apart
    terms = EdgeWeights(discounted_angle(1.0), distance=0.1, color=0.25)
    edge_index, oriented = torch.tensor([[0], [1]]), torch.tensor([True, True])
    weight = geometric_weights(points, edge_index, normals, oriented, terms, colors)
    assert weight.item() == pytest.approx(0.1 * 5 + math.pi / 2 + 0.25 * 1)
    weight = geometric_weights(points, edge_index, normals, oriented, terms._replace(angle=2.0), colors)
    assert weight.item() == pytest.approx(0.1 * 5 + 2.0 * math.pi / 2 + 0.25 * 1)


def test_convex_edges_count_less():
    # The edge of a box (normals part) and of a corner of a room (normals meet), both of 90 degrees.
    points = torch.tensor([[-1.0, 0, 0], [0, 0, -1]])
    edge_index, known = torch.tensor([[0], [1]]), torch.ones(2, dtype=torch.bool)
    box, corner = torch.tensor([[0.0, 0, 1], [1, 0, 0]]), torch.tensor([[0.0, 0, -1], [-1, 0, 0]])
    terms = EdgeWeights(discounted_angle(0.25))

    def weight(normals, oriented):
        return geometric_weights(points, edge_index, normals, oriented, terms).item()

    assert weight(box, known) == pytest.approx(0.25 * math.pi / 2)
    assert weight(corner, known) == pytest.approx(math.pi / 2)
    assert weight(box, ~known) == pytest.approx(math.pi / 2)  # without signs nobody knows which it is


def test_colour_needs_colours():
    terms = EdgeWeights(discounted_angle(1.0), color=1.0)
    with pytest.raises(ValueError, match="colors: color_weight > 0 needs the colours"):
        geometric_weights(
            torch.zeros(2, 3), torch.tensor([[0], [1]]), torch.ones(2, 3), torch.ones(2, dtype=torch.bool), terms
        )
