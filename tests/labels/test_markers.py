"""Markers that their neighbours contradict: by hand, and against the rule written out for all pairs."""

import math

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from torchjoint.labels.markers import NEAR, VOTERS, without_outvoted

NONE = -1


def strip(labels, bright=()):
    """Markers in one row, a pixel each, and its colours: white at the bright pixels."""
    colors = torch.zeros(3, 1, len(labels))
    colors[:, :, list(bright)] = 1
    return torch.tensor([labels], dtype=torch.int32), colors


def test_a_point_seen_through_another_thing_is_outvoted():
    """Label 0 shows through label 1 at pixel 12; at the border, the colours tell who is right."""
    labels = [0] * 8 + [1] * 4 + [0] + [1] * 4 + [0] * 8
    markers, colors = strip(labels, bright=range(8, 17))
    expected = [NONE if pixel == 12 else label for pixel, label in enumerate(labels)]
    assert without_outvoted(markers, colors, 100.0).tolist() == [expected]


def test_small_things_stay():
    labels = [0] * 12 + [1, 1] + [0] * 12
    markers, colors = strip(labels)
    assert torch.equal(without_outvoted(markers, colors, 100.0), markers)
    apart, _ = strip([0] * 12 + [1] + [0] * 9 + [1] + [0] * 12)
    assert not (without_outvoted(apart, torch.zeros(3, *apart.shape), 100.0) == 1).any()


def test_without_markers_or_with_one_label_nothing_changes():
    for labels in ([NONE] * 5, [NONE, 3, 3, NONE], [NONE, 0, NONE]):
        markers, colors = strip(labels)
        assert torch.equal(without_outvoted(markers, colors, 100.0), markers)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.3, 0.7, 1.0]), st.sampled_from([1, 3]))
def test_the_rule_for_all_pairs(seed, share, num_shades):
    """Few shades make many distances equal."""
    random, size = torch.Generator().manual_seed(seed), (7, 11)
    markers = torch.randint(0, 3, size, generator=random, dtype=torch.int32)
    markers[torch.rand(size, generator=random) >= share] = NONE
    shade = torch.randint(0, num_shades, size, generator=random)
    marked = [(y, x, int(markers[y, x]), int(shade[y, x])) for y, x in markers.ge(0).nonzero().tolist()]
    cell = math.ceil(NEAR * math.sqrt(markers.numel() / max(len(marked), 1)))
    expected = markers.clone()
    for y, x, mine, gray in marked:
        others = sorted(
            (float((v - y) ** 2 + (u - x) ** 2 + 3 * (2 * (other - gray)) ** 2), label == mine)
            for v, u, label, other in marked
            if (v, u) != (y, x)
        )
        in_question = any(
            label != mine and max(abs(v // cell - y // cell), abs(u // cell - x // cell)) <= 1
            for v, u, label, _ in marked
        )
        votes = [same for far, same in others if len(others) <= VOTERS or far < others[VOTERS][0]]
        if in_question and 2 * sum(votes) < min(len(votes), sum(same for _, same in others)):
            expected[y, x] = NONE
    colors = (shade / 4).expand(3, -1, -1)
    assert torch.equal(without_outvoted(markers, colors, 8.0), expected)
