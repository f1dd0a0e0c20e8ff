"""Whether a cloud without clear rings was seen from near the origin."""

import logging
import math

import numpy as np
import pytest
import torch
from domain_clouds import domain_cloud
from lidar_scans import HEIGHT, scan
from torchjoint_lab.benchmark.disturbances import DISTURBANCES
from torchjoint_lab.datasets.semantickitti import read_sweep
from torchjoint_lab.synthetic import DOMAINS

import torchjoint as tj
from torchjoint.datasets import load_scene
from torchjoint.scene import Scene
from torchjoint.scene.scene import voxel_subsample
from torchjoint.segments.method import choose_method
from torchjoint.segments.scan.recognition import MAX_DEPENDENCE, dependence_on_range, look_for_scan

BOXES = (
    ((8.0, -1.0, -HEIGHT), (12.0, 1.0, 0.1)),
    ((-16.0, -2.0, -HEIGHT), (-12.0, 0.5, 0.0)),
    ((20.0, 6.0, -HEIGHT), (60.0, 8.0, 8.0)),
    ((-40.0, -12.0, -HEIGHT), (30.0, -10.0, 8.0)),
)


def street(*places):
    """Scans from places (x, y, z), in common coordinates."""
    clouds = []
    for x, y, z in places:
        moved = torch.tensor([x, y, z])
        boxes = [tuple(tuple((torch.tensor(corner) - moved).tolist()) for corner in box) for box in BOXES]
        clouds.append(scan(*boxes)[0] + moved)
    return torch.cat(clouds)


def noisy(points, deviation):
    return points + deviation * torch.randn(points.shape, generator=torch.Generator().manual_seed(0))


@pytest.fixture(scope="module")
def sweeps(shared):
    path = shared / "data"
    return {
        "semantickitti": read_sweep(path / "semantickitti/000964.bin").points,
        "vod": load_scene(path / "vod/cloud.ply").points,
        "argo": load_scene(path / "argo/cloud.ply").points,
        "nuscenes": load_scene(path / "nuscenes").points,
    }


@pytest.mark.parametrize("name", ["semantickitti", "vod", "argo", "nuscenes"])
@pytest.mark.parametrize("disturbance", ["nothing", "moved", "half-points", "outliers-1", "outliers-5", "twice"])
def test_disturbed_scans_are_recognised(sweeps, name, disturbance):
    scene = DISTURBANCES[disturbance](Scene(sweeps[name]), torch.Generator().manual_seed(0)).scene
    if name != "nuscenes":  # a third of its points are on the car itself
        assert dependence_on_range(scene.points) < MAX_DEPENDENCE
    assert look_for_scan(scene.points).is_scan


def test_a_noisy_scan_without_rings():
    points = noisy(street((0.0, 0.0, 0.0)), 0.15)
    found = look_for_scan(points)
    assert found.rings is None
    assert found.is_scan
    assert "(likely" in str(found)


@pytest.mark.parametrize(("x", "y"), [(1.5, 0.0), (0.0, 0.6), (2.0, 1.0)])
def test_two_sensors(x, y):
    assert look_for_scan(street((x, y, 0.0), (-x, -y, -0.1))).is_scan


def test_a_sensor_above_the_origin():
    points = street((0.0, 0.0, 0.0)) + torch.tensor([1.3, 0.0, 1.3])
    assert look_for_scan(points).rings is None
    assert look_for_scan(points).is_scan


def test_a_crop_to_a_view():
    points = noisy(street((0.0, 0.0, 0.0)), 0.1)
    assert look_for_scan(points[torch.atan2(points[:, 1], points[:, 0]).abs() < math.radians(40)]).is_scan


def test_a_map_of_many_sweeps_is_none():
    for places in ([(4.0 * i, 0.0, 0.0) for i in range(10)], [(4.0 * i - 20, 0.0, 0.0) for i in range(11)]):
        points = street(*places)
        assert not look_for_scan(points).is_scan
        assert not look_for_scan(points[voxel_subsample(points, 0.1)]).is_scan


