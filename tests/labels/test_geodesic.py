"""Markers that their neighbours contradict, by hand."""

import torch

from torchjoint.labels.geodesic import without_outvoted

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
