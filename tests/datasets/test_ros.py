"""ROS recordings: topics found by type, times matched, poses of tf and odometry; ROS 1 and 2 give the same."""

import numpy as np
import pytest
import samples
import torch
from rosbags.rosbag2 import StoragePlugin
from samples import ros
from samples._parts import wall

import torchjoint as tj


@pytest.mark.parametrize("name", ["ros", "ros_one"])
def test_images_with_depth(name, tmp_path):
    scene = tj.load_scene(samples.write(name, tmp_path / name), cloud=tmp_path / "cloud.ply", voxel_size=0.1)
    assert [frame.name for frame in scene.frames] == ["1700000000.004000", "1700000000.104000"]
    for index, frame in enumerate(scene.frames):
        assert torch.equal(frame.image, torch.from_numpy(ros.colors(index)[..., ::-1].copy()).permute(2, 0, 1) / 255)
        assert frame.depth.unique().tolist() == [2.0]
        assert frame.intrinsics[0].tolist() == [12, 0, 7.5]
    # 4 ms after the first transform of two that are 100 ms and 1 m apart; the second is the last, and is kept.
    centers = [-(frame.world_to_camera[:3, :3].T @ frame.world_to_camera[:3, 3]) for frame in scene.frames]
    torch.testing.assert_close(
        torch.stack(centers), torch.tensor([[0.04, 0, 0.5], [1, 0, 0.5]]).double(), atol=1e-5, rtol=0
    )


@pytest.mark.parametrize("storage", StoragePlugin)
def test_a_file_of_ros_2_without_its_folder(storage, tmp_path):
    """A .mcap and a .db3 say themselves which topics they have, and of which types."""
    folder = ros.record(tmp_path / "walk", ros.messages(), storage)
    (file,) = (one for one in folder.iterdir() if one.suffix in (".mcap", ".db3"))
    alone = tmp_path / "alone" / f"walk{file.suffix}"
    alone.parent.mkdir()
    file.rename(alone)
    scene = tj.load_scene(alone, cloud=tmp_path / "cloud.ply", voxel_size=0.1)
    assert [frame.name for frame in scene.frames] == ["1700000000.004000", "1700000000.104000"]
    assert torch.equal(scene.frames[1].image, torch.from_numpy(ros.colors(1)[..., ::-1].copy()).permute(2, 0, 1) / 255)


def test_scans_and_odometry(tmp_path):
    bag = samples.write("ros_points", tmp_path / "bag")
    scene = tj.load_scene(bag, voxel_size=1e-4)
    expected = np.concatenate([wall(), wall() + np.array([1, 0, 0])])
    assert len(scene.points) == len(expected)
    assert torch.cdist(scene.points.double(), torch.from_numpy(expected)).amin(0).max() < 1e-5
    assert len(tj.load_scene(bag, fuse=False).points) == 1
    torch.testing.assert_close(scene.colors[0], torch.tensor([1, 128 / 255, 0]))
    assert [frame.world_to_camera[0, 3].item() for frame in scene.frames] == [0, -1]


def test_ambiguous_topics_are_chosen(tmp_path):
    messages = list(ros.messages())
    other = [("/rear/image_raw", time, message) for topic, time, message in messages if topic == "/camera/image_raw"]
    bag = ros.record(tmp_path / "two", [*messages, *other])
    with pytest.raises(
        ValueError, match=r"2 topics could be color; choose: --topics color=/camera/image_raw, or /rear"
    ):
        tj.load_scene(bag)
    with pytest.raises(ValueError, match=r"topics: color: .* has no messages of /front; it has /camera"):
        tj.load_scene(bag, topics={"color": "/front"})
    with pytest.raises(ValueError, match=r"topics: expected some of color, info, depth, points, odometry, got colour"):
        tj.load_scene(bag, topics={"colour": "/rear/image_raw"})
    assert len(tj.load_scene(bag, topics={"color": "/rear/image_raw"}, voxel_size=0.1).frames) == 2


def test_images_far_from_any_pose_are_left_out_and_told(tmp_path):
    late = ("/camera/image_raw", 3.0, ros.image(3.0, ros.colors(2), "bgr8"))
    bag = ros.record(tmp_path / "late", [*ros.messages(), late])
    with pytest.warns(UserWarning, match=r"1 of 3 images have no pose within 0\.02 s, and are left out"):
        assert len(tj.load_scene(bag, voxel_size=0.1).frames) == 2
    bag = ros.record(tmp_path / "never", [*[one for one in ros.messages() if one[0] != "/camera/image_raw"], late])
    with pytest.raises(ValueError, match=r"none of 1 images has a pose within 0\.02 s"):
        tj.load_scene(bag)


def test_what_is_no_recording_of_a_camera(tmp_path):
    bag = ros.record(tmp_path / "tf", [one for one in ros.messages() if one[0] == "/tf"])
    with pytest.raises(ValueError, match="expected colour images, got topics /tf"):
        tj.load_scene(bag)
