"""Step 6, regions: what images say about superpoints, by hand and against a slow twin."""

import pytest
import torch
from torchjoint_lab.regions.superpoints import MIN_POINTS, superpoint_disagreement

from torchjoint.views.propagation import OVERLAP_RESOLUTION

#: Superpoint 0 has points 0-3, superpoint 1 has 4-9, superpoint 2 has 10-12.
SUPERPOINTS = [0] * 4 + [1] * 6 + [2] * 3
#: One edge in superpoint 0, two between 0 and 1 (in either direction), one between 1 and 2.
EDGES = torch.tensor([[0, 3, 5, 9], [1, 4, 2, 10]])
#: The overlap at which an image is neutral.
NEUTRAL = 0.5


def disagreements(*observations, r_o=NEUTRAL, edges=EDGES, superpoints=SUPERPOINTS):
    return superpoint_disagreement(torch.tensor(superpoints), edges, observations, r_o).tolist()


def test_one_segment_on_both_sides_is_0_two_are_1(seen):
    assert disagreements(seen(range(13), [5] * 10 + [8] * 3)) == [0, 0, 0, 1]


def test_overlap_is_of_the_smaller_superpoint(seen):
    # Superpoint 0: labels 1 1 2 2. Superpoint 1: 2 2 2 3 3 3. Common: min(2, 3) = 2, of the smaller one's 4. Superpoint
    # 2: 3 3 4.
    view = seen(range(13), [1, 1, 2, 2] + [2] * 3 + [3] * 3 + [3, 3, 4])
    assert disagreements(view) == pytest.approx([0, 1 - 2 / 4, 1 - 2 / 4, 1 - 2 / 3])


def test_hidden_points_count_for_nothing(seen):
    # Of superpoint 0 three points are seen, of superpoint 1 four; two of the three have label 7, which two of the four
    # have.
    view = seen([0, 1, 2, 4, 5, 6, 7], [7, 7, 1, 7, 7, 3, 3])
    assert disagreements(view) == pytest.approx([0, 1 - 2 / 3, 1 - 2 / 3, 0.5])


def test_what_no_image_sees_is_neutral(seen):
    assert MIN_POINTS == 3
    few = seen([0, 1, 4, 5, 6, 7, 10, 11, 12], [1, 1, 1, 1, 1, 1, 1, 1, 1])  # of superpoint 0 there are but two
    for r_o in (0.3, 0.5, 0.9):
        assert disagreements(few, r_o=r_o) == pytest.approx([0, 1 - r_o, 1 - r_o, 0])
        assert disagreements(seen([], []), r_o=r_o) == pytest.approx([0, 1 - r_o, 1 - r_o, 1 - r_o])
        assert disagreements(r_o=r_o) == pytest.approx([0, 1 - r_o, 1 - r_o, 1 - r_o])


def test_views_are_averaged_as_in_eq_6(seen):
    same, other = seen(range(13), [5] * 13), seen(range(10), [1] * 4 + [2] * 6)
    assert disagreements(same, other, same) == pytest.approx([0, 1 / 3, 1 / 3, 0])
    assert disagreements(same, other, same, seen([], [])) == pytest.approx([0, 1 / 3, 1 / 3, 0])  # that sees none


def test_pixels_without_a_label_are_left_out(seen):
    view = seen(range(13), [-1, 6, 6, 6] + [6] * 3 + [-1] * 3 + [-1] * 3)
    assert disagreements(view) == pytest.approx([0, 0, 0, 0.5])


def test_many_points_of_one_label(seen):
    view = seen(range(700), [2] * 400 + [9] * 300)
    superpoints = [0] * 200 + [1] * 500  # of superpoint 1, 200 points have label 2
    edges = torch.tensor([[0], [699]])
    assert disagreements(view, superpoints=superpoints, edges=edges) == pytest.approx([0])
    superpoints = [0] * 500 + [1] * 200  # superpoint 0 has 400 of label 2 and 100 of 9, superpoint 1 all of 9
    assert disagreements(view, superpoints=superpoints, edges=edges) == pytest.approx([0.5])


def test_one_superpoint_and_no_edges(seen):
    view = seen(range(13), [1] * 13)
    assert disagreements(view, superpoints=[0] * 13) == [0, 0, 0, 0]
    assert disagreements(view, edges=torch.empty(2, 0, dtype=torch.int64)) == []


def slow(superpoint, edge_index, observations, r_o):
    """The same, edge by edge, with sets and loops."""
    result = []
    for i, j in edge_index.T.tolist():
        overlaps = []
        for view in observations:
            counts = ({}, {})
            for point, row, column in zip(view.visible.point, view.visible.row, view.visible.column, strict=True):
                label = int(view.labels[row, column])
                for side, end in enumerate((i, j)):
                    if label >= 0 and superpoint[point] == superpoint[end]:
                        counts[side][label] = counts[side].get(label, 0) + 1
            smaller = min(sum(count.values()) for count in counts)
            if smaller >= MIN_POINTS:
                overlaps.append(sum(min(n, counts[1].get(label, 0)) for label, n in counts[0].items()) / smaller)
        r = 1 - sum(overlaps) / len(overlaps) if overlaps else 1 - r_o
        result.append(0.0 if superpoint[i] == superpoint[j] else r)
    return result


@pytest.mark.parametrize("seed", range(4))
def test_against_the_slow_twin_with_any_threads_and_order(seed, seen, set_threads):
    generator = torch.Generator().manual_seed(seed)
    superpoint = torch.cat([torch.arange(7), torch.randint(7, (53,), generator=generator)])
    edges = torch.randint(60, (2, 40), generator=generator)
    views = []
    for _ in range(5):
        point = torch.randperm(60, generator=generator)[:35].sort().values
        views.append(seen(point.tolist(), torch.randint(-1, 4, (35,), generator=generator).tolist()))
    r = superpoint_disagreement(superpoint, edges, views, NEUTRAL)
    assert r.tolist() == pytest.approx(slow(superpoint, edges, views, 0.5), abs=4 * OVERLAP_RESOLUTION)
    for count in (1, 2, 4):
        set_threads(count)
        assert torch.equal(superpoint_disagreement(superpoint, edges, views[::-1], NEUTRAL), r)
