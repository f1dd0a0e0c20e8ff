"""The tree of a scan's parts over growing gaps, and the cut through it."""

from itertools import product

import pytest
import torch
from lidar_scans import HEIGHT, scan

from torchjoint.joint import JointSegmenter
from torchjoint.metrics import segmentation_covering
from torchjoint.segments.scan.cut import DEFAULT, falls_apart, levels_of
from torchjoint.segments.scan.gaps import LEVELS, Gaps
from torchjoint.segments.scan.method import segment_levels
from torchjoint.segments.scan.tree import FEATURE_NAMES, Tree, grow_tree

BOXES = (
    ((8.0, -1.0, -HEIGHT), (12.0, 1.0, 0.1)),
    ((8.0, 1.3, -HEIGHT), (12.0, 3.0, 0.1)),
    ((6.0, 4.4, -HEIGHT), (6.6, 5.0, 0.1)),
    ((-16.0, -2.0, -HEIGHT), (-12.0, 0.5, 0.0)),
)


def tree_of(parent: list[int], level: list[int]) -> Tree:
    """A tree whose every superpoint is one point."""
    above = torch.tensor(parent)
    superpoints = torch.arange(level.count(0))
    inner = torch.arange(len(superpoints), len(parent))
    return Tree(
        superpoints, superpoints, above, torch.tensor(level), inner, torch.zeros(len(inner), len(FEATURE_NAMES))
    )


def test_a_tree_by_hand():
    """Points 10 m to the left, in gaps of 1 m: three within .4, two more within .5, both together at 1.2."""
    y = torch.tensor([0.0, 0.35, 0.7, 1.85, 2.3, 9.0])
    points = torch.stack([torch.full_like(y, 10.0), y, torch.zeros(6)], 1)
    everything = torch.ones(6, dtype=torch.bool)
    gaps = Gaps.of(points, torch.ones(6).double(), torch.arange(6))
    height = torch.tensor([0.5, 1.0, 0.5, 0.5, 2.0, 0.0]).double()
    tree = grow_tree(gaps, everything, points, height, 0)
    assert tree.superpoint.tolist() == list(range(6))
    assert tree.parent.tolist() == [6, 6, 6, 7, 7, -1, 8, 8, -1]
    # LEVELS: .3, .37, .45, .55, .67, .82, 1.0, 1.23, 1.5
    assert tree.level.tolist() == [0] * 6 + [1, 3, 7]
    assert tree.inner.tolist() == [6, 7, 8]
    found = dict(zip(FEATURE_NAMES, tree.features.double().T, strict=True))
    expected = {
        "whole_points": torch.tensor([3.0, 2, 5]).log().tolist(),
        "whole_lowest": [0.5, 0.5, 0.5],
        "whole_highest": [1.0, 2.0, 2.0],
        "whole_level": [1, 3, 7],
        "first_points": [0, 0, torch.tensor(3.0).log()],
        "first_highest": [0.5, 0.5, 1.0],  # of equal parts the lowest, and then the one that is nearest to x = -inf
        "second_points": [0, 0, torch.tensor(2.0).log()],
        "least_gap": [0.35, 0.45, 1.15],
        "parts": [3, 2, 2],
        "ends": [7, 7, 9],
        "apart": [0.7, 0.45, 2.075 - 0.35],
    }
    for name, values in expected.items():
        torch.testing.assert_close(found[name], torch.tensor(values).double(), atol=1e-5, rtol=1e-5, msg=name)


def test_the_best_of_all_cuts():
    """Against all cuts of small trees, one by one."""
    tree = tree_of([6, 6, 7, 7, 8, 9, 8, 9, 10, 10, -1], [0] * 6 + [1, 1, 2, 3, 4])
    random = torch.Generator().manual_seed(0)
    for _ in range(200):
        gain = torch.randn(5, generator=random).double()
        apart = falls_apart(tree, gain)
        best = 0.0
        for chosen in product((False, True), repeat=5):
            of_node = torch.tensor([False] * 6 + list(chosen))
            above = tree.parent[tree.inner]
            if all(up < 0 or of_node[up] for up, is_apart in zip(above.tolist(), chosen, strict=True) if is_apart):
                best = max(best, float(gain[torch.tensor(chosen)].sum()))
        assert not apart[:6].any()
        assert float(gain[apart[6:]].sum()) == pytest.approx(best)


def test_levels_by_hand():
    tree = tree_of([4, 4, 5, 5, 6, 6, -1], [0] * 4 + [1, 2, 3])
    # Point 0 is ground, the others are the superpoints.
    moved = tree._replace(which=torch.arange(1, 5))
    levels = levels_of(moved, torch.tensor([False] * 4 + [True, False, True]), 5)
    assert levels.at().tolist() == [0, 1, 2, 3, 3]  # 4 falls apart, 5 does not
    assert levels.at(0).tolist() == [0, 1, 1, 1, 1]
    assert levels.at(1).tolist() == [0, 1, 2, 3, 4]
    steps = len(LEVELS)
    expected = [DEFAULT + (1 - DEFAULT) / steps, DEFAULT * 2 / steps, DEFAULT + (1 - DEFAULT) * 3 / steps]
    torch.testing.assert_close(levels.heights, torch.tensor(expected).double())


def test_levels_are_nested_and_the_default_is_the_cut():
    points, _ = scan(*BOXES)
    levels = segment_levels(points)
    assert torch.equal(levels.at(), segment_levels(points).at())
    for fine, coarse in ((1.0, 0.75), (0.75, 0.5), (0.5, 0.25), (0.25, 0.0)):
        pairs = torch.unique(torch.stack([levels.at(fine), levels.at(coarse)]), dim=1)
        assert len(pairs[0].unique()) == pairs.shape[1]  # a fine segment is in one coarse segment


def test_the_order_of_the_points_changes_nothing():
    points, _ = scan(*BOXES)
    points = points + 0.02 * torch.randn(points.shape, generator=torch.Generator().manual_seed(1))
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))
    labels, again = segment_levels(points).at(), segment_levels(points[order]).at()
    assert segmentation_covering(again, labels[order]).symmetric == 1


def test_a_result_has_all_levels():
    points, _ = scan(*BOXES)
    segmenter = JointSegmenter.from_preset("scan")
    segmenter.reset(points)
    result = segmenter.compute()
    assert torch.equal(result.points, segment_levels(points).at())
    assert len(result.at(0.0).points.unique()) < len(result.at(1.0).points.unique())
