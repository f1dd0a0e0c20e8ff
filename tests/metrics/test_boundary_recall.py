"""Boundary recall against a loop over paths in the graph, and by hand."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.metrics import boundary_recall
from torchjoint.ops import neighbor_edges


def slow_recall(pred, target, edges, tolerance):
    """A true border is found if a predicted one is within `tolerance` steps along edges without void."""
    inside = [(i, j) for i, j in edges if target[i] >= 0 and target[j] >= 0]
    border = [(i, j) for i, j in inside if target[i] != target[j]]
    if not border:
        return 1.0
    found = 0
    for edge in border:
        near, ends = {edge}, set(edge)
        for _ in range(tolerance):
            near |= {other for other in inside if ends & set(other)}
            ends |= {point for other in near for point in other}
        found += any(pred[i] != pred[j] for i, j in near)
    return found / len(border)


@st.composite
def cases(draw):
    size = draw(st.integers(2, 14))
    labels = st.lists(st.integers(-1, 3), min_size=size, max_size=size)
    targets = draw(st.lists(labels.filter(lambda one: max(one) >= 0), min_size=1, max_size=2))
    points = st.integers(0, size - 1)
    return draw(labels), targets, draw(st.lists(st.tuples(points, points), min_size=1, max_size=20))


@given(cases(), st.integers(0, 3))
def test_it_is_the_loop(case, tolerance):
    pred, targets, edges = case
    found = boundary_recall(
        torch.tensor(pred), [torch.tensor(one) for one in targets], torch.tensor(edges).T, tolerance=tolerance
    )
    expected = sum(slow_recall(pred, one, edges, tolerance) for one in targets) / len(targets)
    assert found == pytest.approx(expected, abs=1e-12)


@given(cases(), st.permutations(range(4)))
def test_numbers_and_directions_do_not_matter(case, order):
    pred, (target, *_), edges = torch.tensor(case[0]), [torch.tensor(one) for one in case[1]], torch.tensor(case[2]).T
    number = torch.tensor([*order, -1]) * 10**15
    number[-1] = -1
    renumbered = boundary_recall(number[pred], number[target], edges.flip(0))
    assert renumbered == boundary_recall(pred, target, edges)


def chain(size):
    return torch.stack([torch.arange(size - 1), torch.arange(1, size)])


def test_tolerance_by_hand():
    """True borders at 2-3 and 7-8, predicted ones at 2-3 and 5-6."""
    target = torch.tensor([0, 0, 0, 1, 1, 1, 1, 1, 2, 2])
    pred = torch.tensor([0, 0, 0, 1, 1, 1, 2, 2, 2, 2])
    recalls = [boundary_recall(pred, target, chain(10), tolerance=t) for t in range(4)]
    assert recalls == [0.5, 0.5, 1.0, 1.0]  # 7-8 is two edges from 5-6: 6-7 is between them
    assert boundary_recall(pred, target, chain(10)) == recalls[1]


def test_edges_at_void_neither_count_nor_help():
    target = torch.tensor([0, 0, -1, 1, 1, 2])
    pred = torch.tensor([0, 0, 1, 2, 2, 2])  # its only borders are at the void point
    assert boundary_recall(pred, target, chain(6), tolerance=10**12) == 0.0
    assert boundary_recall(pred, torch.tensor([0, 0, -1, 1, 1, 1]), chain(6)) == 1.0  # no border left to miss


def test_grid_of_neighbors():
    """Superpoints that are squares of half the size follow every border; shifted by two points they follow none."""
    rows, columns = torch.meshgrid(torch.arange(24), torch.arange(24), indexing="ij")
    index = rows * 24 + columns
    right = torch.stack([index[:, :-1].flatten(), index[:, 1:].flatten()])
    down = torch.stack([index[:-1].flatten(), index[1:].flatten()])
    edges = torch.cat([right, down], dim=1)
    target = columns // 12
    assert boundary_recall(rows // 6 * 4 + columns // 6, target, edges, tolerance=0) == 1.0
    assert boundary_recall((columns + 3) // 6, target, edges) == 0.0
    assert boundary_recall((columns + 3) // 6, target, edges, tolerance=3) == 1.0


def test_edges_may_be_those_of_neighbors():
    neighbors = torch.tensor([[1], [0], [3], [2]])
    assert boundary_recall(torch.arange(4), torch.tensor([0, 1, 1, 1]), neighbor_edges(neighbors)) == 1.0
    assert boundary_recall(torch.arange(4), torch.tensor([0, 1, 1, 1]), neighbor_edges(neighbors).int()) == 1.0


ONES = torch.ones(4, dtype=torch.int64)


@pytest.mark.parametrize(
    ("edges", "error", "message"),
    [
        ([[0], [1]], TypeError, "edge_index: expected an integer tensor, got list"),
        (chain(4).float(), TypeError, "edge_index: expected an integer tensor, got torch.float32"),
        (chain(4).T, ValueError, r"edge_index: expected shape \[2, E\] with E >= 1, got \[3, 2\]"),
        (chain(4)[:, :0], ValueError, "edge_index: expected shape"),
        (chain(5), ValueError, r"edge_index: expected points in 0 ... 3, got 0 ... 4"),
        (chain(4) - 1, ValueError, r"edge_index: expected points in 0 ... 3, got -1 ... 2"),
    ],
)
def test_bad_edges(edges, error, message):
    with pytest.raises(error, match=message):
        boundary_recall(ONES, ONES, edges)


@pytest.mark.parametrize("tolerance", [-1, 0.5, float("nan")])
def test_bad_tolerance(tolerance):
    with pytest.raises(ValueError, match="tolerance: expected a number of edges >= 0"):
        boundary_recall(ONES, ONES, chain(4), tolerance=tolerance)


def test_bad_labels():
    with pytest.raises(ValueError, match="target: expected the shape of pred"):
        boundary_recall(ONES, ONES[:3], chain(3))
    with pytest.raises(ValueError, match=r"nothing but -1 \(void\)"):
        boundary_recall(ONES, -ONES, chain(3))
