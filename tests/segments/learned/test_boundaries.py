"""Step 6, method learned: sums over the edges of boundaries, by hand, added, and against exact quantiles."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from torchjoint.segments.learned.boundaries import AVERAGED, BINS, MEASURES, Boundaries

SHARES = (0.1, 0.5, 0.9)


def of_gaps(values, pair, num_pairs):
    return Boundaries.of(torch.tensor(pair), num_pairs, {"gap": torch.tensor(values)})


def bounds(value, name):
    """The bin of a value, in exact numbers: its bounds."""
    scale, lowest = MEASURES[name], -1 if name == "crease" else 0
    share = (value / (abs(value) + scale) - lowest) / (1 - lowest)
    place = min(int(share * BINS), BINS - 1)

    def bound(number):
        share = lowest + number / BINS * (1 - lowest)
        return scale * share / (1 - abs(share)) if abs(share) < 1 else math.copysign(math.inf, share)

    return bound(place), bound(place + 1)


def test_sums_and_means_by_hand():
    found = of_gaps([5.0, 1, 3, math.nan, 2, 4, math.nan], [0, 0, 0, 0, 0, 2, 1], 3)
    assert found.num_edges.tolist() == [5, 1, 1]
    assert found.binned["gap"].sum(2).tolist() == [[4, 11], [0, 0], [1, 4]]
    summaries = found.summaries(SHARES)
    means, quantiles = summaries["gap"]
    assert means[[0, 2]].tolist() == [11 / 4, 4]
    assert quantiles[[0, 2]].tolist() == [[1, 3, 5], [4, 4, 4]]  # the places 0.3, 1.5 and 2.7 are rounded
    assert means[1].isnan()
    assert quantiles[1].isnan().all()
    assert [*found.binned] == [*summaries] == ["gap"]  # all else is unknown
    assert all((of_edges == 0).all() for of_edges in found.averages().values())


def test_what_is_averaged_counts_all_edges():
    values = {"views": torch.tensor([0, 2, 4]), "unoriented": torch.tensor([True, False, False])}
    means = Boundaries.of(torch.tensor([0, 0, 1]), 2, values).averages()
    assert means["views"].tolist() == [1, 4]
    assert means["unoriented"].tolist() == [0.5, 0]


@given(st.data())
def test_a_quantile_lies_in_the_bin_of_the_exact_one(data):
    name = data.draw(st.sampled_from(list(MEASURES)))
    numbers = st.floats(-2 if name == "crease" else 0, 100, width=32)
    values = data.draw(st.lists(numbers, min_size=1, max_size=30))
    found = Boundaries.of(torch.zeros(len(values), dtype=torch.int64), 1, {name: torch.tensor(values)})
    quantiles = found.summaries(SHARES)[name][1][0]
    for quantile, share in zip(quantiles.tolist(), SHARES, strict=True):
        exact = sorted(values)[int((torch.tensor(share) * (len(values) - 1)).round())]
        low, high = bounds(exact, name)
        slack = 1e-5 * (1 + abs(low))
        assert low - slack <= quantile <= high + slack
        if len(values) == 1:
            assert quantile == exact
    assert (quantiles.diff() >= 0).all()


@pytest.mark.parametrize("value", [0.0, 1e-30, 3e38, math.inf])
def test_extreme_values(value):
    found = of_gaps([value], [0], 1)
    assert found.binned["gap"][:, 0].sum() == (value < math.inf)
    expected = [value] * 3 if value < math.inf else [math.nan] * 3
    assert found.summaries(SHARES)["gap"][1][0].tolist() == pytest.approx(expected, nan_ok=True)
    assert not found.binned["gap"].isnan().any()


def test_groups_are_the_boundaries_of_all_their_edges():
    generator = torch.Generator().manual_seed(0)
    values = {name: torch.rand(200, generator=generator) for name in (*MEASURES, *AVERAGED)}
    values["crease"][::3] = torch.nan
    pair, of_pair = torch.arange(200) % 12, torch.arange(12) // 4
    apart = Boundaries.of(pair, 12, dict(values))
    few = (pair == 3) | (pair == 5)
    alone = Boundaries.of(
        torch.zeros(int(few.sum()), dtype=torch.int64), 1, {name: of[few] for name, of in values.items()}
    )
    expected = Boundaries.of(of_pair[pair], 3, values)
    both = apart.grouped([torch.arange(12), torch.tensor([3, 5])], [of_pair, torch.tensor([0, 0])], [3, 1])
    for found, first, second in zip(*(columns(one) for one in (both, expected, alone)), strict=True):
        torch.testing.assert_close(found, torch.cat([first, second]))


def test_histograms_of_many_boundaries_are_those_of_few(monkeypatch):
    generator = torch.Generator().manual_seed(2)
    pair, values = torch.randint(9, (300,), generator=generator), {"gap": torch.rand(300, generator=generator)}
    kept = Boundaries.of(pair, 9, values)
    monkeypatch.setattr("torchjoint.segments.learned.boundaries.MANY_BOUNDARIES", 8)
    counted = Boundaries.of(pair, 9, values)
    same = [torch.arange(9)], [torch.arange(9)], [9]
    grouped = kept.grouped(*same)
    assert isinstance(kept.binned, dict)
    assert isinstance(counted.grouped(*same).binned, dict)
    assert not isinstance(counted.binned, dict)
    assert not isinstance(grouped.binned, dict)
    assert kept.num_edges.tolist() == pair.bincount().tolist()
    assert kept.binned["gap"][:, 1].sum(1).allclose(torch.zeros(9).index_add_(0, pair, values["gap"]))
    both = [torch.arange(9)], [torch.arange(9) // 2], [5]
    for other in (counted, grouped):
        for one, again in ((kept, other), (kept.grouped(*both), other.grouped(*both))):
            assert all(map(torch.equal, columns(one), columns(again)))
            assert all(map(torch.equal, one.averages().values(), again.averages().values()))
            assert all(map(torch.equal, one.summaries((0.5,))["gap"], again.summaries((0.5,))["gap"]))


def columns(boundaries):
    return boundaries.num_edges, boundaries.averaged, *boundaries.binned.values()
