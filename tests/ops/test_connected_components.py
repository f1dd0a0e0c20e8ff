"""connected_components: by hand, against its slow twin, and against SciPy."""

from __future__ import annotations

import torch
from effort import few_and_many
from hypothesis import strategies as st
from reference.connected_components import connected_components_reference
from scipy.sparse import coo_array, csgraph
from torch import Tensor

from torchjoint.ops import connected_components, felzenszwalb


def random_edges(seed: int, num_nodes: int, num_edges: int) -> Tensor:
    """Also self loops and repeated edges; none without nodes."""
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(max(num_nodes, 1), (2, num_edges if num_nodes else 0), generator=generator)


@few_and_many(100, 1000, seed=st.integers(0, 2**32 - 1), num_nodes=st.integers(0, 40), num_edges=st.integers(0, 60))
def test_the_twin(seed: int, num_nodes: int, num_edges: int) -> None:
    edges = random_edges(seed, num_nodes, num_edges)
    assert torch.equal(connected_components(edges, num_nodes), connected_components_reference(edges, num_nodes))


def test_scipy_numbers_them_alike() -> None:
    for seed, num_nodes, num_edges in ((0, 1, 0), (1, 1000, 300), (2, 1000, 700), (3, 5000, 4000)):
        edges = random_edges(seed, num_nodes, num_edges)
        graph = coo_array((torch.ones(num_edges).numpy(), tuple(edges.numpy())), shape=(num_nodes, num_nodes))
        expected = csgraph.connected_components(graph, directed=False)[1]
        assert connected_components(edges, num_nodes).tolist() == expected.tolist()


def test_they_are_the_segments_of_edges_that_weigh_nothing() -> None:
    edges = random_edges(0, 3000, 2000)
    segments = felzenszwalb(edges, torch.zeros(2000), 3000, scale=1.0)
    assert torch.equal(connected_components(edges, 3000), segments)


def test_by_hand() -> None:
    edges = torch.tensor([[4, 2, 5, 5], [1, 4, 5, 0]])
    assert connected_components(edges, 6).tolist() == [0, 1, 1, 2, 1, 0]
    assert connected_components(edges[:, :0], 3).tolist() == [0, 1, 2]
    assert connected_components(edges[:, :0], 0).tolist() == []


def test_any_strides() -> None:
    edges = random_edges(0, 50, 40)
    strided = edges.t().contiguous().t()
    assert not strided.is_contiguous()
    assert torch.equal(connected_components(strided, 50), connected_components(edges, 50))


def test_a_chain_in_any_order() -> None:
    """Long paths to the root are the worst for union-find."""
    nodes = torch.arange(1_000_000)
    for order in (nodes, nodes.flip(0), torch.randperm(len(nodes), generator=torch.Generator().manual_seed(0))):
        labels = connected_components(torch.stack([order[:-1], order[1:]]), len(nodes))
        assert labels.max() == 0
