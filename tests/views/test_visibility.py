import pytest
import torch

from torchjoint.config import VisibilityConfig
from torchjoint.views import visibility
from torchjoint.views.visibility import hidden_point_removal, project, visible_points

METHODS = ["zbuffer", "hidden_point_removal"]
SIZE = (48, 64)
K = torch.tensor([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]], dtype=torch.float64)
POSE = torch.eye(4, dtype=torch.float64)


def config(method, **changes):
    return VisibilityConfig(method=method, **changes)


def wall(z, half_width, step=0.02):
    """Points of a square facing the camera."""
    ticks = torch.arange(-half_width, half_width + step / 2, step)
    x, y = torch.meshgrid(ticks, ticks, indexing="ij")
    return torch.stack([x.flatten(), y.flatten(), torch.full_like(x.flatten(), z)], dim=1)


def points_in_view(points, method, spacing=0.02, **changes):
    return visible_points(points, torch.full((len(points),), spacing), K, POSE, SIZE, config(method, **changes))


@pytest.mark.parametrize("seed", range(3))
def test_hidden_points_are_those_of_open3d(seed):
    """Which runs the same hull; without it, the package needs SciPy only."""
    open3d = pytest.importorskip("open3d")
    points = torch.rand(2000, 3, generator=torch.Generator().manual_seed(seed)) + torch.tensor([0.0, 0, 1])
    center, factor = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64), 0.01
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points.double().numpy()))
    radius = float((points.double() - center).norm(dim=1).max()) * len(points) * factor
    _, kept = cloud.hidden_point_removal(center.numpy(), radius)
    found = hidden_point_removal(points, center, factor).nonzero().squeeze(1)
    assert 50 < len(found) < 1000
    assert sorted(kept) == found.tolist()


def test_projection_by_hand():
    points = torch.tensor([[0.0, 0, 2], [0.5, -0.25, 2]])
    projected = project(points, K, POSE, SIZE)
    assert projected.u.tolist() == [31.5, 46.5]
    assert projected.v.tolist() == [23.5, 16.0]
    assert projected.z.tolist() == [2.0, 2.0]


def test_the_pose_is_world_to_camera():
    pose = POSE.clone()
    pose[:3, :3] = torch.tensor([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])  # looks along +x of a z-up world
    pose[:3, 3] = pose[:3, :3] @ torch.tensor([-1.0, 0, -1], dtype=torch.float64)  # from (1, 0, 1)
    projected = project(torch.tensor([[3.0, 0, 1], [-1, 0, 1]]), K, pose, SIZE)
    assert projected.point.tolist() == [0]
    assert projected.z.item() == pytest.approx(2.0)


@pytest.mark.parametrize("method", METHODS)
def test_a_wall_hides_what_is_behind_it(method):
    front, behind = wall(1.0, 0.15), wall(2.0, 0.1)
    assert torch.equal(points_in_view(torch.cat([front, behind]), method).point, torch.arange(len(front)))


# Hidden point removal loses points near the silhouette of what is in front of them; the z-buffer does not.
@pytest.mark.parametrize(("method", "share"), [("zbuffer", 0.99), ("hidden_point_removal", 0.7)])
def test_beside_the_wall_the_background_is_seen(method, share, monkeypatch):
    monkeypatch.setattr(visibility, "RADIUS_FACTOR", 0.03)
    front, behind = wall(1.0, 0.1), wall(2.0, 0.6, step=0.04)
    visible = points_in_view(torch.cat([front, behind]), method, spacing=0.02)
    beside = behind[:, :2].abs().amax(1) > 0.3  # the wall's shadow reaches to 0.2 m
    hidden = behind[:, :2].abs().amax(1) < 0.15
    inside = (behind[:, 0].abs() < 1.0) & (behind[:, 1].abs() < 0.75)
    is_seen = torch.zeros(len(front) + len(behind), dtype=torch.bool)
    is_seen[visible.point] = True
    assert is_seen[len(front) :][beside & inside].float().mean() > share
    assert not is_seen[len(front) :][hidden].any()
    assert is_seen[: len(front)].all()


@pytest.mark.parametrize("method", METHODS)
def test_points_behind_beside_and_at_the_camera_are_not_seen(method):
    points = torch.cat([wall(1.0, 0.1), torch.tensor([[0.0, 0, 0], [0, 0, -1], [5, 0, 1]])])
    visible = points_in_view(points, method)
    assert visible.point.max() < len(points) - 3
    assert visible.row.min() >= 0
    assert visible.column.max() < SIZE[1]


@pytest.mark.parametrize("method", METHODS)
def test_nothing_in_view(method):
    assert points_in_view(torch.tensor([[0.0, 0, -1]]), method).point.numel() == 0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [1, 2, 4, 5])
def test_few_points(method, count):
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(0)) * 0.1 + torch.tensor([0.0, 0, 1])
    assert points_in_view(points, method, spacing=0.001).point.numel() >= 1


@pytest.mark.parametrize("method", METHODS)
def test_copies_of_a_point_are_all_seen(method):
    points = wall(1.0, 0.1).repeat(3, 1)
    assert points_in_view(points, method).point.numel() == len(points)


def test_points_on_a_plane_through_the_camera_are_not_lost():
    ticks = torch.linspace(-0.2, 0.2, 20)
    points = torch.stack([ticks, torch.zeros(20), 1 + ticks], dim=1)
    assert hidden_point_removal(points, torch.zeros(3, dtype=torch.float64), 0.1).any()


def test_pixels_are_the_nearest_to_the_projection():
    visible = points_in_view(wall(1.0, 0.2), "zbuffer")
    assert (visible.u - visible.column).abs().max() <= 0.5
    assert (visible.v - visible.row).abs().max() <= 0.5


def test_a_wider_footprint_closes_holes():
    sparse, behind = wall(1.0, 0.3, step=0.1), wall(2.0, 0.2)
    points = torch.cat([sparse, behind])
    spacing = torch.cat([torch.full((len(sparse),), 0.1), torch.full((len(behind),), 0.02)])
    hidden = [
        (visible_points(points, spacing, K, POSE, SIZE, config("zbuffer", footprint=f)).point >= len(sparse)).sum()
        for f in (0.1, 1.0)
    ]
    assert hidden[0] > 0.5 * len(behind)
    assert hidden[1] == 0
