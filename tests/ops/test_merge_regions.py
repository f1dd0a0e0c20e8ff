"""merge_regions: by hand, against its slow twin exactly, and that numbering is all that the order of edges changes."""

from __future__ import annotations

import math
from contextlib import nullcontext

import pytest
import torch
from effort import few_and_many
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.merge_regions import merge_regions_reference
from torch import Tensor

from torchjoint.ops import merge_regions
from torchjoint.runtime.threads import one_thread_per_operation


def edges_of(*pairs: tuple[int, int]) -> Tensor:
    return torch.tensor(pairs, dtype=torch.int64).view(-1, 2).t()


def merged(
    pairs: list[tuple[int, int]], cost: list[float], threshold: float, *, size: list[int] | None = None, **options: int
) -> list[int]:
    """Of as many regions of one point each as edges name, unless sizes are given."""
    sizes = [1] * (1 + max(map(max, pairs))) if size is None else size
    return merge_regions(edges_of(*pairs), torch.tensor(cost), torch.tensor(sizes), threshold, **options).tolist()


def random_regions(seed: int, num_regions: int, num_edges: int) -> tuple[Tensor, Tensor]:
    """A multigraph with self loops, and sizes 0 to 5."""
    generator = torch.Generator().manual_seed(seed)
    edges = torch.randint(num_regions, (2, num_edges), generator=generator)
    return edges, torch.randint(6, (num_regions,), generator=generator)


@few_and_many(
    100,
    300,
    seed=st.integers(0, 2**32 - 1),
    num_regions=st.integers(1, 30),
    num_edges=st.integers(0, 60),
    levels=st.sampled_from([1, 2, 3, 4, 1000]),
    threshold=st.sampled_from([0.0, 0.2, 0.5, 0.75, 1.0, math.inf]),
    min_size=st.sampled_from([0, 1, 3, 8, 1000]),
    by_size=st.booleans(),
)
def test_the_twin(
    seed: int, num_regions: int, num_edges: int, levels: int, threshold: float, min_size: int, by_size: bool
) -> None:
    """With few levels of costs nearly all borders tie at one time or another."""
    edges, size = random_regions(seed, num_regions, num_edges)
    cost = torch.randint(levels, (num_edges,), generator=torch.Generator().manual_seed(seed)) / max(levels - 1, 1)
    got = merge_regions(edges, cost, size, threshold, min_size, by_size=by_size)
    assert got.tolist() == merge_regions_reference(edges, cost, size, threshold, min_size, by_size=by_size).tolist()


