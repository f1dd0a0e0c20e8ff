"""Recordings in the layout of the TUM RGB-D benchmark."""

import shutil

import numpy as np
import pytest
import torch
from posed_files import assert_same_frames, assert_same_segmentation, eight_bits, quaternion_of, save_depth, save_image

import torchjoint as tj
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.datasets.formats import tum

START = 1305031102.0


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(3)


def write(folder, synthetic, *, cloud=True):
    """Images at 0, 1, 2... s; depth 12 ms later; poses there, and 10 ms before and after, of other places."""
    folder.mkdir()
    rgb, depth, poses = ["# color images"], ["# depth maps"], ["# timestamp tx ty tz qx qy qz qw"]
    for index, frame in enumerate(synthetic.scene.frames):
        time = START + index
        save_image(folder / "rgb" / f"{time:.6f}.png", frame.image)
        save_depth(folder / "depth" / f"{time + 0.012:.6f}.png", frame.depth, 5000)
        rgb.append(f"{time:.6f} rgb/{time:.6f}.png")
        depth.append(f"{time + 0.012:.6f} depth/{time + 0.012:.6f}.png")
        pose = np.linalg.inv(frame.world_to_camera.numpy())
        w, *xyz = quaternion_of(pose[:3, :3])
        for offset in (-0.01, 0.0, 0.01):
            position = pose[:3, 3] + 7 * offset
            poses.append(" ".join(f"{value:.12f}" for value in (time + offset, *position, *xyz, w)))
    (folder / "rgb.txt").write_text("\n".join(rgb) + "\n")
    (folder / "depth.txt").write_text("\n".join(depth) + "\n")
    (folder / "groundtruth.txt").write_text("\n".join(poses) + "\n")
    np.savetxt(folder / "camera-intrinsics.txt", synthetic.scene.frames[0].intrinsics.numpy())
    if cloud:
        write_cloud(folder / "cloud.ply", synthetic.scene.points, synthetic.scene.colors)
    return folder


@pytest.fixture
def folder(tmp_path, synthetic):
    return write(tmp_path / "recording", synthetic)


def test_a_recording_comes_back(folder, synthetic):
    scene, expected = tj.load_scene(folder), eight_bits(synthetic)
    assert_same_frames(scene.frames, expected.frames)
    assert [frame.name for frame in scene.frames[:2]] == ["1305031102.000000", "1305031103.000000"]
    for frame, other in zip(scene.frames, expected.frames, strict=True):
        torch.testing.assert_close(frame.depth, other.depth, atol=0.00011, rtol=0)
    assert_same_segmentation(scene, expected)


def test_two_poses_of_one_time_are_told(folder):
    file = folder / "groundtruth.txt"
    time, *numbers = (line := file.read_text().splitlines()[1]).split()
    file.write_text("\n".join((file.read_text(), line, " ".join((time, "0.5", *numbers[1:])))))
    with pytest.warns(
        UserWarning, match=r"groundtruth\.txt: lines of other numbers at the time of an earlier one.*: 1"
    ):
        tj.load_scene(folder)


def test_a_cloud_is_fused(tmp_path, synthetic):
    scene = tj.load_scene(write(tmp_path / "recording", synthetic, cloud=False), voxel_size=0.05)
    assert len(scene.points) > 1000
    assert torch.cdist(scene.points, synthetic.scene.points).amin(1).median() < 0.08


def test_frames_are_read_when_they_are_asked_for(folder):
    scene = tj.load_scene(folder)
    (folder / "rgb" / "1305031103.000000.png").write_bytes(b"no image")
    assert scene.frames[0].size == (120, 160)
    with pytest.raises(ValueError, match=r"1305031103\.000000\.png: not a whole image"):
        scene.frames[1]


