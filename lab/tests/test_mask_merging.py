"""Published ways of merging masks, on lines of points for which the right answer is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import sparse
from torchjoint_lab.benchmark.mask_merging.mask_clustering import _clusters, mask_clustering
from torchjoint_lab.benchmark.mask_merging.sai3d import _affinities, sai3d
from torchjoint_lab.benchmark.mask_merging.sam3d import sam3d
from torchjoint_lab.benchmark.mask_merging.sightings import sightings

from torchjoint.scene.masks import Masks
from torchjoint.views.visibility import Visible


def line(*frames, seen=None):
    """Points 1 m apart, and frames that see each point in a pixel of its own; a letter a mask, "." none."""
    points = torch.zeros(len(frames[0]), 3)
    points[:, 0] = torch.arange(len(frames[0]))
    visible, masks = [], []
    for index, frame in enumerate(frames):
        point = torch.tensor([i for i in range(len(frame)) if seen is None or seen[index][i] != " "])
        row = torch.zeros(len(point), dtype=torch.int64)
        visible.append(Visible(point, row, point, point.float(), row.float(), torch.ones(len(point))))
        labels = torch.tensor([[-1 if letter in ". " else ord(letter) for letter in frame]])
        masks.append(Masks.from_labels(labels))
    return points, visible, masks


def names(labels):
    """The labels as letters, by first appearance."""
    known = {}
    return "".join(known.setdefault(int(label), chr(65 + len(known))) for label in labels)


def by_tens(count):
    return torch.arange(count) // 10


@pytest.mark.parametrize("merge", [sai3d, mask_clustering, sam3d])
def test_perfect_masks_with_shuffled_ids_stay_perfect(merge):
    truth = "A" * 30 + "B" * 20 + "C" * 30
    points, visible, masks = line(truth, truth.translate(str.maketrans("ABC", "CAB")), truth, truth)
    assert names(merge(points, visible, masks, by_tens(80))) == truth


@pytest.mark.parametrize("merge", [sai3d, mask_clustering, sam3d])
def test_without_frames_or_masks_all_points_get_labels(merge):
    points = line("A" * 20)[0]
    assert len(merge(points, [], [], by_tens(20))) == 20
    points, visible, masks = line("." * 20, "." * 20)
    assert len(merge(points, visible, masks, by_tens(20))) == 20
    with pytest.raises(ValueError, match="masks: expected those of 2 frames, got those of 1"):
        merge(points, visible, masks[:1], by_tens(20))


class TestSai3d:
    def test_affinity_is_a_weighted_mean_cosine(self):
        # Frame 0 sees both superpoints whole, in histograms (10, 0) and (6, 4); frame 1 sees half of the second only,
        # with 5 of 10 points in the mask of the first.
        points, visible, masks = line("A" * 16 + "B" * 4, "A" * 15 + "B" * 5, seen=["x" * 20, "x" * 15 + " " * 5])
        seen = sightings(len(points), visible, masks).in_masks()
        affinity, weight = _affinities(by_tens(20).numpy(), 2, seen, np.array([0]), np.array([1]))
        first = 6 / np.hypot(6, 4)
        assert weight[0] == pytest.approx(1 + 0.5)
        assert affinity[0] == pytest.approx((first + 0.5 * 1) / 1.5)

    @pytest.mark.parametrize(("together", "expected"), [(3, "A" * 20), (1, "A" * 10 + "B" * 10)])
    def test_most_views_decide(self, together, expected):
        frames = ["A" * 20] * together + ["A" * 10 + "B" * 10] * (4 - together)
        assert names(sai3d(*line(*frames), by_tens(20), min_points=5)) == expected

    def test_points_without_a_mask_say_nothing(self):
        frames = ["A" * 20] + ["A" * 10 + "." * 10] * 3
        assert names(sai3d(*line(*frames), by_tens(20), min_points=5)) == "A" * 20

    def test_high_affinities_merge_first(self):
        """Affinities of 6/9 to the third superpoint, of 5/9 to the first: in one stage, the first takes all."""
        frames = ["A" * 30] * 2 + ["A" * 20 + "B" * 10] * 3 + ["A" * 10 + "B" * 20] * 4
        points, visible, masks = line(*frames)
        assert names(sai3d(points, visible, masks, by_tens(30), min_points=5)) == "A" * 10 + "B" * 20
        assert names(sai3d(points, visible, masks, by_tens(30), thresholds=(0.5,), min_points=5)) == "A" * 30

    def test_small_regions_join_the_closest_neighbour(self):
        labels = torch.tensor([0] * 30 + [1] * 5 + [2] * 30)
        frames = ["A" * 30 + "B" * 5 + "C" * 30] * 3 + ["A" * 30 + "C" * 35]
        assert names(sai3d(*line(*frames), labels)) == "A" * 30 + "B" * 35
        assert names(sai3d(*line(*frames), labels, min_points=5)) == "A" * 30 + "B" * 5 + "C" * 30


class TestMaskClustering:
    def test_halves_are_one_where_other_views_show_one(self):
        frames = ["A" * 10 + "B" * 10, "A" * 20, "A" * 20, "A" * 20]
        assert names(mask_clustering(*line(*frames))) == "A" * 20

    @pytest.mark.parametrize(("support", "expected"), [(9, "AA"), (8, "AB")])
    def test_nine_of_ten_observers_must_support(self, support, expected):
        """Two masks that 10 frames observe, each with two masks: the first contains both in `support` frames."""
        contained = np.zeros((2, 20), dtype=np.float32)
        contained[0, ::2] = 1
        contained[1, : 2 * support : 2] = 1
        contained[1, 2 * support + 1 :: 2] = 1
        observed = np.ones((2, 10), dtype=bool)
        cluster = _clusters(observed, sparse.csr_array(contained), np.arange(20) // 2, 0.9)
        assert names(cluster) == expected

    def test_a_mask_that_other_frames_split_is_left_out(self):
        frames = ["A" * 20, *["A" * 10 + "B" * 10] * 6]
        assert names(mask_clustering(*line(*frames))) == "A" * 10 + "B" * 10

    def test_frames_that_see_too_little_do_not_count(self):
        """20 frames see 2 of 10 points of the second part, in the mask of the first."""
        whole, part = "A" * 10 + "B" * 10, "A" * 12 + " " * 8
        points, visible, masks = line(*[whole] * 2, *["A" * 20] * 20, seen=["x" * 20] * 2 + [part] * 20)
        assert names(mask_clustering(points, visible, masks)) == "A" * 12 + "B" * 8

    def test_frames_without_a_mask_there_do_not_count(self):
        frames = ["A" * 10 + "B" * 10] * 2 + ["A" * 10 + "." * 10] * 9
        assert names(mask_clustering(*line(*frames))) == "A" * 10 + "B" * 10

    def test_a_mask_that_no_other_frame_confirms_is_left_out(self):
        once, frame = "A" * 20 + "B" * 4, "A" * 20 + " " * 4
        assert names(mask_clustering(*line(once, frame, frame, seen=[once, frame, frame]))) == "A" * 24
        assert names(mask_clustering(*line("A" * 20 + "B" * 4))) == "A" * 20 + "B" * 4

    def test_points_without_a_cluster_take_the_nearest_one(self):
        frames = ["A" * 10 + "." * 4 + "B" * 10] * 3
        assert names(mask_clustering(*line(*frames))) == "A" * 12 + "B" * 12


class TestSam3d:
    def test_groups_that_share_enough_of_the_smaller_one_are_one(self):
        """Views of 20 points that share 10 of them, 2 points a voxel."""
        frames = ["A" * 20 + " " * 10, " " * 10 + "A" * 20]
        points, visible, masks = line(*frames, seen=frames)
        assert names(sam3d(points, visible, masks, by_tens(30))) == "A" * 30
        apart = sam3d(points, visible, masks, by_tens(30), overlap=0.6)
        assert names(apart) == "A" * 20 + "B" * 10

    def test_merging_goes_both_ways(self):
        """The second cloud's one group takes the name of the first half; then the other half takes the group's."""
        frames = ["A" * 10 + "B" * 10, "A" * 20]
        assert names(sam3d(*line(*frames), by_tens(20))) == "A" * 20

    def test_distant_frames_merge_over_those_between(self):
        frames = ["A" * 10 + " " * 20, " " * 4 + "A" * 14 + " " * 12, " " * 12 + "A" * 8 + "B" * 10]
        points, visible, masks = line(*frames, seen=frames)
        assert names(sam3d(points, visible, masks, by_tens(30))) == "A" * 20 + "B" * 10

    def test_the_smaller_group_counts(self):
        """6 points of 30 and of 16: less than .3 of the larger group, more of the smaller one."""
        frames = ["A" * 30 + " " * 10, " " * 24 + "A" * 16]
        points, visible, masks = line(*frames, seen=frames)
        assert names(sam3d(points, visible, masks, by_tens(40))) == "A" * 40

    def test_superpoints_take_their_most_frequent_label(self):
        frames = ["A" * 13 + "B" * 7] * 2
        assert names(sam3d(*line(*frames), by_tens(20))) == "A" * 10 + "B" * 10
