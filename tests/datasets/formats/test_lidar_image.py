"""A LiDAR's cloud with an image."""

import json

import numpy as np
import pytest
import samples
import torch
from pcd_files import write_pcd
from scipy.spatial.transform import Rotation

import torchjoint as tj


@pytest.fixture
def folder(tmp_path):
    return samples.write("lidar_image", tmp_path / "sample")


def guess(folder, **values):
    (folder / "initial_guess.json").write_text(
        json.dumps(dict.fromkeys(["x", "y", "z", "r_deg", "p_deg", "y_deg"], 0) | values)
    )


def test_the_usual_guess_turns_a_lidar_s_axes_into_a_camera_s(folder):
    guess(folder, r_deg=90, y_deg=90, x=0.1, y=0.2, z=0.3)
    pose = tj.load_scene(folder).frames[0].world_to_camera
    forward, left, up = (pose[:3, :3] @ axis for axis in torch.eye(3, dtype=torch.float64))
    torch.testing.assert_close(
        torch.stack([forward, left, up]), torch.tensor([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]]).double()
    )
    assert pose[:3, 3].tolist() == [0.1, 0.2, 0.3]  # in the camera's frame


def test_angles_are_about_x_then_the_turned_y_then_the_turned_z(folder):
    guess(folder, r_deg=10, p_deg=-20, y_deg=30)
    expected = Rotation.from_euler("XYZ", [10, -20, 30], degrees=True).as_matrix()
    pose = tj.load_scene(folder).frames[0].world_to_camera
    np.testing.assert_allclose(pose[:3, :3].numpy(), expected, atol=1e-12)


def test_a_calibration_replaces_the_guess(folder):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [1, 2, 3]).as_matrix()
    pose[:3, 3] = 1, 2, 3
    np.savetxt(folder / "extrinsic.txt", pose)
    np.testing.assert_allclose(tj.load_scene(folder).frames[0].world_to_camera.numpy(), pose)
    (folder / "initial_guess.json").unlink()
    tj.load_scene(folder)
    (folder / "extrinsic.txt").unlink()
    with pytest.raises(FileNotFoundError, match=r"expected extrinsic\.txt or initial_guess\.json"):
        tj.load_scene(folder)


def test_points_without_a_return_are_left_out(folder):
    x = np.array([1, np.nan, 3], dtype=np.float32)
    rgb = np.array([0xFF0000, 0x00FF00, 0x0000FF], dtype=np.uint32)
    write_pcd(folder / "pointcloud.pcd", {"x": x, "y": x * 0, "z": x * 0 + 1, "rgb": rgb})
    scene = tj.load_scene(folder)
    assert scene.points.tolist() == [[1, 0, 1], [3, 0, 1]]
    assert scene.colors.tolist() == [[1, 0, 0], [0, 0, 1]]
    assert scene.truth is None


def test_beams_without_return_are_left_out(folder):
    x = np.array([1, 0, 3], dtype=np.float32)
    write_pcd(folder / "pointcloud.pcd", {"x": x, "y": x, "z": x})
    with pytest.warns(UserWarning, match=r"pointcloud\.pcd: 1 of 3 points are \(0, 0, 0\), beams without return"):
        assert tj.load_scene(folder).points[:, 0].tolist() == [1, 3]


def test_the_camera_of_another_size_or_lens(folder):
    values = json.loads((folder / "camera_info.json").read_text())
    height, width = tj.load_scene(folder).frames[0].size
    info = {"K": values["K"], "width": 2 * width, "height": 2 * height, "D": [], "distortion_model": ""}
    (folder / "camera_info.json").write_text(json.dumps(info))
    assert float(tj.load_scene(folder).frames[0].intrinsics[0, 0]) == values["K"][0] / 2
    fisheye = {"K": values["K"], "D": [0.3, 0, 0, 0], "distortion_model": "equidistant"}
    images = []
    for info in (fisheye, fisheye | {"distortion_model": "plumb_bob"}):
        (folder / "camera_info.json").write_text(json.dumps(info))
        images.append(tj.load_scene(folder).frames[0].image)
    assert images[0].shape != images[1].shape or not torch.equal(*images)


def test_a_lens_is_straightened(tmp_path):
    folder = samples.write("lidar_image_calibrated", tmp_path / "sample")
    bent = tj.load_scene(folder).frames[0]
    (folder / "camera_info.json").write_text(json.dumps({"K": [20.0, 0, 7.5, 0, 20, 5.5, 0, 0, 1], "D": [0, 0, 0, 0]}))
    straight = tj.load_scene(folder).frames[0]
    assert straight.intrinsics.tolist() == [[20, 0, 7.5], [0, 20, 5.5], [0, 0, 1]]
    assert not torch.equal(bent.image, straight.image)
    assert bent.intrinsics[0, 0] != 20


def test_jpeg_and_lazy_reading(folder):
    (folder / "image.png").rename(folder / "image.jpg")
    assert tj.load_scene(folder).frames[0].size == (12, 16)
    (folder / "image.jpg").write_bytes(b"no image")
    scene = tj.load_scene(folder)
    with pytest.raises(ValueError, match=r"image\.jpg: not a whole image"):
        scene.frames[0]
    (folder / "image.jpg").unlink()
    with pytest.raises(FileNotFoundError, match=r"expected image\.png or image\.jpg"):
        tj.load_scene(folder)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("camera_info.json", "{}", r"camera_info\.json: K: missing"),
        (
            "camera_info.json",
            '{"distortion_model": "fov"}',
            r"distortion_model: expected one of plumb_bob, rational_poly",
        ),
        ("camera_info.json", '{"K": [1, 2, 3]}', r"camera_info\.json: K: expected 9 numbers"),
        ("camera_info.json", '{"K": [0, 0, 0, 0, 0, 0, 0, 0, 0]}', "intrinsics of .*camera_info.json: expected"),
        ("camera_info.json", '{"K": [9, 0, 1, 0, 9, 1, 0, 0, 1], "D": [1]}', r"D: expected 4, 5 or 8 numbers"),
        ("camera_info.json", '{"K": [9, 0, 1, 0, 9, 1, 0, 0, 1], "width": 9}', "at least one pixel, got 9 x 0"),
        ("camera_info.json", '{"width": 9, "height": 9, "roi": {"height": 4, "width": 4}}', "roi: expected none, got"),
        ("initial_guess.json", '{"x": 1}', r"initial_guess\.json: y: missing"),
        ("initial_guess.json", "[]", r"initial_guess\.json: expected an object"),
        ("extrinsic.txt", "1 2 3", r"extrinsic\.txt: expected 4x4 = 16 numbers, got 3"),
        ("extrinsic.txt", "1 " * 16, r"extrinsic\.txt: expected a rigid transform"),
        ("pointcloud.pcd", "", r"pointcloud\.pcd: not a PCD file"),
    ],
)
def test_bad_files(folder, file, content, message):
    (folder / file).write_text(content)
    with pytest.raises(ValueError, match=message):
        tj.load_scene(folder)


def test_the_real_scan(shared):
    scene = tj.load_scene(shared / "data" / "vlp16")
    assert len(scene.points) == 30_143  # of 32,032, the others without a return
    frame = scene.frames[0]
    assert frame.size == (1080, 1920)
    # The guess is rough, but of the right hemisphere: what is ahead of the LiDAR is ahead of the camera.
    ahead = scene.points[scene.points[:, 0] > 1].double()
    assert ((ahead @ frame.world_to_camera[:3, :3].T)[:, 2] > 0).all()
