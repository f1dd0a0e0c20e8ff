"""Step 6, regions: what lies on borders, by hand, and why it is pooled."""

import math

import pytest
import torch

from torchjoint import ops
from torchjoint.segments.planes import Planes, combined_costs, crease_costs


def planes_at(degrees, where=(0.0, 1.0)):
    """Two planes along the x axis: the one shows up, the other is turned away from z towards x, by degrees."""
    angle = math.radians(degrees)
    mean = torch.tensor([[x, 0.0, 0.0] for x in where])
    return Planes(mean, torch.tensor([[0.0, 0, 1], [math.sin(angle), 0.0, math.cos(angle)]]))


class TestCreaseCosts:
    @pytest.mark.parametrize(
        ("degrees", "known", "expected"),
        [
            (0, True, 0.0),
            (0, False, 0.0),
            (-45, True, 0.5),
            (-90, True, 1.0),
            (-150, True, 1.0),
            (45, True, 0.2 * 0.5),
            (90, True, 0.2),
            (150, True, 0.2),
            (45, False, 0.5),
            (-45, False, 0.5),
            (150, False, 1 / 3),  # of unknown sign, 150 degrees are 30
            (180, False, 0.0),
        ],
    )
    def test_by_hand(self, degrees, known, expected):
        oriented = torch.tensor([True, known])
        for edge in ([[0], [1]], [[1], [0]]):
            cost = crease_costs(torch.tensor(edge), planes_at(degrees), oriented, 0.2)
            assert cost.tolist() == pytest.approx([expected], abs=1e-6)

    def test_convex_factor_1_is_blind_for_what_is_convex(self):
        known = torch.ones(2, dtype=torch.bool)
        for degrees in (-30, 30):
            cost = crease_costs(torch.tensor([[0], [1]]), planes_at(degrees), known, 1)
            assert cost.tolist() == pytest.approx([1 / 3], abs=1e-6)

    def test_convex_is_judged_from_the_planes_means(self):
        known = torch.ones(2, dtype=torch.bool)
        backwards = planes_at(90, where=(1.0, 0.0))
        assert crease_costs(torch.tensor([[0], [1]]), backwards, known, 0.2).tolist() == [1.0]

    def test_no_edges(self):
        none = torch.empty(2, 0, dtype=torch.int64)
        assert crease_costs(none, planes_at(0), torch.ones(2, dtype=torch.bool), 0.1).shape == (0,)


class TestWithImages:
    @pytest.mark.parametrize(
        ("crease", "disagreement", "expected"),
        [
            (0.0, 0.0, 0.0),  # flat, one segment
            (0.0, 1.0, 0.4),  # flat, the images part it
            (1.0, 0.0, 1 - 0.6),  # a sharp crease inside one segment
            (1.0, 1.0, 1.0),  # a sharp crease, and the images agree
            (0.0, 0.5, 0.2),
            (1.0, 0.5, 1 - 0.3),
            (0.5, 0.5, 0.5 * 0.7 + 0.4 * 0.25),
        ],
    )
    def test_by_hand(self, crease, disagreement, expected):
        cost = combined_costs(torch.tensor([crease]), torch.tensor([disagreement]), 0.4, 0.6)
        assert cost.tolist() == pytest.approx([expected], abs=1e-6)

    def test_without_weight_and_agreement_images_change_nothing(self):
        crease = torch.rand(50, generator=torch.Generator().manual_seed(0))
        assert torch.equal(combined_costs(crease, crease.flip(0), 0, 0), crease)

    def test_more_disagreement_never_costs_less(self):
        crease, r = torch.meshgrid(*[torch.linspace(0, 1, 21)] * 2, indexing="ij")
        for weight, agreement in ((0.1, 0.0), (0.4, 0.6), (0.0, 1.0), (2.0, 1.0)):
            assert (combined_costs(crease, r, weight, agreement).diff(dim=1) >= -1e-6).all()


def two_sheets(side, num_weak):
    """Two side x side grids with a border of `side` edges that cost 0.6, but the first few 0; inside all cost 0."""
    index = torch.arange(2 * side * side).view(side, 2 * side)
    right = torch.stack([index[:, :-1].flatten(), index[:, 1:].flatten()])
    down = torch.stack([index[:-1].flatten(), index[1:].flatten()])
    edges = torch.cat([right, down], 1)
    crosses = (edges[0] % (2 * side) == side - 1) & (edges[1] == edges[0] + 1)
    cost = 0.6 * crosses
    cost[torch.nonzero(crosses).squeeze(1)[:num_weak]] = 0
    return edges, cost, (index % (2 * side) >= side).flatten().long()


def merge(region, edges, cost, threshold, min_size):
    return ops.merge_regions(region[edges], cost, torch.bincount(region), threshold, min_size)[region]


class TestMerge:
    def test_a_weak_edge_in_a_strong_border_does_not_leak(self):
        """The reason for pooling: Felzenszwalb-Huttenlocher goes through the hole on the same edges."""
        edges, cost, sheet = two_sheets(side=10, num_weak=1)
        assert int((cost > 0).sum()) == 9
        for scale in (0.1, 1.0, 10.0):
            assert ops.felzenszwalb(edges, cost, len(sheet), scale, 0).max() == 0
        quarter = sheet * 2 + (torch.arange(len(sheet)) >= len(sheet) // 2)
        assert torch.equal(merge(quarter, edges, cost, 0.3, 5), sheet)
        assert torch.equal(merge(sheet, edges, cost, 0.53, 5), sheet)
        assert merge(sheet, edges, cost, 0.55, 5).max() == 0

    def test_edges_inside_count_for_nothing(self):
        edges, cost, sheet = two_sheets(side=4, num_weak=0)
        inside = sheet[edges[0]] == sheet[edges[1]]
        assert torch.equal(merge(sheet, edges, torch.where(inside, 1.0, cost), 0.5, 5), sheet)

    def test_points_count_for_the_smallest_size(self):
        edges = torch.tensor([[0, 1, 2, 3, 4], [1, 2, 3, 4, 5]])
        region, cost = torch.tensor([0, 0, 0, 1, 1, 2]), torch.ones(5)
        assert merge(region, edges, cost, 0, 0).tolist() == [0, 0, 0, 1, 1, 2]
        assert merge(region, edges, cost, 0, 2).tolist() == [0, 0, 0, 1, 1, 1]

    def test_numbers_come_from_first_regions_not_first_points(self):
        region = torch.tensor([2, 1, 0])
        none = torch.empty(2, 0, dtype=torch.int64)
        assert merge(region, none, torch.empty(0), 0.3, 5).tolist() == [2, 1, 0]
