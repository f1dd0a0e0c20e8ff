"""The compiled loops over points and pixels against their slow twins, exactly."""

from __future__ import annotations

import pytest
import torch
from effort import few_and_many
from hypothesis import given
from hypothesis import strategies as st
from reference.line_maxima import line_maxima_reference
from reference.outvoted_markers import outvoted_markers_reference
from reference.pair_counts import pair_counts_reference
from reference.project import project_reference
from reference.propagate_labels import propagate_labels_reference
from reference.segment_graphs import segment_graphs_reference
from reference.splat_depth import splat_depth_reference
from reference.ultrametric_contours import ultrametric_contours_reference
from reference.window_overlaps import window_overlaps_reference
from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.graph import CsrAdjacency
from torchjoint.config import ImageGraphConfig, ImageSegmentsConfig
from torchjoint.images.contours import smooth
from torchjoint.images.pixel_graph import grid_edges, pixel_weights, segment_image
from torchjoint.ops.internal import line_maxima, outvoted_markers, pair_counts, segment_graphs, window_overlaps

SEEDS = st.integers(0, 2**32 - 1)


def assert_same(got: tuple[Tensor, ...], expected: tuple[Tensor, ...]) -> None:
    for one, other in zip(got, expected, strict=True):
        assert one.dtype == other.dtype
        assert torch.equal(one, other)


def integers(generator: torch.Generator, low: int, high: int, *shape: int) -> Tensor:
    return torch.randint(low, high, shape, generator=generator)


@given(seed=SEEDS, count=st.integers(0, 60), margin=st.sampled_from([0.0, 2.0, 6.4]))
def test_project(seed: int, count: int, margin: float) -> None:
    generator = torch.Generator().manual_seed(seed)
    points = torch.randn(count, 3, generator=generator) * torch.tensor([1.0, 1.0, 3.0])
    points[::7] = torch.nan
    rotation, _ = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = rotation, torch.randn(3, generator=generator, dtype=torch.float64)
    intrinsics = torch.tensor([[50.3, 0, 31.5], [0, 48.7, 23.5], [0, 0, 1]], dtype=torch.float64)
    arguments = (points, pose, intrinsics, 0.1, 4.0, 48, 64, margin)
    assert_same(ops.project(*arguments), project_reference(*arguments))


