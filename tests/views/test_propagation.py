from collections import Counter

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.cloud.graph import CsrAdjacency
from torchjoint.views.propagation import OVERLAP_RESOLUTION, disagreement, edge_contours, edge_overlaps
from torchjoint.views.visibility import Visible


def visible_at(pixels, points=None):
    """Points that are seen in given (row, column) pixels."""
    rows, columns = torch.tensor(pixels).T
    point = torch.arange(len(pixels)) if points is None else torch.tensor(points)
    return Visible(point, rows, columns, columns.float(), rows.float(), torch.ones(len(pixels)))


def overlaps(labels, pixels, edge_index, window, num_points=None):
    """What an image says about edges, in the order of the edges."""
    edges = CsrAdjacency.of(torch.tensor(edge_index).reshape(2, -1), num_points or len(pixels))
    edge, overlap = edge_overlaps(edges, visible_at(pixels), torch.tensor(labels, dtype=torch.int32), window)
    order = torch.argsort(edge)
    return edge[order].tolist(), overlap[order].tolist()


def rounded(values):
    return [round(value / OVERLAP_RESOLUTION) * OVERLAP_RESOLUTION for value in values]


def test_eq_5_by_hand():
    labels = [[1, 1, 1, 1, 2, 2], [2, 2, 2, 2, 4, 4], [2, 3, 3, 4, 4, 3]]
    # Around (1, 1): three 1, four 2, two 3. Around (1, 4): 1, three 2, four 4, one 3. 1 + 3 + 1 of 9.
    # Around (0, 0), clipped to four pixels: two 1, two 2. With the first: 2 + 2 of 4; with the second: 1 + 2 of 4.
    assert overlaps(labels, [(1, 1), (1, 4), (0, 0)], [[0, 0, 1], [1, 2, 2]], 3) == (
        [0, 1, 2],
        rounded([5 / 9, 4 / 4, 3 / 4]),
    )


def test_contours_by_hand():
    """The points 0, 2 and 3 are in the columns 0, 1 and 4; the image does not see point 1."""
    boundary = torch.tensor([[0, 51, 0, 9, 0], [0, 70, 70, 70, 0]], dtype=torch.uint8)
    edges = CsrAdjacency.of(torch.tensor([[0, 0, 2, 0, 1], [2, 3, 3, 1, 3]]), 4)
    edge, strength = edge_contours(edges, visible_at([(0, 0), (0, 1), (0, 4)], [0, 2, 3]), boundary)
    assert dict(zip(edge.tolist(), strength.tolist(), strict=True)) == {0: 51, 1: 51, 2: 51}
    edge, strength = edge_contours(edges, visible_at([(1, 0), (0, 2), (0, 4)], [0, 2, 3]), boundary)
    assert dict(zip(edge.tolist(), strength.tolist(), strict=True)) == {0: 51, 1: 70, 2: 9}
    assert not edge_contours(edges, visible_at([(1, 1)], [1]), boundary)[0].numel()


def test_window_of_one_pixel():
    assert overlaps([[5, 6, 5]], [(0, 0), (0, 1), (0, 2)], [[0, 0], [1, 2]], 1) == ([0, 1], [0.0, 1.0])


def test_pixels_without_a_label_are_left_out():
    # Around column 1: two 0; around column 4: one 0, one 1. Around column 7 there is nothing.
    labels = [[0, 0, -1, -1, 1, 0, -1, -1, -1]]
    edges = [[0, 0, 1], [1, 2, 2]]
    assert overlaps(labels, [(0, 1), (0, 4), (0, 7)], edges, 3) == ([0], [0.5])


@given(st.data(), st.sampled_from([1, 3, 5]))
def test_overlap_against_counters(data, window):
    labels = data.draw(st.lists(st.lists(st.integers(-1, 4), min_size=7, max_size=7), min_size=5, max_size=5))
    pixels = data.draw(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 6)), min_size=2, max_size=6))
    pairs = [(i, j) for i in range(len(pixels)) for j in range(i)]
    expected = {}
    for edge, (i, j) in enumerate(pairs):
        counts = []
        for row, column in (pixels[i], pixels[j]):
            reach = window // 2
            rows = labels[max(row - reach, 0) : row + reach + 1]
            around = [label for line in rows for label in line[max(column - reach, 0) : column + reach + 1]]
            counts.append(Counter(label for label in around if label >= 0))
        if all(counts):
            expected[edge] = (counts[0] & counts[1]).total() / min(count.total() for count in counts)
    got = overlaps(labels, pixels, list(zip(*pairs, strict=True)), window)
    assert got == (list(expected), rounded(expected.values()))


def test_edges_with_an_unseen_end_are_left_out():
    labels = torch.tensor([[0, 0, 1, 1]], dtype=torch.int32)
    visible = visible_at([(0, 0), (0, 1), (0, 3)], points=[0, 2, 3])
    edges = CsrAdjacency.of(torch.tensor([[0, 0, 2, 0], [1, 2, 3, 3]]), 4)  # point 1 is not seen
    edge, overlap = edge_overlaps(edges, visible, labels, 1)
    assert dict(zip(edge.tolist(), overlap.tolist(), strict=True)) == {1: 1.0, 2: 0.0, 3: 0.0}


def test_eq_6_by_hand():
    views, overlap_sum = torch.tensor([0, 2, 4]), torch.tensor([0.0, 1.5, 0.5], dtype=torch.float64)
    # L = 10: 0.6 + (v * 0.4 - sum o) / 10
    expected = torch.tensor([0.6, 0.6 + (0.8 - 1.5) / 10, 0.6 + (1.6 - 0.5) / 10])
    torch.testing.assert_close(disagreement(views, overlap_sum, 0.4, 10), expected)
    # The paper's form, a mean over images of 1 - o or, where an end is unseen, of 1 - r_o.
    paper = [sum([1 - o for o in seen] + [1 - 0.4] * (10 - len(seen))) / 10 for seen in ([], [0.75, 0.75], [0.125] * 4)]
    torch.testing.assert_close(disagreement(views, overlap_sum, 0.4, 10), torch.tensor(paper))


def test_saturating_eq_6_by_hand():
    views, overlap_sum = torch.tensor([0, 2, 4]), torch.tensor([0.0, 1.5, 0.5], dtype=torch.float64)
    expected = torch.tensor([0.6, 1 - 0.75, 1 - 0.125])
    torch.testing.assert_close(disagreement(views, overlap_sum, 0.4), expected)


@pytest.mark.parametrize("num_images", [None, 5])
def test_disagreement_stays_in_0_1(num_images):
    views = torch.tensor([5, 5])
    r = disagreement(views, torch.tensor([0.0, 5.0], dtype=torch.float64), 0.7, num_images)
    assert r.tolist() == pytest.approx([1.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("threshold", [0.6, 0.7, 0.8, 0.9])
@pytest.mark.parametrize("num_images", [3, 5, 6, 7])
def test_rounding_does_not_make_it_negative(threshold, num_images):
    views = torch.full((1,), num_images)
    assert disagreement(views, views.double(), threshold, num_images).item() >= 0
