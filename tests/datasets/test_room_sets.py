"""Replica and ARKitScenes: poses, cameras, depth and truth by hand; both samples look along y at a wall 2 m away."""

import pytest
import samples
import torch

import torchjoint as tj

FORMATS = ["replica", "arkitscenes"]
WORLD_TO_CAMERA = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=torch.float64)


@pytest.mark.parametrize("name", FORMATS)
def test_frames_see_the_wall(tmp_path, name):
    scene = tj.load_scene(samples.write(name, tmp_path / name))
    assert len(scene.frames) == 2
    for index, frame in enumerate(scene.frames):
        assert torch.allclose(frame.world_to_camera[:3, :3], WORLD_TO_CAMERA, atol=1e-6)
        center = -frame.world_to_camera[:3, :3].T @ frame.world_to_camera[:3, 3]
        assert torch.allclose(center, torch.tensor([0.1 * index, 0, 0]).double(), atol=1e-6)
        assert frame.intrinsics.tolist() == [[14, 0, 7.5], [0, 14, 5.5], [0, 0, 1]]
        assert torch.allclose(frame.depth, torch.full_like(frame.depth, 2.0), atol=1e-4)
        in_camera = scene.points.double() @ frame.world_to_camera[:3, :3].T + frame.world_to_camera[:3, 3]
        assert bool(((in_camera[:, 2] > 1.8) & (in_camera[:, 2] < 2.2)).all())


def test_a_point_in_a_turned_box_belongs_to_it(tmp_path):
    scene = tj.load_scene(samples.write("arkitscenes", tmp_path / "a"))
    x, y, z = scene.points.double().unbind(1)
    # The rows of the box's axes: (cos 30, -sin 30), (sin 30, cos 30).
    a, b = 3**0.5 / 2 * (x - 0.5) - 0.5 * (y - 2), 0.5 * (x - 0.5) + 3**0.5 / 2 * (y - 2)
    inside = (a.abs() <= 0.5) & (b.abs() <= 0.5) & (z.abs() <= 1)
    assert 0 < int(inside.sum()) < len(inside)
    assert torch.equal(scene.truth.points, torch.where(inside, 0, -1))


def test_without_a_mesh_a_cloud_is_fused(tmp_path):
    path = samples.write("replica", tmp_path / "a")
    (path.parent / "room0_mesh.ply").unlink()
    (path.parent / "cam_params.json").rename(path / "cam_params.json")
    scene = tj.load_scene(path, voxel_size=0.1)
    assert float((scene.points[:, 1] - 2).abs().max()) < 0.2


@pytest.mark.parametrize(
    ("name", "file", "content", "message"),
    [
        ("replica", "traj.txt", "1 2 3\n", "line 1: expected 16 numbers, a pose, got 3"),
        ("replica", "traj.txt", "", "expected 2 poses, one for each image, got 0"),
        ("replica", "../cam_params.json", '{"camera": {"scale": 0}}', "scale: expected steps per metre, > 0, got 0"),
        ("replica", "../cam_params.json", "{}", "camera: missing"),
        ("arkitscenes", "40753679_frames/lowres_wide.traj", "1 2 3\n", "line 1: expected 7 numbers, got 3"),
        ("arkitscenes", "40753679_frames/lowres_wide.traj", "", "expected lines of 7 numbers, got none"),
        (
            "arkitscenes",
            "40753679_frames/lowres_wide.traj",
            "5 0 0 0 0 0 0\n",
            r"no image has a pose in .* within 0\.06 s",
        ),
        ("arkitscenes", "40753679_3dod_annotation.json", '{"data": [{}]}', "segments: missing"),
    ],
)
def test_damaged_files(tmp_path, name, file, content, message):
    path = samples.write(name, tmp_path / name)
    (path / file).write_text(content)
    with pytest.raises(ValueError, match=message):
        tj.load_scene(path)


def test_a_camera_may_be_missing(tmp_path):
    path = samples.write("arkitscenes", tmp_path / "a")
    for file in (path / "40753679_frames" / "lowres_wide_intrinsics").iterdir():
        file.unlink()
    with pytest.raises(FileNotFoundError, match=r"40753679_6791\.523\.pincam: missing"):
        _ = tj.load_scene(path).frames[0].intrinsics
