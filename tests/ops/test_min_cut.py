"""min_cut against its slow twin, brute force, and SciPy."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest
import torch
from effort import few_and_many
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.min_cut import min_cut_reference
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow
from torch import Tensor

from torchjoint.ops import min_cut

Problem = tuple[Tensor, Tensor, Tensor, Tensor]

SMALL = st.sampled_from([0.0, 0.0, 1.0, 1.0, 2.0, 3.0])  # many ties, hence many minimum cuts
REAL = st.floats(0, 100)
WILD = st.sampled_from([1e-300, 5e-324, 1e-9, 0.1, 1e9, 1e300, float("inf")])


@st.composite
def problems(draw: st.DrawFn, max_nodes: int = 14) -> Problem:
    """Multigraphs with self loops and parallel edges; integer, real or wildly mixed capacities."""
    num_nodes = draw(st.integers(0, max_nodes))
    num_edges = draw(st.integers(0, 40)) if num_nodes else 0
    seed = draw(st.integers(0, 2**32 - 1))
    edge_index = torch.randint(num_nodes or 1, (2, num_edges), generator=torch.Generator().manual_seed(seed))
    kind = draw(st.sampled_from([SMALL, REAL, st.one_of(SMALL, REAL, WILD)]))
    capacity = draw(st.lists(kind.filter(np.isfinite), min_size=num_edges, max_size=num_edges))
    source = draw(st.lists(kind, min_size=num_nodes, max_size=num_nodes))
    sink = draw(st.lists(kind, min_size=num_nodes, max_size=num_nodes))
    sink = [0.0 if np.isinf(s) and np.isinf(t) else t for s, t in zip(source, sink, strict=True)]
    return edge_index, *(torch.tensor(values, dtype=torch.float64) for values in (capacity, source, sink))


def grid_problem(height: int, width: int, seed: int) -> Problem:
    """A 4-connected grid with integer capacities, a few seeds of each kind, and weak terminals elsewhere."""
    rng = np.random.default_rng(seed)
    index = np.arange(height * width).reshape(height, width)
    edges = np.concatenate(
        [[index[:, :-1].ravel(), index[:, 1:].ravel()], [index[:-1].ravel(), index[1:].ravel()]], axis=1
    )
    capacity = rng.integers(0, 20, edges.shape[1]).astype(np.float64)
    source, sink = rng.integers(0, 12, (2, height * width)).astype(np.float64) * (rng.random((2, height * width)) < 0.4)
    return tuple(torch.from_numpy(array) for array in (edges, capacity, source, sink))


def cost(problem: Problem, side: np.ndarray) -> float:
    edge_index, capacity, source, sink = (tensor.numpy() for tensor in problem)
    return float(capacity[side[edge_index[0]] != side[edge_index[1]]].sum() + sink[side].sum() + source[~side].sum())


@few_and_many(100, 300, problem=problems())
def test_equals_twin(problem: Problem) -> None:
    side, flow = min_cut(*problem)
    expected_side, expected_flow = min_cut_reference(*problem)
    assert side.dtype == torch.bool
    assert flow.dtype == torch.float64
    assert flow.shape == ()
    assert torch.equal(side, expected_side)
    assert torch.equal(flow, expected_flow)


def test_equals_twin_on_grids() -> None:
    for seed in range(60):
        edge_index, capacity, source, sink = grid_problem(5 + seed % 7, 12, seed)
        if seed % 2:  # real capacities
            capacity, source, sink = (torch.exp(-0.3 * values) * (values > 0) for values in (capacity, source, sink))
        if seed % 3 == 0:  # seeds
            source[0] = sink[-1] = torch.inf
            source[-1] = sink[0] = 0
        side, flow = min_cut(edge_index, capacity, source, sink)
        expected_side, expected_flow = min_cut_reference(edge_index, capacity, source, sink)
        assert torch.equal(side, expected_side)
        assert torch.equal(flow, expected_flow)


@few_and_many(50, 200, problem=problems(max_nodes=6))
def test_smallest_of_all_minimum_cuts(problem: Problem) -> None:
    """By trying every side. Integers only, so that equal costs are equal."""
    problem = (problem[0], *(values.clamp(max=50).round() for values in problem[1:]))
    num_nodes = len(problem[2])
    sides = [np.array(bits, dtype=bool) for bits in itertools.product([False, True], repeat=num_nodes)]
    costs = [cost(problem, side) for side in sides]
    minimal = np.logical_and.reduce([side for side, c in zip(sides, costs, strict=True) if c == min(costs)])
    side, flow = min_cut(*problem)
    assert flow.item() == min(costs)
    assert side.tolist() == minimal.tolist()


def scipy_cut(problem: Problem) -> tuple[np.ndarray, float]:
    """For integer capacities. An infinite terminal becomes one more than all the rest."""
    edge_index, capacity, source, sink = (tensor.numpy() for tensor in problem)
    enough = capacity.sum() + source[np.isfinite(source)].sum() + sink[np.isfinite(sink)].sum() + 1
    num_nodes = len(source)
    nodes, s, t = np.arange(num_nodes), num_nodes, num_nodes + 1
    rows = np.concatenate([edge_index[0], edge_index[1], np.full(num_nodes, s), nodes])
    columns = np.concatenate([edge_index[1], edge_index[0], nodes, np.full(num_nodes, t)])
    values = np.minimum(np.concatenate([capacity, capacity, source, sink]), enough).astype(np.int32)
    graph = coo_array((values, (rows, columns)), shape=(num_nodes + 2, num_nodes + 2)).tocsr()
    graph.setdiag(0)
    result = maximum_flow(graph, s, t)
    residual = graph - result.flow
    residual.eliminate_zeros()
    reached = np.zeros(num_nodes + 2, dtype=bool)
    reached[breadth_first_order(residual, s, return_predecessors=False)] = True
    return reached[:num_nodes], float(result.flow_value)


def grid_3d(side: int) -> np.ndarray:
    index = np.arange(side**3).reshape(side, side, side)
    pairs = [(index[:-1], index[1:]), (index[:, :-1], index[:, 1:]), (index[:, :, :-1], index[:, :, 1:])]
    return np.concatenate([[a.ravel(), b.ravel()] for a, b in pairs], axis=1)


def shape_of(name: str, size: int, rng: np.random.Generator) -> np.ndarray:
    """The edges of one of the graphs that solvers are slow or wrong on, with about `size` nodes."""
    nodes = np.arange(1, size)
    if name == "chain":
        return np.stack([nodes - 1, nodes])
    if name == "strip":
        return grid_problem(max(size // 3, 2), 3, 0)[0].numpy()
    if name == "grid":
        return grid_problem(int(size**0.5) + 1, int(size**0.5) + 1, 0)[0].numpy()
    if name == "3d grid":
        return grid_3d(round(size ** (1 / 3)) + 1)
    if name == "star":
        return np.stack([np.zeros_like(nodes), nodes])
    if name == "tree":
        return np.stack([rng.integers(0, nodes), nodes])
    if name == "tree with loops":
        return np.concatenate([[rng.integers(0, nodes), nodes], rng.integers(0, size, (2, size // 10 + 1))], axis=1)
    if name == "bipartite":
        return np.stack([rng.integers(0, size // 2, 2 * size), rng.integers(size // 2, size, 2 * size)])
    if name == "two blobs":
        half = size // 2
        blobs = rng.integers(0, half, (2, 4 * size)) + half * rng.integers(0, 2, 4 * size)
        return np.concatenate([blobs, [[0], [half]]], axis=1)
    return rng.integers(0, size, (2, 2 * size))


SHAPES = ["chain", "strip", "grid", "3d grid", "star", "tree", "tree with loops", "bipartite", "two blobs", "random"]


def shaped_problem(
    shape: str, size: int, seed: int, largest: int = 3, terminals: float = 0.3, seeds: float = 0.05
) -> Problem:
    """Integer capacities up to `largest`, so ties abound; terminals and infinite seeds at these shares of the nodes."""
    rng = np.random.default_rng(seed)
    edge_index = shape_of(shape, size, rng)
    num_nodes = int(edge_index.max()) + 1
    renumbered = rng.permutation(num_nodes)[edge_index]
    capacity = rng.integers(0, largest + 1, edge_index.shape[1])
    source, sink = rng.integers(0, largest + 1, (2, num_nodes)) * (rng.random((2, num_nodes)) < terminals)
    kind = rng.random(num_nodes)
    source, sink = np.where(kind < seeds, np.inf, source), np.where(kind > 1 - seeds, np.inf, sink)
    return tuple(torch.from_numpy(array) for array in (renumbered, capacity.astype(np.float64), source, sink))


def side_by_side(problems: list[Problem]) -> Problem:
    """One graph with all of them as components."""
    offsets = np.cumsum([0] + [len(problem[2]) for problem in problems]).tolist()
    edges = torch.cat([problem[0] + offset for problem, offset in zip(problems, offsets, strict=False)], dim=1)
    return edges, *(torch.cat([problem[i] for problem in problems]) for i in (1, 2, 3))


def assert_same_as_scipy(problem: Problem) -> None:
    side, flow = min_cut(*problem)
    expected_side, expected_flow = scipy_cut(problem)
    assert flow.item() == expected_flow
    assert side.tolist() == expected_side.tolist()


@pytest.mark.parametrize("seed", range(20))
def test_same_value_and_side_as_scipy(seed: int) -> None:
    assert_same_as_scipy(grid_problem(15 + seed, 20, seed))


@few_and_many(
    60,
    400,
    shape=st.sampled_from(SHAPES),
    size=st.integers(4, 400),
    seed=st.integers(0, 2**32 - 1),
    largest=st.sampled_from([1, 2, 5, 100]),
    terminals=st.sampled_from([0.0, 0.05, 0.3, 1.0]),
    seeds=st.sampled_from([0.0, 0.02, 0.3]),
)
def test_shapes(shape: str, size: int, seed: int, largest: int, terminals: float, seeds: float) -> None:
    """From a few strong terminals on bare graphs to graphs mostly of seeds, many of them neighbours."""
    assert_same_as_scipy(shaped_problem(shape, size, seed, largest, terminals, seeds))


@settings(max_examples=60)
@given(
    shapes=st.lists(st.sampled_from(SHAPES), min_size=2, max_size=40),
    seed=st.integers(0, 2**16),
    terminals=st.sampled_from([0.05, 0.3]),
)
def test_components_do_not_touch_each_other(shapes: list[str], seed: int, terminals: float) -> None:
    problems = [shaped_problem(shape, 6 + 3 * i, seed + i, terminals=terminals) for i, shape in enumerate(shapes)]
    problem = side_by_side(problems)
    assert_same_as_scipy(problem)
    side, flow = min_cut(*problem)
    parts = [min_cut(*part) for part in problems]
    assert torch.equal(side, torch.cat([part_side for part_side, _ in parts]))
    assert flow.item() == sum(part_flow.item() for _, part_flow in parts)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("largest", "terminals", "seeds"), [(1, 0.01, 0.01), (1000, 1.0, 0.0)])
def test_large_shapes(shape: str, largest: int, terminals: float, seeds: float) -> None:
    assert_same_as_scipy(shaped_problem(shape, 4000, 0, largest, terminals, seeds))


def test_float32_and_strides() -> None:
    edge_index, capacity, source, sink = grid_problem(20, 20, 0)
    expected = min_cut(edge_index, capacity, source, sink)
    spread = torch.stack([source, sink], 1)
    columns = edge_index.t().contiguous().t()
    assert not columns.is_contiguous()
    for result in (
        min_cut(edge_index, capacity.float(), source.float(), sink.float()),
        min_cut(columns, capacity.flip(0).contiguous().flip(0), spread[:, 0], spread[:, 1]),
        min_cut(edge_index, capacity.float(), source, sink),
    ):
        assert all(map(torch.equal, result, expected))


def test_parallel_edges_add_up_and_self_loops_do_nothing() -> None:
    source, sink = torch.tensor([torch.inf, 0.0, 0.0]), torch.tensor([0.0, 0.0, torch.inf])
    edge_index = torch.tensor([[0, 1, 0, 1, 1], [1, 0, 0, 2, 1]])
    side, flow = min_cut(edge_index, torch.tensor([1.0, 1.0, 9.0, 1.5, 9.0]), source, sink)
    assert side.tolist() == [True, True, False]
    assert flow.item() == 1.5


def test_source_side_is_the_minimal_one() -> None:
    """A chain of equal capacities can be cut anywhere: only the seed itself is reached."""
    edge_index = torch.tensor([[0, 1, 2], [1, 2, 3]])
    source, sink = torch.tensor([torch.inf, 0, 0, 0]), torch.tensor([0, 0, 0, torch.inf])
    for capacity in (1.0, 0.1, 1e-300, 1e300):
        side, flow = min_cut(edge_index, torch.full((3,), capacity, dtype=torch.float64), source, sink)
        assert side.tolist() == [True, False, False, False]
        assert flow.item() == capacity


def test_sums_that_floats_would_round() -> None:
    """0.1 + 0.2 in, 0.3 out, up to rounding: whichever way it falls, the twin agrees and repeats agree."""
    edge_index = torch.tensor([[0, 1, 2], [2, 2, 3]])
    source, sink = torch.tensor([torch.inf, torch.inf, 0, 0]), torch.tensor([0, 0, 0, torch.inf])
    problem = (edge_index, torch.tensor([0.1, 0.2, 0.1 + 0.2], dtype=torch.float64), source, sink)
    results = {tuple(min_cut(*problem)[0].tolist()) for _ in range(3)}
    assert results == {tuple(min_cut_reference(*problem)[0].tolist())}


def test_nodes_without_any_link_are_on_the_sink_side() -> None:
    none = torch.empty(2, 0, dtype=torch.int64)
    side, flow = min_cut(none, torch.empty(0), torch.tensor([0.0, 1.0, 1.0, 2.0]), torch.tensor([0.0, 1.0, 0.0, 1.0]))
    assert side.tolist() == [False, False, True, True]
    assert flow.item() == 2.0
    side, flow = min_cut(none, torch.empty(0), torch.empty(0), torch.empty(0))
    assert side.shape == (0,)
    assert flow.item() == 0.0


def test_cut_costs_what_is_reported() -> None:
    generator = torch.Generator().manual_seed(0)
    edge_index, _, source, sink = grid_problem(60, 60, 1)
    capacity = torch.exp(-torch.rand(edge_index.shape[1], generator=generator, dtype=torch.float64))
    problem = (edge_index, capacity, source / 5, sink / 5)
    side, flow = min_cut(*problem)
    assert flow.item() == pytest.approx(cost(problem, side.numpy()), rel=1e-12)
    assert 0 < side.sum() < len(side)


@pytest.mark.parametrize("width", [1, 3])
@pytest.mark.parametrize("kind", ["ends", "sparse", "comb of sinks", "comb of sources", "two ends"])
def test_long_thin_chains_take_no_quadratic_time(width: int, kind: str) -> None:
    length = 20_000
    edge_index, _, _, _ = grid_problem(length, width, 0)
    generator = torch.Generator().manual_seed(0)
    num_nodes, num_edges = length * width, edge_index.shape[1]
    source, sink = torch.zeros(2, num_nodes, dtype=torch.float64)
    capacity = torch.rand(num_edges, generator=generator, dtype=torch.float64) + 0.1
    weak = 1e-4 * torch.rand(num_nodes, generator=generator, dtype=torch.float64)
    if kind == "ends":
        source[0] = sink[-1] = torch.inf
    elif kind == "sparse":
        source[::61], sink[::47] = 1.0, 1.0
    elif kind == "comb of sinks":
        sink, source[0] = weak, torch.inf
    elif kind == "comb of sources":
        source, sink[0] = weak, torch.inf
    else:
        sink, source[0], source[-1] = weak, torch.inf, torch.inf
    start = time.perf_counter()
    side, flow = min_cut(edge_index, capacity, source, sink)
    assert time.perf_counter() - start < 60  # it takes a tenth of a second, and a quadratic solver minutes
    assert flow.item() == pytest.approx(cost((edge_index, capacity, source, sink), side.numpy()))


def test_same_result_every_time() -> None:
    problem = grid_problem(80, 80, 3)
    results = {(side.numpy().tobytes(), flow.item()) for side, flow in (min_cut(*problem) for _ in range(5))}
    assert len(results) == 1
