"""Step 6, regions: how well images confirm segments of the points, by hand."""

import pytest
import torch
from torchjoint_lab.regions.image_support import MIN_POINTS, best_overlaps

from torchjoint.views.observations import Observation
from torchjoint.views.visibility import Visible


def overlaps(point_labels, *observations):
    return best_overlaps(torch.tensor(point_labels), observations).tolist()


#: Segment 0 has points 0-3, segment 1 has 4-9.
POINTS = [0] * 4 + [1] * 6


def test_the_same_shape_is_1(seen):
    assert overlaps(POINTS, seen(range(10), [7] * 4 + [3] * 6)) == [1, 1]


def test_intersection_over_union_in_points(seen):
    # The image's label 5 has segment 0 and two points of 1: 4 / 6. Its label 2 has four points of 1's six: 4 / 6.
    assert overlaps(POINTS, seen(range(10), [5] * 6 + [2] * 4)) == pytest.approx([4 / 6, 4 / 6])
    # Of segment 1, label 5 has three points, 3 / (6 + 7 - 3), and label 2 three, 3 / 6: the better one counts.
    assert overlaps(POINTS, seen(range(10), [5] * 7 + [2] * 3)) == pytest.approx([4 / 7, 3 / 6])


def test_hidden_points_count_for_nothing(seen):
    assert overlaps(POINTS, seen([1, 2, 3, 4, 5, 6], [0] * 3 + [1] * 3)) == [1, 1]


def test_of_several_views_the_best_counts(seen):
    good_for_0, good_for_1 = seen(range(10), [0] * 4 + [1, 1, 1, 2, 2, 2]), seen(range(10), [0] * 2 + [1] * 8)
    assert overlaps(POINTS, good_for_0) == pytest.approx([1, 3 / 6])
    assert overlaps(POINTS, good_for_1) == pytest.approx([2 / 4, 6 / 8])
    assert overlaps(POINTS, good_for_0, good_for_1) == pytest.approx([1, 6 / 8])
    assert overlaps(POINTS, good_for_1, good_for_0) == overlaps(POINTS, good_for_0, good_for_1)


def test_a_few_points_are_no_witness(seen):
    assert MIN_POINTS == 3
    assert overlaps(POINTS, seen([0, 1, 4, 5, 6], [0, 0, 1, 1, 1])) == [0, 1]
    assert overlaps(POINTS, seen([0, 1], [0, 0]), seen([2, 3], [0, 0])) == [0, 0]  # nor are several such views


def test_pixels_without_a_label_are_left_out(seen):
    assert overlaps(POINTS, seen(range(10), [-1] + [4] * 3 + [-1] * 3 + [0] * 3)) == [1, 1]
    assert overlaps(POINTS, seen(range(10), [-1, -1, 4, 4] + [0] * 6)) == [0, 1]
    assert overlaps(POINTS, seen(range(10), [-1] * 10)) == [0, 0]


def test_without_witnesses(seen):
    assert overlaps(POINTS) == [0, 0]
    assert overlaps(POINTS, seen([], [0])) == [0, 0]
    assert best_overlaps(torch.tensor(POINTS), ()).dtype == torch.float32


def test_a_point_is_looked_up_where_it_is_seen():
    """Rows and columns are not mixed up, and points come in any number, not as they are numbered."""
    visible = Visible(
        torch.tensor([2, 4, 5, 6, 8]), torch.tensor([0, 1, 1, 1, 0]), torch.tensor([1, 0, 1, 2, 1]),
        torch.zeros(5), torch.zeros(5), torch.ones(5),
    )  # fmt: skip
    labels = torch.tensor([[9, 0, 9], [1, 1, 1]], dtype=torch.int32)
    observation = Observation(
        "", labels, visible, torch.eye(3), torch.eye(4), torch.zeros(3, 2, 3).byte(), torch.zeros(2, 3).byte()
    )
    assert overlaps([0, 0, 0, 0, 1, 1, 1, 1, 0, 0], observation) == [0, 1]


def test_threads_and_the_order_of_views_change_nothing(seen, set_threads):
    generator = torch.Generator().manual_seed(0)
    point_labels = torch.randint(20, (500,), generator=generator)
    views = []
    for _ in range(7):
        point = torch.randperm(500, generator=generator)[:300].sort().values
        views.append(seen(point.tolist(), torch.randint(-1, 9, (300,), generator=generator).tolist()))
    expected = best_overlaps(point_labels, views)
    assert (expected > 0).all()
    for count in (1, 2, 4):
        set_threads(count)
        assert torch.equal(best_overlaps(point_labels, views[::-1]), expected)