@given(seed=SEEDS, count=st.integers(0, 30), height=st.integers(1, 12), width=st.integers(1, 12))
def test_splat_depth(seed: int, count: int, height: int, width: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    row, column = integers(generator, 0, height, count), integers(generator, 0, width, count)
    depth, reach = torch.rand(count, generator=generator), integers(generator, 0, 5, count)
    reach[:1] = 2**31 - 2
    arguments = (row, column, depth, reach, height, width)
    assert_same((ops.splat_depth(*arguments),), (splat_depth_reference(*arguments),))


def visible_edges(generator: torch.Generator, num_nodes: int, height: int, width: int) -> tuple[Tensor, ...]:
    """A graph, and the pixels of those of its nodes that an image sees."""
    edges = CsrAdjacency.of(integers(generator, 0, num_nodes, 2, 4 * num_nodes), num_nodes)
    point = torch.randperm(num_nodes, generator=generator)[: int(integers(generator, 0, num_nodes + 1, 1))]
    row, column = integers(generator, 0, height, len(point)), integers(generator, 0, width, len(point))
    return *edges, point, row, column


@given(seed=SEEDS, num_nodes=st.integers(1, 25), window=st.sampled_from([1, 3, 5, 31]), num_labels=st.integers(1, 9))
def test_window_overlaps(seed: int, num_nodes: int, window: int, num_labels: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    height, width = integers(generator, 1, 12, 2).tolist()
    labels = integers(generator, -1, num_labels, height, width).int()
    arguments = (*visible_edges(generator, num_nodes, height, width), labels, window)
    assert_same(window_overlaps(*arguments), window_overlaps_reference(*arguments))


@given(seed=SEEDS, num_nodes=st.integers(1, 25), height=st.integers(1, 40), width=st.integers(1, 40))
def test_line_maxima(seed: int, num_nodes: int, height: int, width: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    image = integers(generator, 0, 256, height, width).byte()
    arguments = (*visible_edges(generator, num_nodes, height, width), image)
    assert_same(line_maxima(*arguments), line_maxima_reference(*arguments))


def test_line_maxima_round_halves_to_even() -> None:
    """From column 0 to 10: at 2.5, 5 and 7.5, so the columns 2, 5 and 8 are read."""
    order, other_end, start = (torch.tensor(values).int() for values in ([0], [1], [0, 1, 1]))
    pixels = torch.tensor([0, 1]), torch.tensor([0, 0]), torch.tensor([0, 10])
    for column in range(11):
        image = torch.zeros(1, 11, dtype=torch.uint8)
        image[0, column] = 9
        _, maximum = line_maxima(order, other_end, start, *pixels, image)
        assert maximum.item() == 9 * (column in (0, 2, 5, 8, 10))


@few_and_many(
    60,
    300,
    seed=SEEDS,
    count=st.integers(0, 50),
    num_labels=st.integers(1, 5),
    spread=st.sampled_from([0.0, 1.0, 6.0, 300.0, 1e30]),
    radius=st.sampled_from([1e-9, 0.5, 2.0, 3.0, 100.0]),
    on_grid=st.booleans(),
)
def test_pair_counts(seed: int, count: int, num_labels: int, spread: float, radius: float, on_grid: bool) -> None:
    generator = torch.Generator().manual_seed(seed)
    position = (torch.rand(2, count, generator=generator) - 0.3) * spread
    u, v = position.round() if on_grid else position  # on a grid, distances of exactly the radius occur
    pixel, segment = integers(generator, 0, 40, count), integers(generator, -1, num_labels, count)
    arguments = (u, v, pixel, segment, integers(generator, 0, num_labels, count), radius)
    assert_same(pair_counts(*arguments), pair_counts_reference(*arguments))


def test_pair_counts_in_a_crowd() -> None:
    """Millions of close pairs, which a list of pairs would need hundreds of megabytes for."""
    count = 40_000
    u = torch.rand(count, generator=torch.Generator().manual_seed(0)) * 20
    label = (u > 10).long()
    group, number = pair_counts(u, torch.zeros(count), torch.arange(count), torch.zeros(count).long(), label, 1.0)
    ordered = u.double().sort().values
    left, right = ordered[ordered <= 10], ordered[ordered > 10]
    expected = (torch.searchsorted(right, left + 1, right=True)).sum()
    assert group.T.tolist() == [[0, 0, 0, 1]]
    assert number.item() == pytest.approx(expected.item(), rel=1e-5)


@st.composite
def images(draw: st.DrawFn) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(draw(SEEDS))
    height, width, num_labels = draw(st.integers(1, 8)), draw(st.integers(1, 8)), draw(st.integers(1, 4))
    labels = integers(generator, -1, num_labels, height, width).int()
    chosen = integers(generator, 0, 2, num_labels).bool()
    colors = torch.rand(3, height, width, generator=generator) * draw(st.sampled_from([0.0, 1.0]))
    return labels, chosen, colors, torch.rand(height, width, generator=generator)


@given(image=images(), boundary_weight=st.sampled_from([0.0, 0.3]))
def test_segment_graphs(image: tuple[Tensor, Tensor, Tensor, Tensor], boundary_weight: float) -> None:
    arguments = (*image, 0.9, boundary_weight)
    assert_same(segment_graphs(*arguments), segment_graphs_reference(*arguments))


def test_a_whole_image_is_one_segment_graph() -> None:
    """The edges and, but for the rounding of torch's square root, the weights are those of the image graph."""
    generator = torch.Generator().manual_seed(0)
    colors, boundary = torch.rand(3, 9, 13, generator=generator), torch.rand(9, 13, generator=generator)
    labels, chosen = torch.zeros(9, 13, dtype=torch.int32), torch.tensor([True])
    pixel, node_ptr, edge_index, edge_ptr, relative = segment_graphs(labels, chosen, colors, boundary, 0.8, 0.3)
    weights = pixel_weights(colors, boundary, ImageGraphConfig(0.0, 0.8, 0.3)).double()
    assert torch.equal(pixel, torch.arange(9 * 13))
    assert torch.equal(edge_index, grid_edges(9, 13))
    assert node_ptr.tolist() == [0, 9 * 13]
    assert edge_ptr.tolist() == [0, edge_index.shape[1]]
    torch.testing.assert_close(relative, weights / weights.mean(), rtol=1e-6, atol=0)


def test_any_strides() -> None:
    generator = torch.Generator().manual_seed(0)
    u, v = torch.rand(30, 2, generator=generator).T * 9
    pixel, segment, label = integers(generator, 0, 3, 30, 3).T
    assert not u.is_contiguous()
    dense = (tensor.contiguous() for tensor in (u, v, pixel, segment, label))
    assert_same(pair_counts(u, v, pixel, segment, label, 2.0), pair_counts(*dense, 2.0))
    labels, colors = integers(generator, 0, 2, 8, 5).int().T, torch.rand(5, 8, 3, generator=generator).permute(2, 0, 1)
    chosen, boundary = torch.tensor([True, True]), torch.rand(8, 5, generator=generator).T
    dense = (tensor.contiguous() for tensor in (labels, chosen, colors, boundary))
    assert_same(segment_graphs(labels, chosen, colors, boundary, 1.0, 0.5), segment_graphs(*dense, 1.0, 0.5))


@few_and_many(
    50, 200, seed=SEEDS, height=st.integers(0, 12), width=st.integers(0, 12), levels=st.sampled_from([1, 2, 5, 1000])
)
def test_ultrametric_contours(seed: int, height: int, width: int, levels: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    boundary, relief = torch.randint(0, levels + 1, (2, height, width), generator=generator) / levels
    arguments = (boundary, relief)
    assert_same((ops.ultrametric_contours(*arguments),), (ultrametric_contours_reference(*arguments),))


def test_ultrametric_contours_by_hand() -> None:
    """A weak line within a region vanishes before the strong one around it, however strong a part of it is."""
    boundary = torch.zeros(1, 9)
    boundary[0, [2, 5]] = torch.tensor([0.25, 0.75])
    contours = ops.ultrametric_contours(boundary, boundary)
    # A top's lower neighbours are equal: it goes with the left one, and the line lies to its right.
    assert contours[0].tolist() == pytest.approx([0, 0, 0.25, 0.25, 0, 0.75, 0.75, 0, 0], abs=1e-5)
    gap = torch.zeros(5, 6)
    gap[:, 2] = 1.0
    gap[2, 2] = 0.5  # where one could step through: the weakest pixel is no more than a share of the line
    contours = ops.ultrametric_contours(gap, gap)
    # 5 pairs across, 4 + 4 aslant; the gap's pixel has one of each.
    assert contours.unique().tolist() == pytest.approx([0, (10 + 3 * 0.5) / 13], abs=1e-5)
    assert (contours > 0).sum() == 10


def test_gaps_are_closed() -> None:
    """A square's outline with gaps: steps over no boundary lead out of it, and over no closed contour do they."""
    outline = torch.zeros(40, 50)
    outline[8:32, [10, 36]] = 1.0
    outline[[8, 31], 10:37] = 1.0
    outline[18:21, 10] = outline[31, 20:23] = 0.0
    relief = smooth(outline[None, None], 2.0)[0, 0]
    closed = ops.ultrametric_contours(outline, relief)
    inside, outside = (20, 25), (3, 3)
    for boundary, leaks in ((outline, True), (closed, False)):
        passable = (boundary < 0.5).float().expand(3, -1, -1)
        settings = ImageGraphConfig(smoothing=0), ImageSegmentsConfig(scale=1e-9, min_size=0)
        labels = segment_image(passable, torch.zeros(40, 50), *settings)
        assert (labels[inside] == labels[outside]) == leaks


@few_and_many(
    50,
    200,
    seed=SEEDS,
    height=st.integers(0, 12),
    width=st.integers(0, 12),
    levels=st.sampled_from([1, 3, 1000]),
    weights=st.sampled_from([(0.0, 0.0), (3.0, 0.0), (0.0, 2.5), (100.0, 50.0), (1000.0, 1000.0)]),
    min_markers=st.sampled_from([1, 2, 4]),
    num_groups=st.sampled_from([0, 1, 2, 3]),
)
def test_spread_labels(
    seed: int, height: int, width: int, levels: int, weights: tuple[float, float], min_markers: int, num_groups: int
) -> None:
    """If groups ascend, the groups of the result are what the groups of the markers give."""
    generator = torch.Generator().manual_seed(seed)
    markers = integers(generator, -20, 4, height, width).clamp(min=-1).int()
    image = torch.randint(0, levels + 1, (4, height, width), generator=generator) / levels
    groups = integers(generator, 0, num_groups, 5).sort().values.int() if num_groups else None
    arguments = (image[:3], image[3], *weights, min_markers)
    labels = ops.propagate_labels(markers, *arguments, groups)
    assert_same((labels,), (propagate_labels_reference(markers, *arguments, groups),))
    if groups is not None:
        of_groups = torch.where(markers < 0, -1, groups[markers.clamp(min=0).long()])
        coarse = torch.where(labels < 0, -1, groups[labels.clamp(min=0).long()])
        assert_same((coarse,), (ops.propagate_labels(of_groups, *arguments),))


def test_spread_labels_by_hand() -> None:
    """Half way without an edge, the lower label in the middle; at the edge, with one; around it, if that is cheaper."""
    markers = torch.full((1, 7), -1, dtype=torch.int32)
    markers[0, 0], markers[0, 6] = 9, 4
    plain, edge = torch.zeros(3, 1, 7), torch.zeros(3, 1, 7)
    edge[:, 0, 5:] = 1.0
    assert ops.propagate_labels(markers, plain, plain[0], 5.0, 5.0).tolist() == [[9, 9, 9, 4, 4, 4, 4]]
    assert ops.propagate_labels(markers, edge, plain[0], 5.0, 5.0).tolist() == [[9, 9, 9, 9, 9, 4, 4]]
    wall = torch.zeros(3, 5)
    wall[:2, 1:3] = 1.0  # two pixels wide, and open below
    markers = torch.full((3, 5), -1, dtype=torch.int32)
    markers[0, 0], markers[0, 4] = 1, 2
    labels = ops.propagate_labels(markers, torch.zeros(3, 3, 5), wall, 0.0, 100.0)
    assert labels.tolist() == [[1, 1, 2, 2, 2], [1, 1, 2, 2, 2], [1, 1, 1, 2, 2]]


def test_parts_with_few_markers_by_hand() -> None:
    """Parts with one marker are overruled by those with two, unless none has enough; a diagonal connects two."""
    markers = torch.full((3, 7), -1, dtype=torch.int32)
    markers[0, 0], markers[1, 0], markers[1, 3], markers[1, 6] = 4, 4, 2, 4
    image = (torch.zeros(3, 3, 7), torch.zeros(3, 7), 1.0, 1.0)
    assert ops.propagate_labels(markers, *image)[1].tolist() == [4, 4, 2, 2, 2, 4, 4]
    assert (ops.propagate_labels(markers, *image, 2) == 4).all()
    assert torch.equal(ops.propagate_labels(markers, *image, 3), ops.propagate_labels(markers, *image))
    markers[0, 4] = 2
    assert ops.propagate_labels(markers, *image, 2)[1].tolist() == [4, 4, 2, 2, 2, 2, 2]


@given(
    seed=SEEDS,
    height=st.integers(0, 9),
    width=st.integers(0, 12),
    share=st.sampled_from([0.05, 0.3, 1.0]),
    levels=st.sampled_from([1, 3, 1000]),
    num_voters=st.sampled_from([1, 4, 12]),
    near=st.sampled_from([0.0, 1.0, 3.0]),
)
def test_outvoted_markers(
    seed: int, height: int, width: int, share: float, levels: int, num_voters: int, near: float
) -> None:
    """Few shades make many distances equal."""
    generator = torch.Generator().manual_seed(seed)
    markers = integers(generator, 0, 3, height, width).int()
    markers[torch.rand(height, width, generator=generator) >= share] = -1
    colors = torch.randint(0, levels + 1, (3, height, width), generator=generator) / levels
    arguments = (markers, colors, 8.0, num_voters, near)
    assert_same((outvoted_markers(*arguments),), (outvoted_markers_reference(*arguments),))


def test_spread_labels_of_nothing() -> None:
    markers = torch.full((3, 4), -1, dtype=torch.int32)
    assert torch.equal(ops.propagate_labels(markers, torch.rand(3, 3, 4), torch.rand(3, 4), 1.0, 1.0), markers)
