"""What the ground of a scan grows over."""

import math

import pytest
import torch
from lidar_scans import HEIGHT, plane_hits, rays, scan

from torchjoint.config import ScanConfig
from torchjoint.segments.scan import ground as ground_growth
from torchjoint.segments.scan.gaps import Gaps
from torchjoint.segments.scan.ground import grow_ground, rising
from torchjoint.segments.scan.method import segment_levels
from torchjoint.segments.scan.recognition import directions


class TestRising:
    def rises(self, points, object_height=0.25):
        points = torch.tensor(points)
        which = torch.arange(len(points))
        return rising(directions(points), points[:, 2].double(), which, object_height).tolist()

    def test_by_hand(self):
        # At 10 m: a wall's foot, its middle, its top; ground 1 m before it; a crown above the ground.
        points = [[10.0, 0, -1.7], [10, 0, -1.2], [10, 0, -0.7], [9, 0, -1.7], [9, 0, 2]]
        assert self.rises(points) == [True, True, False, False, False]
        assert self.rises(points, 0.6) == [True, False, False, False, False]

    def test_far_away_it_looks_farther_around(self):
        assert self.rises([[5.0, 0, -1.7], [5.5, 0, -0.7]]) == [False, False]
        assert self.rises([[50.0, 0, -1.7], [50.5, 0, -0.7]]) == [True, False]

    def test_across_the_seam(self):
        assert self.rises([[-10.0, 0.01, -1.7], [-10, -0.01, -0.7]]) == [True, False]

    def test_only_used_points_rise(self):
        points = torch.tensor([[10.0, 0, -1.7], [10, 0, -1.2]])
        seen, which = directions(points), torch.tensor([0])
        for used in ([True, True], [True, False]):
            found = rising(seen, points[:, 2].double(), which, 0.25, torch.tensor(used))
            assert found.tolist() == [used[1]]

    def test_of_some_points(self):
        points = torch.tensor([[10.0, 0, -1.7], [10, 0, -1.2], [10, 0, -0.7]])
        found = rising(directions(points), points[:, 2].double(), torch.tensor([2, 0]), 0.25)
        assert found.tolist() == [False, True]
        none = torch.empty(0, dtype=torch.int64)
        assert rising(directions(points), points[:, 2].double(), none, 0.25).shape == (0,)


class TestGrowth:
    CONFIG = ScanConfig(object_height=0.3)

    @pytest.fixture(autouse=True)
    def rough_ground(self, monkeypatch):
        monkeypatch.setattr(ground_growth, "GROUND_HEIGHT", 0.1)

    def grown(self, points, height, gap=0.0, config=CONFIG):
        points = torch.tensor(points)
        gaps = Gaps.of(points, torch.full((len(points),), gap, dtype=torch.float64), torch.arange(len(points)))
        return grow_ground(points, torch.tensor(height).double(), directions(points), gaps, config).tolist()

    def test_low_points_from_which_nothing_rises(self):
        points = [[10.0, 0, -1.7], [10.0, 3, -1.5], [10, -3, -1.5], [10, -3, -1.0]]
        assert self.grown(points, [0.0, 0.2, 0.2, 0.7]) == [True, True, False, False]
        off = ScanConfig(object_height=0)
        assert self.grown(points, [0.0, 0.2, 0.2, 0.7], config=off) == [True, False, False, False]

    def test_patches_that_continue_the_ground(self):
        # A slope: its two patches are too high over the profile, the second one is near the first one only.
        points = [[10.0, 0, -1.7], [11.5, 0, -1.4], [13.0, 0, -1.1], [10, 5, -1.2]]
        assert self.grown(points, [0.0, 0.4, 0.7, 0.5]) == [True, True, True, False]
        # As one patch they join as well; with a step of .5 m none does.
        gap = 1.6
        assert self.grown(points, [0.0, 0.4, 0.7, 0.5], gap) == [True, True, True, False]
        points[1][2] = points[2][2] = -1.2
        assert self.grown(points, [0.0, 0.5, 0.5, 0.5], gap) == [True, False, False, False]

    def test_nothing_to_grow_from(self):
        assert self.grown([[10.0, 0, -1]], [0.7]) == [False]
        assert self.grown([[10.0, 0, -1]], [0.0]) == [True]


