import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.config import RefinementConfig
from torchjoint.image_graph import grid_edges
from torchjoint.joint_labels import joint_labels
from torchjoint.refinement import merge_segments, pixel_pairs, split_segments
from torchjoint.visibility import Visible


def visible_at(pixels):
    rows, columns = torch.tensor(pixels).T if pixels else torch.zeros(2, 0, dtype=torch.int64)
    count = len(pixels)
    return Visible(torch.arange(count), rows, columns, columns.float(), rows.float(), torch.ones(count))


class TestPairs:
    def test_eq_7_to_9_by_hand(self):
        visible = visible_at([(0, 0), (0, 3), (4, 3), (0, 8)])  # distances 3, 4, 5 (a triangle), and far off
        pairs = pixel_pairs(visible, torch.tensor([7, 7, 8, 7]), radius=4.0)
        found = {
            (*sorted((a, b)), same)
            for a, b, same in zip(pairs.first.tolist(), pairs.second.tolist(), pairs.internal.tolist(), strict=True)
        }
        assert found == {(0, 1, True), (1, 2, False)}

    def test_no_points(self):
        assert pixel_pairs(visible_at([]), torch.zeros(0, dtype=torch.int64), 3.0).first.numel() == 0


class TestMerge:
    # Two segments, columns 0-1 and 2-3; points on both sides of the border.
    labels = torch.tensor([[0, 0, 1, 1]] * 4)

    def merged(self, point_labels, ratio, labels=None):
        pixels = [(row, column) for row in range(4) for column in (1, 2)]
        visible = visible_at(pixels)
        pairs = pixel_pairs(visible, torch.tensor(point_labels), radius=1.0)  # 4 pairs across, 6 along
        return merge_segments(self.labels if labels is None else labels, visible, pairs, ratio)

    def test_eq_10_to_12_by_hand(self):
        # n_R = 4 pairs across the border, of which n_int = 3 join equal 3D labels.
        point_labels = [5, 5, 5, 5, 5, 5, 5, 6]
        assert (self.merged(point_labels, 0.75) == 0).all()
        assert torch.equal(self.merged(point_labels, 0.76), self.labels)

    def test_no_pairs_never_merge(self):
        visible = visible_at([(0, 0), (0, 3)])
        pairs = pixel_pairs(visible, torch.tensor([1, 1]), radius=1.0)
        assert torch.equal(merge_segments(self.labels, visible, pairs, 0.0), self.labels)

    def test_merging_is_transitive_and_leaves_unlabelled_pixels(self):
        labels = torch.tensor([[0, 1, 2, -1]])
        visible = visible_at([(0, 0), (0, 1), (0, 2), (0, 3)])
        pairs = pixel_pairs(visible, torch.zeros(4, dtype=torch.int64), radius=1.0)
        assert merge_segments(labels, visible, pairs, 1.0).tolist() == [[0, 0, 0, -1]]


