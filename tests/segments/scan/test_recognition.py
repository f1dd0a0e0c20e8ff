"""Whether a cloud is a scan of a turning LiDAR."""

import math

import pytest
import torch
from domain_clouds import domain_cloud
from lidar_scans import HEIGHT, scan
from torchjoint_lab.synthetic import DOMAINS, make_domain_scene

from torchjoint.datasets import list_scenes, load_scene
from torchjoint.datasets.files.clouds import read_scan
from torchjoint.scene.scene import voxel_subsample
from torchjoint.segments.scan.recognition import find_rings
from torchjoint.views.visibility import in_any_view

BOXES = (((8.0, -1.0, -HEIGHT), (12.0, 1.0, 0.1)), ((-16.0, -2.0, -HEIGHT), (-12.0, 0.5, 0.0)))


def thinned(points, share=0.5):
    return points[torch.rand(len(points), generator=torch.Generator().manual_seed(0)) < share]


def noisy(points, deviation):
    return points + deviation * torch.randn(points.shape, generator=torch.Generator().manual_seed(0))


def kitti_scan(shared):
    return load_scene(shared / "data/kitti/training/velodyne/000008.bin").points


def semantickitti(shared):
    return read_scan(shared / "data/semantickitti/000964.bin", 4)[:, :3].contiguous()


@pytest.fixture(scope="module")
def sweeps(shared):
    """Real scans, and the number of beams of each."""
    return {
        "kitti": (kitti_scan(shared), 64),
        "semantickitti": (semantickitti(shared), 64),
        "nuscenes": (load_scene(shared / "data/nuscenes").points, 32),
        "vlp16": (load_scene(shared / "data/vlp16").points, 16),
    }


@pytest.mark.parametrize("name", ["kitti", "semantickitti", "nuscenes", "vlp16"])
class TestRealScans:
    def test_they_are_recognised(self, sweeps, name):
        points, beams = sweeps[name]
        rings = find_rings(points)
        assert abs(rings.number - beams) <= 5
        assert rings == find_rings(points.clone())

    def test_thinned_to_a_half_and_to_a_quarter_too(self, sweeps, name):
        points, _ = sweeps[name]
        step = find_rings(points).step
        assert find_rings(thinned(points)).step == pytest.approx(step, rel=0.15)
        assert find_rings(thinned(points, 0.25)) is not None

    def test_with_noise_too(self, sweeps, name):
        points, _ = sweeps[name]
        along = 0.02 * torch.randn(len(points), 1, generator=torch.Generator().manual_seed(0))
        ranges = points.norm(dim=1, keepdim=True).clamp(min=0.1)
        assert find_rings(points * (1 + along / ranges)) is not None
        assert find_rings(noisy(points, 0.01)) is not None

    def test_the_unit_the_order_and_the_heading_change_nothing(self, sweeps, name):
        points, _ = sweeps[name]
        rings = find_rings(points)
        assert find_rings(points * 10) == rings
        assert find_rings(points.flip(0)) == rings
        angle = 2 * math.pi / 72 * 7  # by whole windows
        turn = torch.tensor([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
        assert find_rings(points @ turn.T).step == pytest.approx(rings.step, rel=0.1)


def test_the_part_of_a_scan_that_a_camera_sees(shared):
    for path in list_scenes(shared / "data/kitti/training").values():
        scene = load_scene(path)
        seen = scene.points[in_any_view(scene.points, scene.frames)]
        assert find_rings(seen) is not None
        assert find_rings(thinned(seen)) is not None


def test_a_scan_made_by_hand():
    points, _ = scan(*BOXES)
    rings = find_rings(points)
    assert math.degrees(rings.step) == pytest.approx(28 / 39, abs=0.02)  # 40 beams from -25 to 3 degrees
    assert find_rings(points.double()) == rings
    # Of the sensor elsewhere nothing is known; the rings are not about the origin then.
    assert find_rings(points + torch.tensor([7.0, 3.0, 1.0])) is None


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 2, 3))])
def test_generated_streets(seed):
    pytest.importorskip("open3d")
    points = make_domain_scene("street", seed, num_views=1).scene.points
    rings = find_rings(points)
    assert rings.number in (16, 32, 64)
    assert find_rings(thinned(points)) is not None
    assert find_rings(noisy(points, 0.01)) is not None


def test_a_generated_room_is_none():
    pytest.importorskip("open3d")
    assert find_rings(domain_cloud("room", 0)) is None


@pytest.mark.slow
@pytest.mark.parametrize("domain", DOMAINS)
def test_all_generated_scenes(domain):
    pytest.importorskip("open3d")
    for seed in range(2):
        points = domain_cloud(domain, seed)
        assert (find_rings(points) is not None) == (domain == "street"), seed


@pytest.mark.slow
def test_depth_images_are_none(shared):
    """Neither as the camera sees them, z forward, nor turned so that z is up: their rows are bent and too many."""
    paths = sorted((shared / "data/mosd").glob("*.pcd"))[::5]
    assert paths
    for path in paths:
        points = load_scene(path).points
        for cloud in (points, points[:, [2, 0, 1]] * torch.tensor([1.0, -1, -1])):
            assert find_rings(cloud.contiguous()) is None
            assert find_rings(cloud[voxel_subsample(cloud.contiguous(), 0.005)]) is None


def test_fused_clouds_are_none(shared):
    assert find_rings(load_scene(shared / "data/ycb").points) is None


@pytest.mark.slow
def test_a_fused_kitchen_is_none(shared, tmp_path):
    scene = load_scene(shared / "data/kitchen", cloud=tmp_path / "cloud.ply", voxel_size=0.05)
    assert find_rings(scene.points) is None


def random(shape, seed=0):
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def on_sphere(points):
    return 5 * points / points.norm(dim=1, keepdim=True)


def rings_of_a_globe():
    """Rings of constant elevation, as a LiDAR has, but at one distance."""
    elevation = torch.linspace(-0.5, 0.5, 64)[:, None]
    azimuth = torch.linspace(-3.1, 3.1, 900)[None]
    x, y = elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin()
    return 5 * torch.stack([x, y, elevation.sin().expand_as(x)], 2).view(-1, 3)


@pytest.mark.parametrize(
    "points",
    [
        random((60_000, 3)) * 20 - 10,
        on_sphere(random((60_000, 3)) - 0.5),
        rings_of_a_globe(),
        torch.cat([random((60_000, 2)) * 40 - 20, torch.full((60_000, 1), -1.7)], 1),
        torch.zeros(100, 3),
        torch.zeros(1, 3),
        torch.tensor([[3.0, 4.0, -1.0]]),
        random((50, 3)),
    ],
    ids=["box", "sphere", "globe", "plane", "zeros", "zero", "one", "few"],
)
def test_other_shapes_are_none(points):
    assert find_rings(points) is None


def test_threads_change_nothing(set_threads):
    points, _ = scan(*BOXES)
    found = []
    for threads in (1, 2, 4):
        set_threads(threads)
        found.append(find_rings(points))
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize("points", [torch.zeros(0, 3), torch.rand(3, 4), torch.full((2, 3), torch.inf)])
def test_bad_points(points):
    with pytest.raises(ValueError, match=r"points: (expected|2 of 2 points are NaN)"):
        find_rings(points)
