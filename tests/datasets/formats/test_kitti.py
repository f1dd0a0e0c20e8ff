"""KITTI's object frames."""

import numpy as np
import pytest
import samples
import torch

import torchjoint as tj
from torchjoint.scene.checks import as_pose

PROJECTION = np.array([[700.0, 0, 600, 45], [0, 690, 170, 0.2], [0, 0, 1, 0.003]])
RECTIFICATION = np.array([[0.99995, 0.01, 0.0], [-0.01, 0.99995, 0.0], [0, 0, 1]])
MOUNT = np.array([[0.0, -1, 0, 0.01], [0, 0, -1, -0.08], [1, 0, 0, -0.27]])  # x forward, y left, z up


@pytest.fixture
def scan(tmp_path):
    """The path of a scan in KITTI's folders."""
    return samples.write("kitti", tmp_path / "kitti")


def rewrite(scan, *, points=None, calibration=None, labels=None):
    root, name = scan.parent.parent, scan.stem
    if points is not None:
        np.pad(np.float32(points), ((0, 0), (0, 1))).astype("<f4").tofile(scan)
    if calibration is not None:
        lines = [f"{key}: {' '.join(map(repr, np.ravel(matrix).tolist()))}" for key, matrix in calibration.items()]
        (root / "calib" / f"{name}.txt").write_text("\n".join(lines) + "\n\n")
    if labels is not None:
        (root / "label_2" / f"{name}.txt").write_text(labels)


def box(height, width, length, x, y, z, yaw, kind="Car"):
    return f"{kind} 0.00 0 0.0 1.0 2.0 3.0 4.0 {height} {width} {length} {x} {y} {z} {yaw}\n"


def test_pixels_are_those_of_kitti_s_own_equation(scan):
    points = np.random.default_rng(0).uniform([5, -5, -2], [40, 5, 2], (50, 3))
    rewrite(scan, points=points, calibration={"P2": PROJECTION, "R0_rect": RECTIFICATION, "Tr_velo_to_cam": MOUNT})
    scene = tj.load_scene(scan)
    frame = scene.frames[0]
    exact, _, other = np.linalg.svd(RECTIFICATION)
    homogeneous = np.c_[np.float32(points), np.ones(50)].T
    expected = PROJECTION @ np.vstack([exact @ other @ MOUNT @ homogeneous, np.ones(50)])
    camera = frame.world_to_camera.numpy() @ homogeneous
    got = frame.intrinsics.numpy() @ camera[:3]
    np.testing.assert_allclose(got[:2] / got[2], expected[:2] / expected[2], atol=1e-6)
    np.testing.assert_allclose(camera[2], expected[2], atol=1e-9)  # depth is camera 2's
    rotation = frame.world_to_camera[:3, :3]
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3).double(), atol=1e-14, rtol=0)
    assert as_pose(frame.world_to_camera) is not None
    np.testing.assert_array_equal(scene.points.numpy(), np.float32(points))


def test_boxes_stand_on_their_place_and_turn_about_y(scan):
    # in the camera's axes: x right, y down, z forward; in the scan's: forward, left, up
    labels = box(2, 1, 4, 1, 1.5, 10, 0) + box(2, 1, 4, 1, 1.5, 30, 0.5) + "DontCare" + box(1, 1, 1, 0, 0, 5, 0)[3:]
    in_camera = {
        (2.9, 1.4, 10.4): 0,  # 4 long along x
        (2.9, 1.4, 10.6): -1,  # 1 wide along z
        (2.9, -0.4, 10.4): 0,  # 2 high: up is -y
        (2.9, -0.6, 10.4): -1,
        (2.9, 1.6, 10.4): -1,
        (1 + 1.8 * np.cos(0.5), 1, 30 - 1.8 * np.sin(0.5)): 1,  # positive yaw turns x away from z
        (1 + 1.8 * np.cos(0.5), 1, 30 + 1.8 * np.sin(0.5)): -1,
        (0, 0, 5): -1,  # DontCare
    }
    x, y, z = np.array(list(in_camera)).T
    eye = {"P2": np.eye(3, 4) * [[500], [500], [1]], "R0_rect": np.eye(3), "Tr_velo_to_cam": MOUNT * [1, 1, 1, 0]}
    rewrite(scan, points=np.c_[z, -x, -y], calibration=eye, labels=labels)
    assert tj.load_scene(scan).truth.points.tolist() == list(in_camera.values())


def test_scan_and_image_are_the_same_scene(scan, monkeypatch):
    image = scan.parent.parent / "image_2" / "000007.png"
    one, other = tj.load_scene(scan), tj.load_scene(image)
    assert torch.equal(one.points, other.points)
    monkeypatch.chdir(scan.parent)
    assert torch.equal(one.points, tj.load_scene("000007.bin").points)
    assert one.name == other.name == one.frames[0].name == "000007"
    assert one.frames[0].size == (12, 16)
    assert len(one.truth.images) == 0