class TestAssociation:
    @pytest.mark.parametrize(
        ("first", "second", "pairs"),
        [
            ([0, 1, 2], [0.01, 1.019, 2.021], [(0, 0), (1, 1)]),
            ([0, 0.030], [0.016], [(1, 0)]),  # the nearest pair first
            ([0.000, 0.033], [0.018, 0.051], [(1, 0)]),
            ([0.000, 0.033], [-0.016, 0.015], [(0, 1)]),
            ([0.000, 0.033], [0.014, 0.015, 0.019], [(0, 0), (1, 2)]),  # both would have others, too
            ([0, 1], [], []),
            ([], [0, 1], []),
            ([0.01, 0.02], [0.015], [(0, 0)]),  # equally near: the earlier
        ],
    )
    def test_by_hand(self, first, second, pairs):
        assert tum.associate(first, second) == pairs

    def test_as_the_pairs_of_all_with_all(self):
        rng = np.random.default_rng(0)
        first, second = (np.sort(np.arange(60) / 30 + rng.uniform(-0.01, 0.01, 60)) for _ in range(2))
        every = sorted(
            (abs(a - b), i, j) for i, a in enumerate(first) for j, b in enumerate(second) if abs(a - b) <= 0.02
        )
        pairs = {}
        for _, i, j in every:
            if i not in pairs and j not in pairs.values():
                pairs[i] = j
        assert tum.associate(first, second) == sorted(pairs.items())

    def test_an_image_needs_a_pose_but_no_depth(self, folder):
        lines = (folder / "depth.txt").read_text().splitlines()
        (folder / "depth.txt").write_text("\n".join(line for line in lines if "1105.0" not in line))
        lines = (folder / "groundtruth.txt").read_text().splitlines()
        (folder / "groundtruth.txt").write_text("\n".join(lines[4:]))  # tracking begins after the first image
        with pytest.warns(UserWarning, match="depth: 1 of 5 frames have no depth image"):
            frames = tj.load_scene(folder).frames
        assert [frame.name for frame in frames] == [f"{START + index:.6f}" for index in range(1, 6)]
        assert [frame.depth is None for frame in frames] == [False, False, True, False, False]

    def test_depth_is_optional(self, folder):
        (folder / "depth.txt").unlink()
        shutil.rmtree(folder / "depth")
        assert all(frame.depth is None for frame in tj.load_scene(folder).frames)

    def test_no_image_with_a_pose(self, folder):
        (folder / "groundtruth.txt").write_text("5 0 0 0 0 0 0 1\n6 0 0 0 0 0 0 1\n")
        with pytest.raises(ValueError, match=r"none of 6 images has a pose within 0\.02 s \(groundtruth\.txt\)"):
            tj.load_scene(folder)


class TestPoses:
    def load(self, folder, text):
        (folder / "groundtruth.txt").write_text(text)
        return tj.load_scene(folder).frames[0].world_to_camera

    def test_between_two(self, folder):
        # A quarter of the way from the identity to 90 degrees about z, and from (0, 0, 0) to (4, 0, 8).
        lines = f"{START - 0.01} 0 0 0 0 0 0 1\n{START + 0.03} 4 0 8 0 0 {0.5**0.5} {0.5**0.5}\n"
        pose = torch.linalg.inv(self.load(folder, lines))
        angle = np.radians(22.5)
        expected = [
            [np.cos(angle), -np.sin(angle), 0, 1],
            [np.sin(angle), np.cos(angle), 0, 0],
            [0, 0, 1, 2],
            [0, 0, 0, 1],
        ]
        torch.testing.assert_close(pose, torch.tensor(expected), atol=1e-4, rtol=0)  # the times have 6 digits

    def test_the_shorter_way(self, folder):
        # The same rotation has two quaternions: between q and -q there is nothing to turn.
        lines = (
            f"{START - 0.01} 0 0 0 0 0 {0.5**0.5} {0.5**0.5}\n{START + 0.01} 0 0 0 0 0 {-(0.5**0.5)} {-(0.5**0.5)}\n"
        )
        expected = [[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        torch.testing.assert_close(self.load(folder, lines), torch.tensor(expected, dtype=torch.float64))

    def test_after_the_last_and_only_one(self, folder):
        assert self.load(folder, f"{START - 0.015} 1 2 3 0 0 0 1\n")[:3, 3].tolist() == [-1, -2, -3]

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", r"groundtruth\.txt: expected lines of timestamp tx ty tz qx qy qz qw, got none"),
            ("1 2 3 4 0 0 1\n", r"groundtruth\.txt: line 1: expected timestamp tx ty tz qx qy qz qw, got 7 numbers"),
            ("# x\n1 2 3 4 0 0 0 nan\n", r"groundtruth\.txt: line 2: expected finite numbers, got '1 2 3 4 0 0 0 nan'"),
            (f"{START} 1 2 3 0 0 0 0.5\n", r"groundtruth\.txt: expected unit quaternions, got 1 others"),
        ],
    )
    def test_bad_lines(self, folder, text, message):
        with pytest.raises(ValueError, match=message):
            self.load(folder, text)


