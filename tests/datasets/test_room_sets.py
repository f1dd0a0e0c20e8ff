"""Rooms of data sets and of telephones: poses, cameras, depth, truth by hand; most look along y at a wall 2 m away."""

import shutil

import numpy as np
import pytest
import samples
import torch
from PIL import Image

import torchjoint as tj

FORMATS = ["replica", "arkitscenes", "record3d", "record3d_exr", "polycam", "scannetpp_iphone"]
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
    assert float((tj.load_scene(path, voxel_size=0.1).points[:, 1] - 2).abs().max()) < 0.2


@pytest.mark.parametrize(
    ("name", "file", "content", "message"),
    [
        ("replica", "traj.txt", "1 2 3\n", "line 1: expected 16 numbers, a pose, got 3"),
        ("replica", "traj.txt", "", "expected 2 poses, one for each image, got 0"),
        (
            "replica",
            "../cam_params.json",
            '{"camera": {"scale": 0}}',
            "scale: expected steps per metre, 1 to 1e6, got 0",
        ),
        ("replica", "../cam_params.json", "{}", "camera: missing"),
        ("arkitscenes", "40753679_frames/lowres_wide.traj", "1 2 3\n", "line 1: expected 7 numbers, got 3"),
        ("arkitscenes", "40753679_frames/lowres_wide.traj", "", "expected lines of 7 numbers, got none"),
        (
            "arkitscenes",
            "40753679_frames/lowres_wide.traj",
            "5 0 0 0 0 0 0\n",
            r"none of \d images has a pose within 0\.06 s \(lowres_wide\.traj\)",
        ),
        ("arkitscenes", "40753679_3dod_annotation.json", '{"data": [{}]}', "segments: missing"),
        ("polycam", "keyframes/corrected_cameras/10000000.json", "{}", "10000000.json: t_00: missing"),
        ("scannetpp_iphone", "iphone/pose_intrinsic_imu.json", "{}", "expected poses of frames, got none"),
        ("scannetpp", "scans/segments.json", '{"segIndices": [1]}', "expected the segments of 40 points, got 1"),
        ("s3dis", "Annotations/wall_1.txt", "1 2 3\n", r"wall_1.txt: expected lines of x y z r g b, .* \[1, 3\]"),
        ("s3dis", "Annotations/wall_1.txt", "", r"wall_1.txt: expected lines of x y z r g b"),
        ("s3dis", "Annotations/wall_1.txt", "1 2 3 0 0 256\n", r"colours 0 to 255"),
        ("s3dis", "Annotations/wall_1.txt", "1 2 nan 0 0 0\n", r"expected lines of x y z r g b"),
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


def test_the_time_of_depth_may_differ_in_the_last_digit(tmp_path):
    path = samples.write("arkitscenes", tmp_path / "a")
    depth = path / "40753679_frames" / "lowres_depth" / "40753679_6791.523.png"
    depth.rename(depth.with_name("40753679_6791.522.png"))
    assert tj.load_scene(path).frames[0].depth is not None


def test_uncorrected_frames_are_read_where_none_is_corrected(tmp_path):
    path = samples.write("polycam", tmp_path / "a")
    assert [frame.name for frame in tj.load_scene(path).frames] == ["9999999", "10000000"]
    shutil.rmtree(path / "keyframes" / "corrected_cameras")
    with pytest.warns(UserWarning, match=r"corrected_images: not read without .* the poses of cameras/ drift"):
        tj.load_scene(path)
    shutil.rmtree(path / "keyframes" / "corrected_images")
    assert [frame.name for frame in tj.load_scene(path).frames] == ["9999999", "10000000", "10000001"]


def test_depth_of_low_confidence_is_left_out(tmp_path):
    path = samples.write("polycam", tmp_path / "a")
    confidence = np.full((6, 8), 127, dtype=np.uint8)
    confidence[:3] = 0
    Image.fromarray(confidence).save(path / "keyframes" / "confidence" / "9999999.png")
    depth = tj.load_scene(path).frames[0].depth
    assert depth[:6].unique().tolist() == [0]
    assert depth[6:].unique().tolist() == [2]


class TestScannetpp:
    def test_the_smallest_object_of_a_vertex_wins(self, tmp_path):
        truth = tj.load_scene(samples.write("scannetpp", tmp_path / "a")).truth.points
        assert truth.tolist() == [1] * 5 + [2] * 5 + [1] * 10 + [3] * 10 + [-1] * 10

    def test_undistorted_images_have_their_own_camera(self, tmp_path):
        path = samples.write("scannetpp", tmp_path / "a")
        scene = tj.load_scene(path)
        assert scene.name == "1ada7a0617"
        assert [frame.name for frame in scene.frames] == ["DSC00", "DSC01"]
        assert scene.frames[1].intrinsics.tolist() == [[14, 0, 7.5], [0, 14, 5.5], [0, 0, 1]]
        pose = scene.frames[1].world_to_camera
        assert torch.allclose(pose[:3, :3], WORLD_TO_CAMERA)
        assert torch.allclose(pose[:3, 3], torch.tensor([-0.1, 0, 0]).double())
        shutil.rmtree(path / "dslr" / "resized_undistorted_images")
        fisheye = tj.load_scene(path).frames[1]
        assert torch.equal(fisheye.world_to_camera, pose)
        assert fisheye.intrinsics[0, 0] != 14

    def test_a_folder_chooses_the_camera(self, tmp_path):
        path = samples.write("scannetpp", tmp_path / "a")
        shutil.copytree(samples.write("scannetpp_iphone", tmp_path / "b") / "iphone", path / "iphone")
        assert tj.load_scene(path).frames[0].name == tj.load_scene(path / "dslr").frames[0].name == "DSC00"
        scene = tj.load_scene(path / "iphone")
        assert scene.frames[0].name == "frame_000000"
        assert scene.name == "1ada7a0617"
        assert scene.truth is not None
        shutil.copytree(path / "dslr" / "colmap", path / "iphone" / "colmap")
        with pytest.raises(FileNotFoundError, match=r"rgb: expected images that have poses, such as DSC00\.JPG"):
            tj.load_scene(path / "iphone")  # it has poses of its own now, which are better than those of ARKit

    def test_scenes_are_listed(self, tmp_path):
        path = samples.write("scannetpp", tmp_path / "a")
        assert tj.datasets.list_scenes(tmp_path / "a") == {"1ada7a0617": path}


class TestS3dis:
    def test_a_file_is_a_thing(self, tmp_path):
        scene = tj.load_scene(samples.write("s3dis", tmp_path / "a"))
        assert scene.truth.points.tolist() == [0] * 15 + [1] * 25
        assert torch.equal((scene.colors * 255).round(), torch.tensor([[i, 0.0, 255.0] for i in range(40)]))

    def test_rooms_are_listed(self, tmp_path):
        path = samples.write("s3dis", tmp_path / "a")
        assert tj.datasets.list_scenes(tmp_path / "a") == {"Area_1_office_1": path}
        assert tj.datasets.list_scenes(path.parent) == {"office_1": path}
