"""BOP, YCB-Video, posed images and clouds alone: what is read from their samples."""

import json
import shutil

import pytest
import samples
import torch

import torchjoint as tj
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.results.exports.masks import export_coco


def load(name, tmp_path):
    path = samples.write(name, tmp_path / "sample")
    return path, tj.load_scene(path)


class TestBop:
    def test_frames_and_truth(self, tmp_path):
        _, scene = load("bop", tmp_path)
        assert [frame.name for frame in scene.frames] == ["000001", "000036"]
        assert torch.equal(scene.frames[1].world_to_camera[:3, 3], torch.tensor([-0.036, 0, 0], dtype=torch.float64))
        assert scene.frames[0].depth.unique().tolist() == [2.0]
        for labels in scene.truth.images:  # the same object is the same instance, in whatever order it is listed
            assert labels[4, 3] == 0
            assert labels[4, 12] == 1
            assert labels[0, 0] == -1

    def test_cameras_without_poses(self, tmp_path):
        path, _ = load("bop", tmp_path)
        cameras = json.loads((path / "scene_camera.json").read_text())
        for camera in cameras.values():
            del camera["cam_R_w2c"]
        (path / "scene_camera.json").write_text(json.dumps(cameras))
        with pytest.raises(ValueError, match=r"scene_camera\.json: 1: cam_R_w2c: missing; expected the poses"):
            tj.load_scene(path)
        (path / "scene_camera.json").write_text(json.dumps({"1": cameras["1"]}))
        assert torch.equal(tj.load_scene(path).frames[0].world_to_camera, torch.eye(4, dtype=torch.float64))

    def test_two_images_of_a_number(self, tmp_path):
        path, _ = load("bop", tmp_path)
        shutil.copy(path / "rgb" / "000036.png", path / "rgb" / "000036.jpg")
        with pytest.raises(ValueError, match="the colour image of frame '000036' is there twice"):
            tj.load_scene(path)

    def test_the_scenes_of_a_split(self, tmp_path):
        path, _ = load("bop", tmp_path)
        assert tj.datasets.list_scenes(path.parent) == {"000048": path}


class TestYcbVideo:
    def test_frames_and_truth(self, tmp_path):
        _, scene = load("ycb_video", tmp_path)
        assert [frame.name for frame in scene.frames] == ["000001", "000002"]
        for index, frame in enumerate(scene.frames, 1):  # the file's pose is the camera's place
            assert torch.allclose(frame.world_to_camera[:3, 3], torch.tensor([-0.1 * index, 0, 0]).double())
            assert frame.depth.unique().tolist() == [2.0]
        assert scene.truth.images[1][:, 0].unique().tolist() == [-1, 2, 20]

    def test_a_missing_matrix(self, tmp_path):
        from scipy.io import savemat

        path, _ = load("ycb_video", tmp_path)
        savemat(path / "000002-meta.mat", {"intrinsic_matrix": torch.eye(3).numpy()})
        with pytest.raises(ValueError, match=r"000002-meta\.mat: rotation_translation_matrix: expected .* got none"):
            tj.load_scene(path)


def test_two_sequences_of_ycb_video_in_one_folder(tmp_path):
    """Each has a world of its own."""
    path = samples.write("ycb_video", tmp_path / "a")
    for file in [*path.glob("0*")]:
        shutil.copy(file, path / f"0049-{file.name}")
        file.rename(path / f"0048-{file.name}")
    with pytest.raises(ValueError, match=r"is of no known format: it has 10 \.png files"):
        tj.load_scene(path)


def test_two_images_of_a_frame_of_ycb_video(tmp_path):
    path = samples.write("ycb_video", tmp_path / "a")
    (image,) = path.glob("000002-color.*")
    shutil.copy(image, image.with_suffix(".png" if image.suffix == ".jpg" else ".jpg"))
    with pytest.raises(ValueError, match="the colour image of frame '000002' is there twice"):
        tj.load_scene(path)


def test_posed_images(tmp_path):
    path, scene = load("posed_images", tmp_path)
    assert [frame.name for frame in scene.frames] == ["00000", "00001"]  # the third was lost
    assert scene.frames[0].depth.shape == (12, 16)
    assert scene.frames[0].depth.unique().tolist() == [2.0]
    assert scene.truth.points.tolist() == [index // 7 for index in range(20)]
    (path / "depth_intrinsic.txt").unlink()
    assert torch.equal(tj.load_scene(path).frames[0].depth, scene.frames[0].depth)


class TestCloudAlone:
    def test_is_a_scene_without_frames(self, tmp_path):
        _, scene = load("cloud_alone", tmp_path)
        assert (len(scene.points), len(scene.frames), scene.truth) == (40, 0, None)

    def test_can_be_segmented(self, tmp_path, run, scene_of):
        cloud = scene_of(2).scene
        write_cloud(tmp_path / "cloud.ply", cloud.points, cloud.colors)
        (tmp_path / "other.bin").write_bytes(b"changes nothing")
        run("segment", tmp_path / "cloud.ply", "-o", tmp_path / "out")
        result = tj.load_result(tmp_path / "out")
        expected = tj.JointSegmenter()(tj.load_scene(tmp_path / "cloud.ply"))
        assert torch.equal(result.points, expected.points)
        assert result.num_point_segments > 1
        assert len(result.images) == len(result.scene.frames) == 0
        with pytest.raises(ValueError, match="expected a result with images, got none"):
            export_coco(tmp_path / "x.json", result)