def crumbs(points, what):
    """Segments of mostly ground (what = 0), besides the largest."""
    labels = segment_levels(points).at()
    size, of_ground = torch.bincount(labels), torch.bincount(labels[what == 0], minlength=int(labels.max()) + 1)
    return int((2 * of_ground > size).sum()) - 1


def slanted(pavement):
    """A street with a pavement that begins at y = 3 m with a kerb, and rises gently away from it."""
    directions_ = rays(64, 1800)
    on_street = plane_hits(directions_)
    normal = torch.tensor([0.0, -pavement, 1.0], dtype=torch.float64)
    down = -(directions_ @ normal)
    on_pavement = torch.where(down > 1e-9, (HEIGHT - 0.12 + 3 * pavement) / down.clamp(min=1e-9), torch.inf)
    at = directions_ * on_pavement.clamp(max=1e3)[:, None]
    ranges = torch.where((at[:, 1] > 3) & (on_pavement < on_street + 1), on_pavement, on_street)
    ranges = torch.where((on_street * directions_[:, 1] > 3) & ~(at[:, 1] > 3), torch.inf, ranges)
    kept = ranges < 50
    return (directions_ * ranges.clamp(max=1e3)[:, None])[kept].float()


@pytest.mark.parametrize("slope", [0.0, 0.03, 0.08])
def test_a_gently_rising_pavement_joins_the_street(slope):
    points = slanted(slope)
    assert (points[:, 1] > 3.5).sum() > 2000
    labels = segment_levels(points).at()
    assert (labels == labels.mode().values).float().mean() > 0.999


@pytest.mark.parametrize("slope", [-0.08, 0.1, 0.15])
def test_a_steady_slope_is_one_segment(slope):
    points, _ = scan(slope=slope, reach=30)
    assert segment_levels(points).at().unique().tolist() == [0]


def test_a_cloud_far_from_the_sensor_is_told():
    points, _ = scan(reach=30)
    with pytest.warns(UserWarning, match=r"method scan expects the sensor at the origin, 6e\+06 m from here"):
        segment_levels(points + torch.tensor([0.0, 6e6, 0])).at()


def test_rough_ground_leaves_few_crumbs():
    points, what = scan(((8.0, -1.0, -HEIGHT), (12.0, 1.0, -0.2)), reach=40)
    ground = what == 0
    points[ground, 2] += 0.04 * torch.randn(int(ground.sum()), generator=torch.Generator().manual_seed(0))
    assert crumbs(points, what) <= 1


@pytest.mark.parametrize("distance", [12.0, 18, 22, 25])
def test_the_lower_half_of_a_car_is_no_ground(distance):
    points, what = scan(((distance, -2.2, -HEIGHT + 0.2), (distance + 1.8, 2.2, -0.2)))
    labels = segment_levels(points).at()
    assert (labels[what == 1] == labels[what == 0].mode().values).float().mean() < 0.02


def test_the_side_of_a_car_beside_the_sensor_is_no_ground():
    """The lowest beam meets it high above the ground, and the beams above it climb in small steps."""
    points, what = scan(((-2.0, 2.0, -HEIGHT), (2.5, 3.8, -0.3)))
    labels = segment_levels(points).at()
    assert (what == 1).sum() > 1000
    assert (labels[what == 1] == labels[what == 0].mode().values).float().mean() < 0.02


def test_threads_change_nothing(set_threads):
    points = slanted(0.05)
    points = points + 0.02 * torch.randn(points.shape, generator=torch.Generator().manual_seed(1))
    found = []
    for threads in (1, 2):
        set_threads(threads)
        found.append(segment_levels(points).at())
    assert torch.equal(found[0], found[1])


def test_far_things_are_not_grown_over():
    box = ((30.0, -1.0, -HEIGHT), (31.0, 1.0, -HEIGHT + 1.4))
    points, what = scan(box)
    labels = segment_levels(points).at()
    assert math.isclose(float((labels[what == 1] != labels[what == 0].mode().values).float().mean()), 1, abs_tol=0.05)
