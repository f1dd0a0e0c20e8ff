"""Directions from a sensor, and neighbours by them."""

import math

import pytest
import torch

from torchjoint.angular_neighbors import LEAST_RANGE, angular_neighbors, directions
from torchjoint.neighbors import nearest_neighbors


def at(azimuth, elevation, reach):
    """Points [N, 3] in these directions, degrees, at these ranges."""
    azimuth, elevation = torch.as_tensor(azimuth).double().deg2rad(), torch.as_tensor(elevation).double().deg2rad()
    x, y = elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin()
    return (torch.stack([x, y, elevation.sin()], 1) * torch.as_tensor(reach).double()[:, None]).float()


def test_directions_by_hand():
    seen = directions(torch.tensor([[3.0, 4, 0], [0, -2, 2], [-1, 0, -1], [0, 0, 0]]))
    assert seen.azimuth[:3].tolist() == pytest.approx([math.atan2(4, 3), -math.pi / 2, math.pi])
    assert seen.elevation.tolist() == pytest.approx([0, math.pi / 4, -math.pi / 4, 0])
    assert seen.distance.tolist() == pytest.approx([5, 2, 1, 0])
    assert seen.range.tolist() == pytest.approx([5, 8**0.5, 2**0.5, LEAST_RANGE])
    moved = directions(torch.tensor([[4.0, 6, 3]]), torch.tensor([1.0, 2, 3]))
    assert moved.azimuth.item() == pytest.approx(math.atan2(4, 3))
    assert moved.range.item() == pytest.approx(5)


def test_across_beams_and_not_only_along():
    # Two beams a degree apart, points every tenth of a degree.
    azimuth = torch.arange(40) / 10.0
    points = at(azimuth.repeat(2), [0.0] * 40 + [1.0] * 40, [20.0] * 80)
    beam = torch.arange(80) // 40
    along = beam[nearest_neighbors(points, 6).indices.long()] == beam[:, None]
    across = beam[angular_neighbors(points, 6, 1.0).long()] != beam[:, None]
    assert along.all()
    assert not across.any()
    # Where an angle of azimuth counts five times, the other beam is nearer than the third of the own.
    assert (beam[angular_neighbors(points, 6, 5.0).long()] != beam[:, None])[5:35].any(dim=1).all()


def test_the_ratio_of_ranges_counts_like_an_angle():
    one = math.degrees(math.log(1.02))  # as far in elevation as 2 % of the range
    points = at([0.0, 0, 0, 0], [0.0, 1.1 * one, 0, 30], [10.0, 10, 10.2, 10])
    assert angular_neighbors(points, 1)[0].tolist() == [2]
    points = at([0.0, 0, 0, 0], [0.0, 0.9 * one, 0, 30], [10.0, 10, 10.2, 10])
    assert angular_neighbors(points, 1)[0].tolist() == [1]


def test_the_azimuth_has_no_seam():
    points = at([179.9, -179.9, 179.0, -179.0], [0.0] * 4, [10.0] * 4)
    assert angular_neighbors(points, 1)[:, 0].tolist() == [1, 0, 0, 1]
    every = at(torch.arange(0, 360, 3.0), [2.0] * 120, [30.0] * 120)
    near = angular_neighbors(every, 2, 0.4).long().sort(dim=1).values
    places = torch.arange(120)
    expected = torch.stack([(places - 1) % 120, (places + 1) % 120], 1).sort(dim=1).values
    assert torch.equal(near, expected)


def test_few_points():
    assert angular_neighbors(torch.ones(1, 3), 4).shape == (1, 0)
    assert angular_neighbors(torch.zeros(3, 3), 4).shape == (3, 2)  # all at the sensor
    assert angular_neighbors(torch.empty(0, 3), 4).shape[0] == 0
