"""felzenszwalb against its slow twin, and against OpenCV and scikit-image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st
from reference.felzenszwalb import felzenszwalb_reference
from skimage.segmentation import felzenszwalb as skimage_felzenszwalb
from torch import Tensor

from torchjoint.ops import felzenszwalb

# Few distinct values, so that ties are common; both zeros, both signs, subnormals, infinities.
TIED_WEIGHTS = st.sampled_from(
    [-0.0, 0.0, 0.25, 0.5, 1.0, 1.0, 2.0, -1.0, -2.5, 1e-45, 3e38, float("inf"), -float("inf")]
)
ANY_WEIGHT = st.floats(-10, 10, width=32)


@st.composite
def graphs(draw: st.DrawFn) -> tuple[Tensor, Tensor, int]:
    """Multigraphs with self loops, repeated edges and isolated nodes; none or one node included."""
    num_nodes = draw(st.integers(0, 24))
    num_edges = draw(st.integers(0, 60)) if num_nodes else 0
    seed = draw(st.integers(0, 2**32 - 1))
    edge_index = torch.randint(num_nodes or 1, (2, num_edges), generator=torch.Generator().manual_seed(seed))
    weights = draw(st.lists(st.one_of(TIED_WEIGHTS, ANY_WEIGHT), min_size=num_edges, max_size=num_edges))
    return edge_index, torch.tensor(weights, dtype=torch.float32), num_nodes


def random_graph(seed: int, num_nodes: int, num_edges: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    edge_index = torch.randint(num_nodes, (2, num_edges), generator=generator)
    return edge_index, torch.randn(num_edges, generator=generator)


@few_and_many(
    150,
    600,
    graph=graphs(),
    scale=st.sampled_from([0, 0.1, 0.5, 1, 2, 7.3, 1e6, float("inf")]),
    min_size=st.integers(0, 12),
)
def test_equals_twin(graph: tuple[Tensor, Tensor, int], scale: float, min_size: int) -> None:
    edge_index, weight, num_nodes = graph
    labels = felzenszwalb(edge_index, weight, num_nodes, scale, min_size)
    assert labels.dtype == torch.int64
    assert torch.equal(labels, felzenszwalb_reference(edge_index, weight, num_nodes, scale, min_size))


def test_equals_twin_on_larger_graphs() -> None:
    for seed in range(300):
        num_nodes = 20 + seed
        edge_index, weight = random_graph(seed, num_nodes, 3 * num_nodes)
        if seed % 2:
            weight = (4 * weight).round() / 4  # ties
        args = (edge_index, weight, num_nodes, 0.5 + seed / 50, seed % 7)
        assert torch.equal(felzenszwalb(*args), felzenszwalb_reference(*args))


#: One of them, with many ties, in every run.
@pytest.mark.parametrize("seed", [pytest.param(seed, marks=[pytest.mark.slow] * (seed != 3)) for seed in range(6)])
def test_equals_twin_where_edges_fill_several_groups(seed: int) -> None:
    """Past 2^15 edges weights are distributed before they are sorted; in a wide range, a narrow one, with many ties."""
    num_nodes = 10_000
    edge_index, weight = random_graph(seed, num_nodes, 4 * num_nodes)
    weight = (weight, weight.exp(), 1 + weight / 1e5, (9 * weight).round(), weight.sign(), weight.clamp(min=0))[seed]
    args = (edge_index, weight, num_nodes, 0.5, 5)
    assert torch.equal(felzenszwalb(*args), felzenszwalb_reference(*args))


def test_float64_is_rounded_to_float32() -> None:
    edge_index, weight = random_graph(0, 500, 2000)
    exact = weight.double() + 1e-12 * torch.arange(2000, dtype=torch.float64)
    expected = felzenszwalb(edge_index, exact.float(), 500, 1.0)
    assert torch.equal(felzenszwalb(edge_index, exact, 500, 1.0), expected)


def test_any_strides() -> None:
    edge_index, weight = random_graph(1, 500, 2000)
    expected = felzenszwalb(edge_index, weight, 500, 1.0, 5)
    columns = edge_index.t().contiguous().t()
    spread = torch.stack([weight, -weight], 1)[:, 0]
    assert not columns.is_contiguous()
    assert not spread.is_contiguous()
    assert torch.equal(felzenszwalb(columns, spread, 500, 1.0, 5), expected)
    flipped = felzenszwalb(edge_index, weight[:1].expand(2000), 500, 1.0)
    assert torch.equal(flipped, felzenszwalb(edge_index, weight[:1].repeat(2000), 500, 1.0))


def test_negative_zero_ties_with_zero() -> None:
    edge_index = torch.tensor([[0, 1, 2], [1, 2, 3]])
    for weight in ([0.0, -0.0, 0.0], [-0.0, 0.0, -0.0]):
        labels = felzenszwalb(edge_index, torch.tensor(weight), 4, 0.0)
        assert labels.tolist() == [0, 0, 0, 0]
    # Were -0.0 sorted before 0.0, the small node 2 would join 3 instead of 1.
    weight = torch.tensor([-1.0, 0.0, -0.0])
    edge_index = torch.tensor([[0, 1, 2], [1, 2, 3]])
    args = (edge_index, weight, 4, 0.0, 2)
    assert torch.equal(felzenszwalb(*args), felzenszwalb_reference(*args))


def test_no_nodes_and_no_edges() -> None:
    none = torch.empty(2, 0, dtype=torch.int64)
    assert felzenszwalb(none, torch.empty(0), 0, 1.0).shape == (0,)
    assert felzenszwalb(none, torch.empty(0), 1, 1.0, 5).tolist() == [0]
    assert felzenszwalb(none, torch.empty(0), 3, 1.0, 5).tolist() == [0, 1, 2]


def test_labels_count_up_by_first_appearance() -> None:
    edge_index, weight = random_graph(2, 3000, 4000)
    labels = felzenszwalb(edge_index, weight.abs(), 3000, 0.3)
    values, first = np.unique(labels.numpy(), return_index=True)
    assert values.tolist() == list(range(len(values)))
    assert (np.diff(first) > 0).all()


def test_min_size_leaves_only_whole_components_smaller() -> None:
    edge_index, weight = random_graph(3, 2000, 3000)
    labels = felzenszwalb(edge_index, weight.abs(), 2000, 0.01, 20)
    connected = felzenszwalb(edge_index, torch.zeros(3000), 2000, 1.0)
    for label in (labels.bincount() < 20).nonzero()[:, 0]:
        (component,) = connected[labels == label].unique().tolist()
        assert torch.equal(labels == label, connected == component)


def test_min_size_may_exceed_every_size() -> None:
    edge_index = torch.tensor([[0, 1], [1, 2]])
    assert felzenszwalb(edge_index, torch.tensor([5.0, 9.0]), 3, 0.0, 2**40).tolist() == [0, 0, 0]


def test_same_result_every_time() -> None:
    edge_index, weight = random_graph(4, 50_000, 200_000)
    weight = (8 * weight).round()
    results = {felzenszwalb(edge_index, weight, 50_000, 3.0, 10).numpy().tobytes() for _ in range(5)}
    assert len(results) == 1


# --- parity with other implementations, on images whose weights have no ties --------------------------------------


def jittered_image(height: int = 60, width: int = 80) -> np.ndarray:
    """Blurred noise [H, W, 3] float32 in 0..255, plus a jitter that makes all weights distinct."""
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.uniform(0, 255, (height, width, 3)), (0, 0), 3)
    image = 255 * (image - image.min()) / np.ptp(image)
    return (image.round() + rng.uniform(-0.4, 0.4, image.shape)).astype(np.float32)


def grid_edges(height: int, width: int, steps: list[tuple[int, int]]) -> Tensor:
    index = torch.arange(height * width).view(height, width)
    parts = []
    for dy, dx in steps:
        rows, ends = slice(max(-dy, 0), height - max(dy, 0)), slice(max(dy, 0), height + min(dy, 0))
        parts.append(torch.stack([index[rows, : width - dx].flatten(), index[ends, dx:].flatten()]))
    return torch.cat(parts, 1)


def colour_distance(image: np.ndarray, edge_index: Tensor) -> Tensor:
    pixels = torch.from_numpy(image).view(-1, 3)
    r, g, b = (pixels[edge_index[0]] - pixels[edge_index[1]]).unbind(1)
    return ((r * r + g * g) + b * b).sqrt()


def first_appearance(labels: np.ndarray) -> list[int]:
    number: dict[int, int] = {}
    return [number.setdefault(label, len(number)) for label in labels.ravel().tolist()]


@pytest.mark.parametrize(("scale", "min_size"), [(10.0, 0), (50.0, 20), (150.0, 50)])
def test_same_partition_as_opencv(scale: float, min_size: int) -> None:
    image = jittered_image()
    height, width = image.shape[:2]
    edge_index = grid_edges(height, width, [(0, 1), (1, 0)])
    labels = felzenszwalb(edge_index, colour_distance(image, edge_index), height * width, scale, min_size)
    theirs = cv2.ximgproc.segmentation.createGraphSegmentation(0.001, scale, min_size).processImage(image)
    assert labels.max() >= 3
    assert labels.tolist() == first_appearance(theirs)


@pytest.mark.parametrize(("scale", "min_size"), [(10.0, 0), (50.0, 20), (150.0, 50)])
def test_same_partition_as_scikit_image(scale: float, min_size: int) -> None:
    image = jittered_image().astype(np.float64) / 255
    height, width = image.shape[:2]
    edge_index = grid_edges(height, width, [(0, 1), (1, 0), (1, 1), (-1, 1)])
    weight = colour_distance(image, edge_index)
    labels = felzenszwalb(edge_index, weight, height * width, scale / 255, min_size)
    theirs = skimage_felzenszwalb(image, scale=scale, sigma=0, min_size=min_size)
    assert labels.max() >= 3
    assert labels.tolist() == first_appearance(theirs)