class TestSplit:
    config = RefinementConfig(radius=2.0, split_min_edges=2)

    def split(self, labels, weights, pixels, point_labels, config=None):
        visible, point_labels = visible_at(pixels), torch.tensor(point_labels)
        pairs = pixel_pairs(visible, point_labels, 2.0)
        return split_segments(labels, weights, visible, point_labels, pairs, config or self.config)

    def edge_image(self, height=4, width=6, border=2):
        """One segment with a strong edge after column `border`, and its weights."""
        edges = grid_edges(height, width)
        crosses = (edges[0] % width <= border) != (edges[1] % width <= border)
        return torch.zeros(height, width, dtype=torch.int64), torch.where(crosses, 1.0, 0.01)

    def test_cuts_along_the_edge_of_the_image(self):
        labels, weights = self.edge_image()
        pixels = [(1, 1), (2, 1), (1, 3), (2, 3)]  # not beside the edge on both sides: the image decides
        got = self.split(labels, weights, pixels, [4, 4, 9, 9])
        assert (got[:, :3] == 0).all()
        assert (got[:, 3:] == 1).all()

    @pytest.mark.parametrize("filler", [0.5, 1.0, 2.0, 3.0, 5.0, 8.0])
    def test_eq_14_by_hand(self, filler):
        """Capacities exp(-w / sigma), sigma the mean weight, decide which of two borders is cut.

        Three columns, source left, sink right. Two edges of weight 0.5 cross the first border and one of weight 0.2
        the second; the rest of both borders has weight `filler`, which also moves sigma.
        """
        weights, of_border = [], {1: [0.5, 0.5, filler, filler], 2: [0.2, filler, filler, filler]}
        waiting = {border: list(values) for border, values in of_border.items()}
        for a, b in grid_edges(2, 3).T.tolist():
            columns = {a % 3, b % 3}
            weights.append(0.01 if len(columns) == 1 else waiting[max(columns)].pop(0))
        sigma = sum(weights) / len(weights)
        first, second = (sum(math.exp(-w / sigma) for w in of_border[border]) for border in (1, 2))
        labels, pixels = torch.zeros(2, 3, dtype=torch.int64), [(0, 0), (1, 0), (0, 2), (1, 2)]
        config = RefinementConfig(radius=2, split_min_edges=1)
        got = self.split(labels, torch.tensor(weights), pixels, [1, 1, 2, 2], config)
        middle = 1 if first < second else 0  # with the sink where the first border is the cheaper cut
        assert got.tolist() == [[0, middle, 1]] * 2

    def test_eq_14_s_cases_are_on_both_sides(self):
        """Else the test above would not notice a wrong sigma."""
        cheaper = set()
        for filler in (0.5, 8.0):
            sigma = (3 * 0.01 + 2 * 0.5 + 0.2 + 5 * filler) / 11
            first = 2 * math.exp(-0.5 / sigma) + 2 * math.exp(-filler / sigma)
            second = math.exp(-0.2 / sigma) + 3 * math.exp(-filler / sigma)
            cheaper.add(first < second)
        assert cheaper == {True, False}

    def test_the_gate_counts_external_pairs(self):
        labels, weights = self.edge_image()
        pixels, point_labels = [(1, 1), (1, 3)], [4, 9]  # one external pair
        assert (self.split(labels, weights, pixels, point_labels) == 0).all()
        assert self.split(labels, weights, pixels, point_labels, RefinementConfig(split_min_edges=1)).max() == 1

    def test_most_external_pairs_choose_the_labels(self):
        # Three labels in a row of bands; B and C meet more often than A and B. One cut at the most: B | C.
        labels = torch.zeros(4, 9, dtype=torch.int64)
        edges = grid_edges(4, 9)
        band = edges % 9 // 3
        weights = torch.where(band[0] != band[1], 1.0, 0.01)
        pixels = [(0, 2), (0, 3), (1, 5), (2, 5), (3, 5), (1, 6), (2, 6), (3, 6)]
        point_labels = [10, 20, 20, 20, 20, 30, 30, 30]
        config = RefinementConfig(split_min_edges=1, max_splits=1)
        got = self.split(labels, weights, pixels, point_labels, config)
        assert (got[:, :6] == 0).all()
        assert (got[:, 6:] == 1).all()
        both = self.split(labels, weights, pixels, point_labels, RefinementConfig(split_min_edges=1))
        assert [both[:, c].unique().numel() for c in (0, 4, 8)] == [1, 1, 1]
        assert both.unique().numel() == 3

    def test_segments_are_cut_independently(self):
        """All at once is the same partition as one by one."""
        generator = torch.Generator().manual_seed(3)
        labels = (torch.arange(20)[:, None] // 10 * 2 + torch.arange(30)[None] // 15).expand(20, 30).contiguous()
        weights = torch.rand(grid_edges(20, 30).shape[1], generator=generator)
        pixels = [(row, column) for row in range(1, 20, 2) for column in range(1, 30, 2)]
        point_labels = torch.randint(0, 3, (len(pixels),), generator=generator).tolist()
        together = self.split(labels, weights, pixels, point_labels)
        for segment in range(4):
            alone = torch.where(labels == segment, 0, -1)
            single = self.split(alone, weights, pixels, point_labels)
            inside = labels == segment
            assert same_partition(together[inside], single[inside])

    def test_points_in_one_pixel_cannot_be_cut_apart(self):
        labels, weights = self.edge_image()
        got = self.split(labels, weights, [(1, 1), (1, 1), (1, 1)], [4, 9, 9], RefinementConfig(split_min_edges=1))
        assert (got == 0).all()

    def test_flat_segments_and_unlabelled_pixels(self):
        labels = torch.tensor([[0, 0, 0, 0, -1, -1]])
        weights = torch.zeros(5)  # sigma = 0
        pixels = [(0, 0), (0, 2), (0, 4), (0, 5)]
        got = self.split(labels, weights, pixels, [1, 2, 1, 2], RefinementConfig(split_min_edges=1))
        assert got[0, 4:].tolist() == [-1, -1]
        assert got[0, 0] != got[0, 2]


class TestJointLabels:
    def test_mode_ties_and_empty_segments(self):
        labels = torch.tensor([[0, 0, 1, 1, 2, -1]])
        visible = visible_at([(0, 0), (0, 1), (0, 2), (0, 3), (0, 5)])
        point_labels = torch.tensor([3, 3, 0, 2, 1])
        sizes = torch.tensor([10, 10, 50, 10])
        # Segment 0: label 3. Segment 1: 0 and 2 tie, 2 is the larger. Segment 2: no points. -1 stays, points or not.
        got, free = joint_labels(labels, visible, point_labels, sizes, 100)
        assert got.tolist() == [[3, 3, 2, 2, 100, -1]]
        assert free == 101
        got, _ = joint_labels(labels, visible, point_labels, torch.tensor([50, 10, 50, 10]), 100)
        assert got.tolist() == [[3, 3, 0, 0, 100, -1]]

    def test_segments_of_one_label_become_one(self):
        got, _ = joint_labels(
            torch.tensor([[0, 1]]), visible_at([(0, 0), (0, 1)]), torch.tensor([5, 5]), torch.ones(6).long(), 6
        )
        assert got.tolist() == [[5, 5]]

    def test_no_points_at_all(self):
        got, free = joint_labels(
            torch.tensor([[1, 0], [2, 2]]), visible_at([]), torch.zeros(0).long(), torch.tensor([4]), 1
        )
        assert got.tolist() == [[1, 2], [3, 3]]  # numbered by first appearance
        assert free == 4

    @given(st.data())
    def test_against_a_loop(self, data):
        height, width, num_labels = 4, 5, 4
        flat = data.draw(st.lists(st.integers(-1, 3), min_size=20, max_size=20))
        labels = torch.tensor(flat).view(height, width)
        hits = data.draw(st.lists(st.tuples(st.integers(0, 19), st.integers(0, num_labels - 1)), max_size=30))
        sizes = data.draw(st.lists(st.integers(1, 5), min_size=num_labels, max_size=num_labels))
        visible = visible_at([(pixel // width, pixel % width) for pixel, _ in hits])
        point_labels = torch.tensor([label for _, label in hits], dtype=torch.int64)
        got, _ = joint_labels(labels, visible, point_labels, torch.tensor(sizes), num_labels)
        for segment in set(flat) - {-1}:
            votes = [label for pixel, label in hits if flat[pixel] == segment]
            here = got.flatten()[torch.tensor(flat) == segment].unique()
            assert here.numel() == 1
            if votes:
                best = max(range(num_labels), key=lambda c: (votes.count(c), sizes[c], -c))
                assert here.item() == best
            else:
                assert here.item() >= num_labels


def same_partition(first, second):
    pairs = torch.unique(torch.stack([first.flatten(), second.flatten()]), dim=1)
    return pairs.shape[1] == first.unique().numel() == second.unique().numel()
