"""region_dendrogram: by hand, against its slow twin exactly, and that it makes the merges of merge_regions."""

from __future__ import annotations

import math

import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st
from reference.region_dendrogram import region_dendrogram_reference
from torch import Tensor

from torchjoint.ops import connected_components, merge_regions, region_dendrogram


def random_regions(seed: int, num_regions: int, num_edges: int, levels: int) -> tuple[Tensor, Tensor]:
    """A multigraph with self loops. With few levels of costs nearly all boundaries tie at one time or another."""
    generator = torch.Generator().manual_seed(seed)
    edges = torch.randint(num_regions, (2, num_edges), generator=generator)
    return edges, torch.randint(levels, (num_edges,), generator=generator) / max(levels - 1, 1)


@few_and_many(
    100,
    300,
    seed=st.integers(0, 2**32 - 1),
    num_regions=st.integers(1, 30),
    num_edges=st.integers(0, 60),
    levels=st.sampled_from([1, 2, 3, 4, 1000]),
    threshold=st.sampled_from([0.0, 0.2, 0.5, 0.75, 1.0, math.inf]),
    counted=st.booleans(),
)
def test_the_twin(seed: int, num_regions: int, num_edges: int, levels: int, threshold: float, counted: bool) -> None:
    edges, cost = random_regions(seed, num_regions, num_edges, levels)
    count = torch.randint(1, 4, (num_edges,), generator=torch.Generator().manual_seed(seed)) if counted else None
    merges, mean = region_dendrogram(edges, cost, num_regions, threshold, count)
    expected, expected_mean = region_dendrogram_reference(edges, cost, num_regions, threshold, count)
    assert torch.equal(merges, expected)
    assert torch.equal(mean, expected_mean)


@few_and_many(
    100,
    300,
    seed=st.integers(0, 2**32 - 1),
    num_regions=st.integers(1, 60),
    levels=st.sampled_from([2, 4, 1000]),
    threshold=st.sampled_from([0.0, 0.2, 0.5, 1.0]),
)
def test_they_are_the_merges_of_merge_regions(seed: int, num_regions: int, levels: int, threshold: float) -> None:
    edges, cost = random_regions(seed, num_regions, 4 * num_regions, levels)
    merges, mean = region_dendrogram(edges, cost, num_regions, threshold)
    groups = connected_components(merges, num_regions)
    assert torch.equal(groups, merge_regions(edges, cost, torch.ones(num_regions, dtype=torch.int64), threshold))
    assert merges.shape[1] == num_regions - int(groups.max()) - 1  # no merge is listed twice
    assert (mean.diff() >= 0).all()
    assert (mean <= threshold).all()
    assert (merges[0] < merges[1]).all()


def test_by_hand() -> None:
    # 2 and 3 merge first. Their two boundaries to 1 then have the mean 0.5. The boundary of 0 and 1 goes last.
    edges = torch.tensor([[3, 1, 1, 0], [2, 2, 3, 1]])
    merges, mean = region_dendrogram(edges, torch.tensor([0.25, 0.375, 0.625, 0.75]), 4, 1.0)
    assert merges.tolist() == [[2, 1, 0], [3, 2, 1]]
    assert mean.tolist() == [0.25, 0.5, 0.75]
    merges, mean = region_dendrogram(edges, torch.tensor([0.25, 0.375, 0.625, 0.75]), 4, 0.5)
    assert merges.tolist() == [[2, 1], [3, 2]]


@pytest.mark.parametrize("num_regions", [0, 1, 3])
def test_without_edges(num_regions: int) -> None:
    merges, mean = region_dendrogram(torch.empty(2, 0, dtype=torch.int64), torch.empty(0), num_regions, math.inf)
    assert merges.shape == (2, 0)
    assert mean.shape == (0,)
    assert mean.dtype == torch.float64


def test_any_strides() -> None:
    edges, cost = random_regions(0, 30, 100, 1000)
    strided = edges.t().contiguous().t(), cost.repeat_interleave(2)[::2]
    for got, expected in zip(
        region_dendrogram(*strided, 30, 0.6), region_dendrogram(edges, cost, 30, 0.6), strict=True
    ):
        assert torch.equal(got, expected)