def test_scenes(scan):
    root = scan.parent.parent
    for name in ("000003", "000010", "._000007"):
        (scan.parent / f"{name}.bin").write_bytes(scan.read_bytes())
    expected = {name: root / "velodyne" / f"{name}.bin" for name in ("000003", "000007", "000010")}
    for folder in (root, root.parent):
        assert tj.datasets.list_scenes(folder) == expected
        with pytest.raises(ValueError, match=r"is a data set; choose one of its scenes, such as .*000003"):
            tj.load_scene(folder)
    assert tj.datasets.list_scenes(scan) == {"000007": scan}


def test_without_labels_there_is_no_truth(scan):
    (scan.parent.parent / "label_2" / "000007.txt").unlink()
    assert tj.load_scene(scan).truth is None


def test_images_are_read_when_they_are_asked_for(scan):
    (scan.parent.parent / "image_2" / "000007.png").write_bytes(b"no image")
    scene = tj.load_scene(scan)
    with pytest.raises(ValueError, match=r"000007\.png: not a whole image"):
        scene.frames[0]


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("velodyne/000007.bin", bytes(100), r"000007\.bin: expected rows of 4 float32, 16 bytes each, got 100 bytes"),
        ("velodyne/000007.bin", b"", r"000007\.bin: expected rows of 4 float32"),
        ("velodyne/000007.bin", np.float32([1, 2, np.nan, 0]).tobytes(), r"000007\.bin: 1 of 1 points are NaN"),
        ("calib/000007.txt", b"P2: 1 2 3\n", r"calib/000007\.txt: line 1: expected 3x4 numbers, got 3"),
        ("calib/000007.txt", b"P0: 1 2 3\n", r"calib/000007\.txt: expected lines .* Tr_velo_to_cam missing"),
        ("calib/000007.txt", b"R0_rect: 2 0 0 0 2 0 0 0 2\n", r"000007\.txt: R0_rect: expected a rigid transform"),
        ("calib/000007.txt", 2 * b"R0_rect: 1 0 0 0 1 0 0 0 1\n", r"000007\.txt: line 'R0_rect' is there twice"),
        ("calib/000007.txt", b"R0_rect: a b c\n", r"000007\.txt: line 1: expected finite numbers, got 'a b c'"),
        ("label_2/000007.txt", b"Car 0 0 0 1 2 3 4 1 1 1\n", r"label_2/000007\.txt: line 1: expected a type and 14"),
        ("label_2/000007.txt", b"Car" + b" 0" * 14, r"000007\.txt: line 1: expected lengths > 0, and axes"),
        ("label_2/000007.txt", b"Car" + b" x" * 14, r"000007\.txt: line 1: expected finite numbers"),
    ],
)
def test_bad_files(scan, file, content, message):
    (scan.parent.parent / file).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        tj.load_scene(scan)


@pytest.mark.parametrize("file", ["image_2/000007.png", "calib/000007.txt"])
def test_missing_files(scan, file):
    (scan.parent.parent / file).unlink()
    with pytest.raises(FileNotFoundError, match=f"{file}: missing"):
        tj.load_scene(scan)


def test_a_skewed_projection_is_no_camera(scan):
    calibration = {"P2": np.zeros((3, 4)), "R0_rect": np.eye(3), "Tr_velo_to_cam": MOUNT}
    rewrite(scan, calibration=calibration)
    with pytest.raises(ValueError, match="P2, first three columns: expected"):
        tj.load_scene(scan)


class TestRealFrames:
    def boxes(self, shared, name):
        lines = (shared / "data" / "kitti" / "training" / "label_2" / f"{name}.txt").read_text().splitlines()
        return [np.array(line.split()[4:8], dtype=float) for line in lines if not line.startswith("DontCare")]

    def test_points_in_3d_boxes_are_seen_in_2d_boxes(self, shared):
        scenes = tj.datasets.list_scenes(shared / "data" / "kitti")
        assert len(scenes) == 6
        inside = []
        for name, path in scenes.items():
            scene = tj.load_scene(path)
            frame, boxes = scene.frames[0], self.boxes(shared, name)
            assert scene.truth.points.max() + 1 == len(boxes)
            for index, (left, top, right, bottom) in enumerate(boxes):
                points = scene.points[scene.truth.points == index].double()
                assert len(points) >= 5
                camera = points @ frame.world_to_camera[:3, :3].T + frame.world_to_camera[:3, 3]
                u, v = (camera[:, :2] / camera[:, 2:] * frame.intrinsics.diagonal()[:2] + frame.intrinsics[:2, 2]).T
                seen = (u > 0) & (u < frame.size[1] - 1) & (v > 0) & (v < frame.size[0] - 1)
                fits = (u > left - 2) & (u < right + 2) & (v > top - 2) & (v < bottom + 2)
                inside.append(float(fits[seen].float().mean()))
        # Some 3D boxes hold a few points of the neighbour.
        assert len(inside) == 32
        assert min(inside) > 0.8
        assert sum(share == 1 for share in inside) >= 27
