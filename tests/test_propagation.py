from collections import Counter

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.config import PropagationConfig
from torchjoint.propagation import disagreement, edge_overlaps, label_windows, window_overlap
from torchjoint.visibility import Visible


def visible_at(pixels, points=None):
    """Points that are seen in given (row, column) pixels."""
    rows, columns = torch.tensor(pixels).T
    point = torch.arange(len(pixels)) if points is None else torch.tensor(points)
    return Visible(point, rows, columns, columns.float(), rows.float(), torch.ones(len(pixels)))


def test_windows_are_clipped_at_the_border():
    labels = torch.tensor([[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    windows = label_windows(labels, visible_at([(1, 1), (0, 0), (2, 1)]), 3)
    assert windows[0].tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 8]
    assert sorted(windows[1].tolist()) == [-1] * 5 + [0, 1, 3, 4]
    assert sorted(windows[2].tolist()) == [-1] * 3 + [3, 4, 5, 6, 7, 8]


def test_window_of_one_pixel():
    labels = torch.tensor([[5, 6]])
    assert label_windows(labels, visible_at([(0, 1)]), 1).tolist() == [[6]]


def test_eq_5_by_hand():
    first = torch.tensor([[1, 1, 1, 2, 2, 2, 2, 3, 3], [1, 1, 1, 1, -1, -1, -1, -1, -1], [7] * 9])
    second = torch.tensor([[1, 2, 2, 2, 4, 4, 4, 4, 3], [1, 1, 2, 2, 2, 2, 2, 2, 2], [8] * 9])
    # min(3,1) + min(4,3) + min(2,1) = 5 of 9; min(4,2) = 2 of the smaller window's 4; nothing in common.
    torch.testing.assert_close(window_overlap(first, second), torch.tensor([5 / 9, 2 / 4, 0.0], dtype=torch.float64))


def test_a_window_without_labels_says_nothing():
    none, some = torch.full((1, 9), -1), torch.ones(1, 9, dtype=torch.int64)
    assert window_overlap(none, some).isnan().all()
    assert window_overlap(none, none).isnan().all()


windows_of_labels = st.lists(st.integers(-1, 4), min_size=9, max_size=9)


@given(st.lists(st.tuples(windows_of_labels, windows_of_labels), min_size=1, max_size=20))
def test_overlap_against_counters(pairs):
    first, second = (torch.tensor([pair[side] for pair in pairs]) for side in (0, 1))
    for got, (a, b) in zip(window_overlap(first, second).tolist(), pairs, strict=True):
        counts = [Counter(label for label in window if label >= 0) for window in (a, b)]
        smaller = min(count.total() for count in counts)
        if smaller == 0:
            assert got != got
        else:
            assert got == (counts[0] & counts[1]).total() / smaller


def test_edges_with_an_unseen_end_are_left_out():
    labels = torch.tensor([[0, 0, 1, 1]])
    visible = visible_at([(0, 0), (0, 1), (0, 3)], points=[0, 2, 3])
    edge_index = torch.tensor([[0, 0, 2, 0], [1, 2, 3, 3]])  # point 1 is not seen
    edges, overlaps = edge_overlaps(edge_index, 4, visible, label_windows(labels, visible, 1))
    assert edges.tolist() == [1, 2, 3]
    assert overlaps.tolist() == [1.0, 0.0, 0.0]


def test_eq_6_by_hand():
    views, overlap_sum = torch.tensor([0, 2, 4]), torch.tensor([0.0, 1.5, 0.5], dtype=torch.float64)
    config = PropagationConfig(normalization="all", overlap_threshold=0.4)
    # L = 10: 0.6 + (v * 0.4 - sum o) / 10
    expected = torch.tensor([0.6, 0.6 + (0.8 - 1.5) / 10, 0.6 + (1.6 - 0.5) / 10])
    torch.testing.assert_close(disagreement(views, overlap_sum, 10, config), expected)
    # The paper's form, a mean over images of 1 - o or, where an end is unseen, of 1 - r_o.
    paper = [sum([1 - o for o in seen] + [1 - 0.4] * (10 - len(seen))) / 10 for seen in ([], [0.75, 0.75], [0.125] * 4)]
    torch.testing.assert_close(disagreement(views, overlap_sum, 10, config), torch.tensor(paper))


def test_saturating_eq_6_by_hand():
    views, overlap_sum = torch.tensor([0, 2, 4]), torch.tensor([0.0, 1.5, 0.5], dtype=torch.float64)
    config = PropagationConfig(normalization="saturating", saturation=4, overlap_threshold=0.4)
    expected = torch.tensor([0.6, 0.6 + 0.5 * (0.4 - 0.75), 0.6 + 1.0 * (0.4 - 0.125)])
    torch.testing.assert_close(disagreement(views, overlap_sum, 10, config), expected)


@pytest.mark.parametrize("normalization", ["saturating", "all"])
def test_disagreement_stays_in_0_1(normalization):
    config = PropagationConfig(normalization=normalization)
    views = torch.tensor([5, 5])
    r = disagreement(views, torch.tensor([0.0, 5.0], dtype=torch.float64), 5, config)
    assert r.tolist() == pytest.approx([1.0, 0.0], abs=1e-6)
