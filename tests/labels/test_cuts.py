import itertools
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.config import ImageGraphConfig, PaperConfig
from torchjoint.images.pixel_graph import grid_edges
from torchjoint.labels import cuts as segment_cuts
from torchjoint.labels import cuts as segment_merging
from torchjoint.labels.cuts import merge_segments, pixel_pairs, split_segments
from torchjoint.labels.joint_ids import joint_labels
from torchjoint.views.visibility import Visible


def visible_at(pixels):
    rows, columns = torch.tensor(pixels).T if pixels else torch.zeros(2, 0, dtype=torch.int64)
    count = len(pixels)
    return Visible(torch.arange(count), rows, columns, columns.float(), rows.float(), torch.ones(count))


def groups(pixels, segments, point_labels, radius, width=10):
    pairs = pixel_pairs(visible_at(pixels), torch.tensor(segments), torch.tensor(point_labels), width, radius)
    return [tuple(group) for group in torch.stack(pairs).T.tolist()]


class TestPairs:
    pixels = ((0, 0), (0, 3), (4, 3), (0, 8))  # distances 3, 4, 5 (a triangle), and far off

    def test_eq_7_to_9_by_hand(self):
        # Points 0 and 1 are close, of one 3D label; 1 and 2 of two.
        assert groups(list(self.pixels), [0, 1, 1, 1], [7, 7, 8, 7], 4.0) == [(0, 1, 7, 7, 1), (1, 1, 7, 8, 1)]

    def test_pairs_in_one_segment_or_outside_do_not_count(self):
        assert groups(list(self.pixels), [1, 1, -1, 1], [7, 7, 8, 7], 4.0) == []

    def test_pairs_in_one_pixel_do_not_count(self):
        assert groups([(1, 1), (1, 1), (1, 2)], [0, 0, 0], [3, 4, 4], 1.0) == [(0, 0, 3, 4, 1)]

    def test_no_points(self):
        none = torch.zeros(0, dtype=torch.int64)
        assert pixel_pairs(visible_at([]), none, none, 10, 3.0).num_pairs.numel() == 0


class TestMerge:
    # Two segments, columns 0-1 and 2-3; points on both sides of the border.
    labels = torch.tensor([[0, 0, 1, 1]] * 4, dtype=torch.int32)

    @pytest.fixture(autouse=True)
    def pairs_of_neighbours(self, monkeypatch):
        monkeypatch.setattr(segment_merging, "RADIUS", 1.0)

    def merged(self, point_labels, ratio):
        visible = visible_at([(row, column) for row in range(4) for column in (1, 2)])
        config = PaperConfig(merge_ratio=ratio)
        return merge_segments(self.labels, visible, torch.tensor(point_labels), config)  # 4 pairs across, 6 along

    def test_eq_10_to_12_by_hand(self):
        # n_R = 4 pairs across the border, of which n_int = 3 join equal 3D labels.
        point_labels = [5, 5, 5, 5, 5, 5, 5, 6]
        assert (self.merged(point_labels, 0.75) == 0).all()
        assert torch.equal(self.merged(point_labels, 0.76), self.labels)
        assert torch.equal(self.merged(point_labels, None), self.labels)

    def test_no_pairs_never_merge(self):
        config = PaperConfig(merge_ratio=0.0)
        got = merge_segments(self.labels, visible_at([(0, 0), (0, 3)]), torch.tensor([1, 1]), config)
        assert torch.equal(got, self.labels)

    def test_merging_is_transitive_and_leaves_unlabelled_pixels(self):
        labels = torch.tensor([[0, 1, 2, -1]], dtype=torch.int32)
        visible = visible_at([(0, 0), (0, 1), (0, 2), (0, 3)])
        config = PaperConfig(merge_ratio=1.0)
        got = merge_segments(labels, visible, torch.zeros(4, dtype=torch.int64), config)
        assert got.tolist() == [[0, 0, 0, -1]]
        assert got.dtype == torch.int32