@pytest.mark.slow
@pytest.mark.parametrize("domain", DOMAINS)
def test_generated_scenes_are_none_wherever_the_origin_is(domain):
    pytest.importorskip("open3d")
    points = domain_cloud(domain, 0)
    assert look_for_scan(points).is_scan == (domain == "street")
    if domain != "street":
        assert not look_for_scan(points - (points.amin(0) + points.amax(0)) / 2).is_scan


@pytest.mark.parametrize("seed", [0, 15])
def test_rooms_are_none(scene_of, seed):
    points = scene_of(seed).scene.points  # few: chance alone made rings of them
    assert not look_for_scan(points).is_scan
    assert not look_for_scan(points - (points.amin(0) + points.amax(0)) / 2).is_scan


@pytest.mark.slow
def test_a_large_room_whose_floor_is_at_0_is_none():
    """The sensor would stand as high above the floor as the floor is noisy."""
    points = tj.synthetic.make_scene(9, "medium").scene.points
    assert -0.01 < float(points[:, 2].quantile(0.05)) < 0
    assert not look_for_scan(points).is_scan


@pytest.mark.parametrize("thickness", [0.02, 0.05, 0.1])
def test_both_sides_of_a_floor_are_none(thickness):
    """A model of a building, sampled; seen from the floor's own height, its two sides look like two rings."""
    places = torch.rand((5000, 3), generator=torch.Generator().manual_seed(0)) * torch.tensor([5.0, 5.0, 2.5])
    floor = torch.cat([places[:, :2], -thickness * (places[:, 2:] > 1.25)], 1)
    walls = places.clone()
    for i, (axis, place) in enumerate([(0, 0.0), (0, 5.0), (1, 0.0), (1, 5.0)]):
        walls[1250 * i :][:1250, axis] = place
    for points in (floor, torch.cat([floor, walls])):
        assert not look_for_scan(points).is_scan


def test_depth_images_and_fused_clouds_are_none(shared):
    assert not look_for_scan(load_scene(shared / "data/ycb").points).is_scan
    paths = sorted((shared / "data/mosd").glob("*.pcd"))[::9]
    assert paths
    for path in paths:
        points = load_scene(path).points
        for cloud in (points, points[:, [2, 0, 1]] * torch.tensor([1.0, -1, -1])):
            assert not look_for_scan(cloud.contiguous()).is_scan
            assert not look_for_scan(cloud[voxel_subsample(cloud.contiguous(), 0.005)]).is_scan


def test_the_unit_and_the_order_change_nothing():
    points = street((0.0, 0.0, 0.0))
    found = dependence_on_range(points)
    assert dependence_on_range(points * 10) == pytest.approx(found, abs=0.02)
    assert dependence_on_range(points.flip(0)) == pytest.approx(found, abs=0.02)


@pytest.mark.parametrize(
    "points", [torch.zeros(100, 3), torch.zeros(1, 3), torch.tensor([[3.0, 4, -1]]), torch.rand(50, 3) - 0.5]
)
def test_few_points_are_none(points):
    assert not look_for_scan(points).is_scan


def test_method_auto_and_its_line(caplog):
    points = noisy(street((0.0, 0.0, 0.0)), 0.15)
    auto = tj.Config().set(["point_segments.method=auto"])
    assert choose_method(auto, points).name == "scan"
    with caplog.at_level(logging.INFO, "torchjoint.joint"):
        tj.JointSegmenter(auto).reset(points)
    assert "of a LiDAR without clear rings (likely" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.INFO, "torchjoint.joint"):
        tj.JointSegmenter.from_preset("scan").reset(torch.rand(500, 3, generator=torch.Generator().manual_seed(0)))
    assert "no scan of a LiDAR recognised" in caplog.text


@pytest.mark.parametrize("points", [torch.zeros(0, 3), torch.rand(3, 4), torch.from_numpy(np.full((2, 3), np.inf))])
def test_bad_points(points):
    with pytest.raises(ValueError, match=r"points: (expected|2 of 2 points are NaN)"):
        dependence_on_range(points)
