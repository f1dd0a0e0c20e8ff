"""Directions from a sensor."""

import math

import pytest
import torch

from torchjoint.segments.scan.recognition import LEAST_RANGE, directions


def test_directions_by_hand():
    seen = directions(torch.tensor([[3.0, 4, 0], [0, -2, 2], [-1, 0, -1], [0, 0, 0]]))
    assert seen.azimuth[:3].tolist() == pytest.approx([math.atan2(4, 3), -math.pi / 2, math.pi])
    assert seen.elevation.tolist() == pytest.approx([0, math.pi / 4, -math.pi / 4, 0])
    assert seen.distance.tolist() == pytest.approx([5, 2, 1, 0])
    assert seen.range.tolist() == pytest.approx([5, 8**0.5, 2**0.5, LEAST_RANGE])