class TestSplit:
    config = PaperConfig(split_min_edges=2)
    graph = ImageGraphConfig(color_weight=1, boundary_weight=0)

    @pytest.fixture(autouse=True)
    def pairs_two_pixels_apart(self, monkeypatch):
        monkeypatch.setattr(segment_cuts, "RADIUS", 2.0)

    def split(self, labels, gray, pixels, point_labels, config=None):
        """Cuts an image of one channel: the difference of two pixels is the weight of their edge."""
        colors = torch.stack([gray, torch.zeros_like(gray), torch.zeros_like(gray)])
        return split_segments(
            labels.int(), colors, torch.zeros_like(gray), visible_at(pixels), torch.tensor(point_labels),
            config or self.config, self.graph,
        )  # fmt: skip

    def edge_image(self, height=4, width=6, border=2):
        """One segment with a strong edge after column `border`."""
        gray = (torch.arange(width) > border).float().expand(height, width)
        return torch.zeros(height, width, dtype=torch.int64), gray

    def test_cuts_along_the_edge_of_the_image(self):
        labels, gray = self.edge_image()
        pixels = [(1, 1), (2, 1), (1, 3), (2, 3)]  # not beside the edge on both sides: the image decides
        got = self.split(labels, gray, pixels, [4, 4, 9, 9])
        assert (got[:, :3] == 0).all()
        assert (got[:, 3:] == 1).all()
        assert got.dtype == torch.int32

    def cheapest_middle(self, gray, sigma_factor=1.0):
        """Of three columns, source left and sink right: the sides of the two middle pixels, by trying all (eq. 14)."""
        edges = [((a // 3, a % 3), (b // 3, b % 3)) for a, b in grid_edges(2, 3).T.tolist()]
        weights = [abs(float(gray[a]) - float(gray[b])) for a, b in edges]
        sigma = sigma_factor * sum(weights) / len(weights)

        def cost(middle):
            side = {(r, c): [0, middle[r], 1][c] for r in (0, 1) for c in (0, 1, 2)}
            return sum(math.exp(-w / sigma) for w, (a, b) in zip(weights, edges, strict=True) if side[a] != side[b])

        return min(itertools.product((0, 1), repeat=2), key=cost)

    @pytest.mark.parametrize("seed", range(12))
    def test_eq_14_by_hand(self, seed):
        """Capacities exp(-w / sigma), sigma the mean weight of the segment and not of the one beside it."""
        gray = torch.rand(2, 6, generator=torch.Generator().manual_seed(seed)) * torch.tensor([1, 1, 1, 9, 9, 9])
        labels = torch.tensor([[0, 0, 0, 1, 1, 1]] * 2)
        config = PaperConfig(split_min_edges=1)
        got = self.split(labels, gray, [(0, 0), (1, 0), (0, 2), (1, 2)], [1, 1, 2, 2], config)
        assert got[:, [0, 2]].tolist() == [[0, 2]] * 2
        assert (got[:, 3:] == 1).all()
        assert tuple((got[:, 1] // 2).tolist()) == self.cheapest_middle(gray)

    def test_eq_14_s_cases_need_the_right_sigma(self):
        """Else the test above would not notice a wrong one."""
        images = [torch.rand(2, 6, generator=torch.Generator().manual_seed(seed)) for seed in range(12)]
        assert len({self.cheapest_middle(gray) for gray in images}) > 2
        for factor in (0.3, 3.0):
            assert any(self.cheapest_middle(gray) != self.cheapest_middle(gray, factor) for gray in images)

    def test_the_gate_counts_external_pairs(self):
        labels, gray = self.edge_image()
        pixels, point_labels = [(1, 1), (1, 3)], [4, 9]  # one external pair
        assert (self.split(labels, gray, pixels, point_labels) == 0).all()
        assert self.split(labels, gray, pixels, point_labels, PaperConfig(split_min_edges=1)).max() == 1

    def test_most_external_pairs_choose_the_labels(self, monkeypatch):
        monkeypatch.setattr(segment_cuts, "RADIUS", 3.0)
        # Three labels in a row of bands; B and C meet more often than A and B. One cut at the most: B | C.
        labels = torch.zeros(4, 9, dtype=torch.int64)
        gray = (torch.arange(9) // 3).float().expand(4, 9)
        pixels = [(0, 2), (0, 3), (1, 5), (2, 5), (3, 5), (1, 6), (2, 6), (3, 6)]
        point_labels = [10, 20, 20, 20, 20, 30, 30, 30]
        config = PaperConfig(split_min_edges=1)
        with monkeypatch.context() as patch:
            patch.setattr(segment_cuts, "MAX_SPLITS", 1)
            got = self.split(labels, gray, pixels, point_labels, config)
        assert (got[:, :6] == 0).all()
        assert (got[:, 6:] == 1).all()
        both = self.split(labels, gray, pixels, point_labels, config)
        assert [both[:, c].unique().numel() for c in (0, 4, 8)] == [1, 1, 1]
        assert both.unique().numel() == 3

    def test_segments_are_cut_independently(self):
        """All at once is the same partition as one by one."""
        generator = torch.Generator().manual_seed(3)
        labels = (torch.arange(20)[:, None] // 10 * 2 + torch.arange(30)[None] // 15).expand(20, 30).contiguous()
        gray = torch.rand(20, 30, generator=generator)
        pixels = [(row, column) for row in range(1, 20, 2) for column in range(1, 30, 2)]
        point_labels = torch.randint(0, 3, (len(pixels),), generator=generator).tolist()
        together = self.split(labels, gray, pixels, point_labels)
        for segment in range(4):
            alone = torch.where(labels == segment, 0, -1)
            single = self.split(alone, gray, pixels, point_labels)
            inside = labels == segment
            assert same_partition(together[inside], single[inside])

    def test_points_in_one_pixel_cannot_be_cut_apart(self):
        labels, gray = self.edge_image()
        got = self.split(labels, gray, [(1, 1), (1, 1), (1, 1)], [4, 9, 9], PaperConfig(split_min_edges=1))
        assert (got == 0).all()

    def test_flat_segments_and_unlabelled_pixels(self):
        labels = torch.tensor([[0, 0, 0, 0, -1, -1]])
        gray = torch.zeros(1, 6)  # sigma = 0
        pixels = [(0, 0), (0, 2), (0, 4), (0, 5)]
        got = self.split(labels, gray, pixels, [1, 2, 1, 2], PaperConfig(split_min_edges=1))
        assert got[0, 4:].tolist() == [-1, -1]
        assert got[0, 0] != got[0, 2]


class TestJointLabels:
    def test_mode_ties_and_empty_segments(self):
        labels = torch.tensor([[0, 0, 1, 1, 2, -1]], dtype=torch.int32)
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
            torch.tensor([[0, 1]]).int(), visible_at([(0, 0), (0, 1)]), torch.tensor([5, 5]), torch.ones(6).long(), 6
        )
        assert got.tolist() == [[5, 5]]

    def test_no_points_at_all(self):
        got, free = joint_labels(
            torch.tensor([[1, 0], [2, 2]]).int(), visible_at([]), torch.zeros(0).long(), torch.tensor([4]), 1
        )
        assert got.tolist() == [[1, 2], [3, 3]]  # numbered by first appearance
        assert free == 4

    @given(st.data())
    def test_against_a_loop(self, data):
        height, width, num_labels = 4, 5, 4
        flat = data.draw(st.lists(st.integers(-1, 3), min_size=20, max_size=20))
        labels = torch.tensor(flat, dtype=torch.int32).view(height, width)
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
