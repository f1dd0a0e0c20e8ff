"""The ground of a scan."""

import math

import pytest
import torch
from lidar_scans import HEIGHT, height_over_ground, scan

import torchjoint.segments.scan.ground as module

CAR = ((8.0, -1.0, -HEIGHT), (12.0, 1.0, -0.2))


def ground(points):
    return height_over_ground(points) < module.GROUND_HEIGHT


@pytest.mark.parametrize("slope", [-0.08, 0.0, 0.05, 0.1])
def test_a_plane_that_slopes_is_ground(slope):
    points, _ = scan(slope=slope, reach=30)
    assert (~ground(points)).float().mean() < 0.001  # where rays graze it, columns are too wide
    assert height_over_ground(points).abs().median() < 0.01


def test_a_box_stands_on_it_and_hides_what_is_behind():
    points, what = scan(CAR)
    on_ground = ground(points)
    assert on_ground[what == 0].all()
    height = points[:, 2].double() + HEIGHT
    torch.testing.assert_close(on_ground[what == 1], height[what == 1] < module.GROUND_HEIGHT)
    torch.testing.assert_close(height_over_ground(points), height, atol=0.02, rtol=0)


def test_what_is_seen_over_something_near_is_no_ground(monkeypatch):
    # Over the car's roof the wall is seen from 0.83 m on; reached at less than 10 degrees.
    wall = ((30.0, -1.5, -HEIGHT), (30.5, 1.5, 2.0))
    points, what = scan(CAR, wall)
    behind = (what == 2) & (points[:, 2] > -1.2)
    assert behind.sum() > 20
    assert not ground(points)[behind].any()
    # The comparison with the columns beside it is what does it.
    monkeypatch.setattr(module, "MAX_BUMP", 9.0)
    assert ground(points)[behind].any()


def test_a_kerb_is_ground_and_a_pavement_too():
    pavement = ((-40.0, 4.0, -HEIGHT), (40.0, 20.0, -HEIGHT + 0.12))
    points, what = scan(pavement)
    assert (what == 1).sum() > 500
    assert ground(points).float().mean() > 0.97


def test_a_wall_all_around_is_none():
    boxes = [((10.0, -10, -HEIGHT), (11.0, 10, 2)), ((-11.0, -10, -HEIGHT), (-10.0, 10, 2))]
    boxes += [((-10.0, 10, -HEIGHT), (10.0, 11, 2)), ((-10.0, -11, -HEIGHT), (10.0, -10, 2))]
    points, what = scan(*boxes)
    on_ground = ground(points)
    assert on_ground[what == 0].all()
    assert not on_ground[(what > 0) & (points[:, 2] > -HEIGHT + 0.3)].any()


def test_a_few_returns_from_below_the_ground_change_nothing():
    points, _ = scan(CAR)
    mirrored = torch.tensor([[6.0, 3.0, -7.0], [-15.0, 2.0, -20.0]])
    both = torch.cat([points, mirrored])
    torch.testing.assert_close(height_over_ground(both)[: len(points)], height_over_ground(points), atol=0.05, rtol=0)


def test_one_point_is_its_own_ground():
    assert ground(torch.tensor([[3.0, 4.0, -1.0]])).tolist() == [True]
    assert height_over_ground(torch.tensor([[3.0, 4.0, -1.0]])).tolist() == [0.0]
    assert ground(torch.zeros(1, 3)).tolist() == [True]  # at the sensor
    assert height_over_ground(torch.tensor([[300.0, 0.0, -1.0]])).tolist() == [0.0]  # far, and nothing near


def test_turned_by_whole_columns_it_is_the_same():
    points, _ = scan(CAR)
    angle = math.radians(178)  # the car now lies across the seam
    turn = torch.tensor([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    turned = (points.double() @ turn.double().T).float()
    torch.testing.assert_close(height_over_ground(turned), height_over_ground(points), atol=0.02, rtol=0)


def test_threads_and_order_change_nothing(set_threads):
    points, _ = scan(CAR)
    heights = []
    for threads in (1, 2, 4):
        set_threads(threads)
        heights.append(height_over_ground(points))
    assert torch.equal(heights[0], heights[1])
    assert torch.equal(heights[0], heights[2])
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(0))
    assert torch.equal(height_over_ground(points[order]), heights[0][order])