class TestCalibration:
    def load(self, folder, name):
        (folder / "camera-intrinsics.txt").unlink()
        shutil.move(folder, folder.with_name(name))
        return tj.load_scene(folder.with_name(name)).frames[0]

    def test_freiburg3(self, folder):
        # Published for 640 x 480; the images are a quarter of it.
        frame = self.load(folder, "rgbd_dataset_freiburg3_long_office_household")
        expected = [[535.4 / 4, 0, 320.6 / 4 - 0.5], [0, 539.2 / 4, 248.1 / 4 - 0.5], [0, 0, 1]]
        torch.testing.assert_close(frame.intrinsics, torch.tensor(expected, dtype=torch.float64))

    def test_freiburg1_is_undistorted(self, folder):
        # ROS's rectified camera of this calibration: 546.02 542.21 319.71 251.37, of another crop by some pixels.
        frame = self.load(folder, "fr1_desk")
        rectified = torch.tensor([546.02, 542.21]) / 4
        torch.testing.assert_close(frame.intrinsics.diagonal()[:2].float(), rectified, atol=0.5, rtol=0)
        assert frame.depth.shape == (120, 160)

    def test_another_name_is_refused(self, folder):
        told = (
            r"mine: expected camera-intrinsics\.txt with fx 0 cx, .*, or a name of the TUM benchmark .*, found neither"
        )
        with pytest.raises(ValueError, match=told):
            self.load(folder, "mine")

    def test_the_name_of_a_folder_above(self, folder):
        (folder / "camera-intrinsics.txt").unlink()
        inside = shutil.copytree(folder, folder.with_name("fr3_desk") / "mine")
        assert float(tj.load_scene(inside).frames[0].intrinsics[0, 0]) == 535.4 / 4

    def test_a_matrix_that_is_none(self, folder):
        (folder / "camera-intrinsics.txt").write_text("0 0 0 0 0 0 0 0 0")
        with pytest.raises(ValueError, match=r"intrinsics of .*camera-intrinsics\.txt: expected \[\[fx"):
            tj.load_scene(folder)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("1305031102.0\n", ValueError, r"rgb\.txt: line 1: expected a timestamp and a path, got '1305031102\.0'"),
        ("noon rgb/a.png\n", ValueError, r"rgb\.txt: line 1: expected finite numbers, got 'noon'"),
        ("1305031102.0 ../a.png\n", ValueError, r"rgb\.txt: line 1: expected a file inside"),
        ("1305031102.0 rgb/a.png\n", FileNotFoundError, r"rgb/a\.png: missing; expected the image that rgb"),
    ],
)
def test_bad_lists(folder, text, error, message):
    (folder / "rgb.txt").write_text(text)
    with pytest.raises(error, match=message):
        tj.load_scene(folder)


def test_a_name_with_a_space(folder):
    time, name = (folder / "rgb.txt").read_text().splitlines()[-1].split()
    (folder / name).rename(folder / "rgb" / "an image.png")
    (folder / "rgb.txt").write_text(f"{time} rgb/an image.png\n")
    assert tj.load_scene(folder).frames.names == ["an image"]
