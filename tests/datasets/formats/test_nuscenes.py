"""Samples of nuScenes."""

import json

import numpy as np
import pytest
import samples
import torch
from lidar_scans import scan

import torchjoint as tj


@pytest.fixture
def folder(tmp_path):
    return samples.write("nuscenes", tmp_path / "sample")


def change(folder, edit):
    sample = json.loads((folder / "sample.json").read_text())
    edit(sample)
    (folder / "sample.json").write_text(json.dumps(sample))


def test_cameras_look_where_they_should(folder):
    np.pad(np.float32([[10, 0, 0], [10, 2, 1], [-5, 0, 0]]), ((0, 0), (0, 2))).astype("<f4").tofile(
        folder / "scan.pcd.bin"
    )
    scene = tj.load_scene(folder)
    assert scene.points.tolist() == [[10, 0, 0], [10, 2, 1], [-5, 0, 0]]
    assert [frame.name for frame in scene.frames] == ["CAM_FRONT", "CAM_BACK"]
    front, back = scene.frames
    camera = scene.points.double() @ front.world_to_camera[:3, :3].T + front.world_to_camera[:3, 3]
    expected = torch.tensor([[0, -0.3, 9.6], [-2, -1.3, 9.6], [0, -0.3, -5.4]], dtype=torch.float64)
    torch.testing.assert_close(camera, expected)
    assert (back.world_to_camera @ torch.tensor([-5.0, 0, 0, 1]).double())[2] == pytest.approx(4.6)
    assert front.intrinsics.tolist() == [[20, 0, 7.5], [0, 20, 5.5], [0, 0, 1]]


def test_boxes_are_centred_and_turn_about_z(folder):
    points = {
        (1 + 1.9 * np.cos(0.5), 2 + 1.9 * np.sin(0.5), 3): 0,  # 4 long
        (1 + 1.9 * np.cos(0.5), 2 - 1.9 * np.sin(0.5), 3): -1,
        (1 - 0.9 * np.sin(0.5), 2 + 0.9 * np.cos(0.5), 3): 0,  # 2 wide
        (1 - 1.1 * np.sin(0.5), 2 + 1.1 * np.cos(0.5), 3): -1,
        (1, 2, 3.4): 0,  # 1 high, half of it up
        (1, 2, 2.6): 0,
        (1, 2, 3.6): -1,
        (1, 2, 3.05): 1,  # in both
    }
    np.pad(np.float32(list(points)), ((0, 0), (0, 2))).astype("<f4").tofile(folder / "scan.pcd.bin")
    boxes = [{"bbox_3d": [1, 2, 3, 4, 2, 1, 0.5]}, {"bbox_3d": [1, 2, 3.05, 0.1, 0.1, 0.1, 0]}]
    change(folder, lambda sample: sample.update(instances=boxes))
    scene = tj.load_scene(folder)
    assert scene.truth.points.tolist() == list(points.values())
    assert len(scene.truth.images) == 0


def test_columns_that_are_not_plausible(folder):
    np.pad(scan()[0][-2000:].numpy(), ((0, 0), (0, 2))).tofile(folder / "scan.pcd.bin")
    assert len(tj.load_scene(folder).points) == 2000
    change(folder, lambda sample: sample["lidar"].update(num_pts_feats=4))
    with pytest.raises(ValueError, match=r"expected rows of 4 float32, but rows of 5 are .*nuScenes num_pts_feats"):
        tj.load_scene(folder)


def test_without_instances_there_is_no_truth(folder):
    change(folder, lambda sample: sample.pop("instances"))
    assert tj.load_scene(folder).truth is None
    change(folder, lambda sample: sample.update(instances=[]))
    assert tj.load_scene(folder).truth.points.unique().tolist() == [-1]


def test_images_are_read_when_they_are_asked_for(folder):
    (folder / "CAM_BACK.png").write_bytes(b"no image")
    scene = tj.load_scene(folder)
    assert scene.frames[0].size == (12, 16)
    with pytest.raises(ValueError, match=r"CAM_BACK\.png: not a whole image"):
        scene.frames[1]


@pytest.mark.parametrize("name", ["../outside.bin", "/etc/passwd", "a/../../b", "", "\0"])
@pytest.mark.parametrize("of", ["scan", "image"])
def test_paths_stay_in_the_folder(folder, name, of):
    def edit(sample):
        if of == "scan":
            sample["lidar"]["lidar_path"] = name
        else:
            sample["cameras"]["CAM_BACK"]["img_path"] = name

    change(folder, edit)
    with pytest.raises(
        ValueError, match=r"sample\.json: (lidar|cameras: CAM_BACK): expected a (path of a|file inside)"
    ):
        tj.load_scene(folder)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda s: s.pop("lidar"), "lidar: missing"),
        (lambda s: s["lidar"].update(num_pts_feats=2), "lidar: num_pts_feats: expected 3 to 7, got 2"),
        (lambda s: s["lidar"].update(num_pts_feats=4.5), "lidar: num_pts_feats: expected 3 to 7, got 4.5"),
        (lambda s: s["lidar"].update(num_pts_feats=7), "expected rows of 7 float32, 28 bytes each, got 800"),
        (lambda s: s.update(cameras=[]), "cameras: expected an object, got list"),
        (lambda s: s["cameras"].update(CAM_BACK=3), "cameras: CAM_BACK: expected an object, got 3"),
        (lambda s: s["cameras"]["CAM_BACK"].pop("cam2img"), "cameras: CAM_BACK: cam2img: missing"),
        (lambda s: s["cameras"]["CAM_BACK"].update(img_path="CAM_FRONT.png"), "frames: image '.*' is there twice"),
        (lambda s: s["cameras"]["CAM_BACK"].update(cam2img=[[1, 0, 0]]), "CAM_BACK: cam2img: expected shape"),
        (lambda s: s["cameras"]["CAM_BACK"].update(lidar2cam=[[1, 0, 0, 0]] * 4), "lidar2cam: expected a rigid"),
        (lambda s: s["instances"][1].update(bbox_3d=[1, 2]), r"instances\[1\]: bbox_3d: expected 7 numbers"),
        (lambda s: s["instances"][1]["bbox_3d"].__setitem__(3, 0), r"instances\[1\]: bbox_3d: expected lengths > 0"),
    ],
)
def test_bad_samples(folder, edit, message):
    change(folder, edit)
    with pytest.raises(ValueError, match=message):
        tj.load_scene(folder)


@pytest.mark.parametrize("file", ["scan.pcd.bin", "CAM_BACK.png"])
def test_missing_files(folder, file):
    (folder / file).unlink()
    with pytest.raises(FileNotFoundError, match=f"{file}: missing"):
        tj.load_scene(folder)


def test_the_real_sample_counts_as_nuscenes_does(shared):
    folder = shared / "data" / "nuscenes"
    scene = tj.load_scene(folder)
    assert (len(scene.points), len(scene.frames)) == (34_688, 6)
    expected = torch.tensor(
        [one["num_lidar_pts"] for one in json.loads((folder / "sample.json").read_text())["instances"]]
    )
    counts = torch.bincount(scene.truth.points + 1, minlength=len(expected) + 1)[1:]
    # Theirs were counted in boxes that overlap, and from poses of more digits.
    assert (counts == expected).sum() >= 60
    assert ((counts - expected).abs() <= (0.1 * expected).clamp(min=4)).all()