@few_and_many(
    100,
    500,
    seed=st.integers(0, 2**32 - 1),
    num_regions=st.integers(4, 30),
    levels=st.sampled_from([2, 4, 1000]),
    threshold=st.sampled_from([0.2, 0.5, 0.75, math.inf]),
    min_size=st.sampled_from([0, 3]),
)
def test_the_twin_with_regions_in_three_blocks(
    seed: int, num_regions: int, levels: int, threshold: float, min_size: int
) -> None:
    """Blocks of 8,192 successive regions are merged first; between these regions are only such without edges."""
    edges, size = random_regions(seed, num_regions, 3 * num_regions)
    cost = torch.randint(levels, (3 * num_regions,), generator=torch.Generator().manual_seed(seed)) / (levels - 1)
    place = torch.arange(num_regions) + 8192 * (torch.arange(num_regions) * 3 // num_regions)
    sizes = torch.zeros(3 * 8192, dtype=torch.int64).index_copy_(0, place, size)
    _, got = torch.unique(merge_regions(place[edges], cost, sizes, threshold, min_size)[place], return_inverse=True)
    assert got.tolist() == merge_regions_reference(edges, cost, size, threshold, min_size).tolist()


@pytest.mark.parametrize(("levels", "threshold", "min_size"), [(5, 0.3, 0), (5, 0.0, 4), (1000, 0.2, 4)])
def test_the_twin_agrees_when_borders_need_more_room(levels, threshold, min_size):
    edges, size = random_regions(seed=levels, num_regions=60, num_edges=3000)
    cost = torch.randint(levels, (3000,), generator=torch.Generator().manual_seed(1)) / (levels - 1)
    got = merge_regions(edges, cost, size, threshold, min_size)
    assert got.tolist() == merge_regions_reference(edges, cost, size, threshold, min_size).tolist()
    assert 1 < got.max() < 59


@pytest.mark.parametrize("threads", [1, 2])
def test_separate_graphs_do_not_touch_one_another(threads):
    """So many edges that they are merged in several blocks, whose regions alternate in memory."""
    copies, levels = 40, 50
    edges, size = random_regions(seed=3, num_regions=60, num_edges=1000)
    cost = torch.randint(levels, (1000,), generator=torch.Generator().manual_seed(2)) / (levels - 1)
    expected = merge_regions_reference(edges, cost, size, 0.1, 4)
    assert 2 < expected.max() < 30
    many = torch.cat([edges * copies + copy for copy in range(copies)], 1)
    with one_thread_per_operation() if threads == 1 else nullcontext():
        got = merge_regions(many, cost.repeat(copies), size.repeat_interleave(copies), 0.1, 4).view(60, copies)
    for copy in range(copies):
        _, numbered = torch.unique(got[:, copy], return_inverse=True)  # in each copy, first regions ascend alike
        assert numbered.tolist() == expected.tolist()


@settings(max_examples=100, derandomize=True)  # costs hardly ever tie, but they may
@given(seed=st.integers(0, 2**32 - 1), num_regions=st.integers(1, 60), threshold=st.sampled_from([0.1, 0.3, 0.6]))
def test_without_ties_the_order_of_edges_changes_nothing(seed: int, num_regions: int, threshold: float) -> None:
    """Float32 would tell sums in another order apart; sums of whole numbers do not."""
    generator = torch.Generator().manual_seed(seed)
    edges, size = random_regions(seed, num_regions, 5 * num_regions)
    cost = torch.rand(5 * num_regions, generator=generator)
    order = torch.randperm(len(cost), generator=generator)
    other = torch.where(torch.rand(len(cost), generator=generator) < 0.5, edges, edges.flip(0))
    expected = merge_regions(edges, cost, size, threshold, 6)
    assert torch.equal(merge_regions(other[:, order], cost[order], size, threshold, 6), expected)


def test_a_border_counts_by_its_mean() -> None:
    pairs, cost = [(0, 1), (1, 0), (0, 1)], [0.0, 0.0, 0.9]
    assert merged(pairs, cost, 0.29) == [0, 1]
    assert merged(pairs, cost, 0.31) == [0, 0]


def test_the_threshold_is_inclusive() -> None:
    assert merged([(0, 1)], [0.25], 0.25) == [0, 0]
    assert merged([(0, 1)], [0.25], 0.249) == [0, 1]
    assert merged([(0, 1), (1, 2)], [0.0, 2**-20], 0) == [0, 0, 1]
    assert merged([(0, 1)], [1024.0], math.inf) == [0, 0]


def test_borders_with_a_third_region_become_one() -> None:
    # 0 and 1 merge first; their borders to 2 then have the mean 0.5, which neither the one nor the other has.
    pairs = [(0, 1), (0, 2), (1, 2), (1, 2)]
    cost = [0.0, 0.1, 0.7, 0.7]
    assert merged(pairs, cost, 0.4) == [0, 0, 1]
    assert merged(pairs, cost, 0.51) == [0, 0, 0]
    assert merged([(0, 2), (1, 2), (1, 2)], [0.1, 0.7, 0.7], 0.4) == [0, 1, 0]


def test_sizes_count_in_the_cost() -> None:
    # 0.25 x 30 x 6 / 36 = 1.25, and 0.125 x 30 x 15 / 45 = 1.25, too, which is 0.125 x 36 x 15 / 51 = 1.32 after it.
    edges, cost, size = edges_of((0, 1), (0, 2)), torch.tensor([0.25, 0.125]), torch.tensor([30, 6, 15])
    for threshold, expected in ((1.24, [0, 1, 2]), (1.25, [0, 0, 1]), (1.3, [0, 0, 1]), (1.33, [0, 0, 0])):
        assert merge_regions(edges, cost, size, threshold, by_size=True).tolist() == expected
    assert merge_regions(edges, cost, size, 0.2).tolist() == [0, 1, 0]  # by the mean alone


def test_a_self_loop_is_no_border() -> None:
    assert merged([(0, 0), (0, 1), (1, 1)], [9.0, 0.1, 9.0], 0.1 + 2**-20) == [0, 0]


def test_of_equal_costs_the_first_edge_merges_first() -> None:
    # Whichever of 0 and 2 comes first takes 1, and the other one is then too far away.
    near, far = (0.25, 1.0)
    assert merged([(0, 1), (1, 2), (0, 2)], [near, near, far], 0.3) == [0, 0, 1]
    assert merged([(1, 2), (0, 1), (0, 2)], [near, near, far], 0.3) == [0, 1, 1]


@pytest.mark.parametrize("first", [(0, 1), (3, 1)])
def test_joined_borders_keep_the_lower_number(first: tuple[int, int]) -> None:
    # After 0 and 3 have merged, their border to 1 (number 0 and 2) ties with 1 - 2 (number 1) and goes before it.
    pairs = [first, (1, 2), (3 - first[0], 1), (0, 2), (0, 3)]
    assert merged(pairs, [0.5, 0.5, 0.5, 9.0, 0.0], 0.5) == [0, 0, 1, 0]


def test_small_regions_go_across_their_cheapest_border() -> None:
    pairs = [(0, 1), (1, 2), (2, 3)]
    assert merged(pairs, [0.9, 0.8, 0.1], 0, size=[5, 1, 5, 5], min_size=3) == [0, 1, 1, 2]
    assert merged(pairs, [0.9, 0.8, 0.1], 0, size=[5, 1, 5, 5], min_size=1) == [0, 1, 2, 3]


def test_of_the_small_ones_the_cheapest_border_goes_first() -> None:
    # 1 and 2 merge and are large enough; one after the other from the left 0 and 1 would have.
    assert merged([(0, 1), (1, 2)], [0.9, 0.8], 0, size=[3, 1, 2], min_size=3) == [0, 1, 1]


def test_isolated_regions_stay_however_small() -> None:
    assert merged([(1, 3)], [9.0], 0, size=[1, 1, 1, 1, 1], min_size=100) == [0, 1, 2, 1, 3]


def test_sizes_are_in_any_unit() -> None:
    large = 2**40
    assert merged([(0, 1)], [1.0], 0, size=[large, 1], min_size=2) == [0, 0]
    assert merged([(0, 1)], [1.0], 0, size=[large, large], min_size=large) == [0, 1]


def test_costs_are_rounded_to_even_multiples() -> None:
    unit = 2.0**-20
    assert merged([(0, 1)], [0.5 * unit], 0) == [0, 0]
    assert merged([(0, 1)], [0.51 * unit], 0) == [0, 1]
    assert merged([(0, 1)], [1.5 * unit], 1.9 * unit) == [0, 1]


@pytest.mark.parametrize("num_regions", [0, 1, 3])
def test_without_edges(num_regions: int) -> None:
    size = torch.ones(num_regions, dtype=torch.int64)
    labels = merge_regions(edges_of(), torch.empty(0), size, math.inf, 9)
    assert labels.tolist() == list(range(num_regions))
    assert labels.dtype == torch.int64


def test_a_chain_of_many_regions() -> None:
    """Each merge gives the small side's borders away: 200 000 of them take no quadratic time."""
    ends = torch.arange(200_000)
    edges = torch.stack([ends, ends + 1])
    star = torch.stack([torch.zeros_like(ends), ends + 1])
    size = torch.ones(200_001, dtype=torch.int64)
    cost = torch.rand(len(ends), generator=torch.Generator().manual_seed(0))
    for graph in (edges, star):
        labels = merge_regions(graph, cost, size, 0.5)
        assert int(labels.max()) == int((torch.round(cost.double() * 2**20) > 2**19).sum())


def test_any_strides() -> None:
    edges, size = random_regions(0, 30, 100)
    cost = torch.rand(100)
    expected = merge_regions(edges, cost, size, 0.4, 4)
    strided = edges.t().contiguous().t(), cost.repeat_interleave(2)[::2], size.repeat_interleave(3)[::3]
    assert torch.equal(merge_regions(*strided, 0.4, 4), expected)
