"""ROS recordings: topics found by type, times matched, poses of tf and odometry; ROS 1 and 2 give the same."""

import copy
import io
import pickle
import struct
import warnings
from contextlib import nullcontext

import numpy as np
import pytest
import samples
import torch
from PIL import Image
from rosbags.rosbag2 import StoragePlugin
from samples import ros, ros_points
from samples._parts import wall

import torchjoint as tj
from torchjoint.datasets.files.ros_messages import color_image, depth_image


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


def test_frames_go_to_other_processes(tmp_path):
    """As those of files do: workers of a data loader that are spawned get them pickled."""
    frames = tj.load_scene(ros.record(tmp_path / "walk", ros.messages()), fuse=False).frames
    for other in (pickle.loads(pickle.dumps(frames)), copy.deepcopy(frames)):
        assert torch.equal(other[1].image, frames[1].image)
        assert torch.equal(other[1].depth, frames[1].depth)


def test_a_clock_that_was_set_back_is_told(tmp_path):
    """The images after it would take the depth and the poses of those before it."""
    messages = [*ros.messages(), ("/camera/image_raw", 3.0, ros.image(3.0, ros.colors(0), "bgr8"))]
    later = [("/camera/image_raw", 3.1, ros.image(0.048, ros.colors(1), "bgr8"))]
    told = "/camera/image_raw: the time of the headers goes back by 3.0 s between two messages: images, depth and poses"
    with pytest.warns(UserWarning, match=told):
        tj.load_scene(ros.record(tmp_path / "walk", messages + later), fuse=False)


def test_depth_by_another_clock_is_told(tmp_path):
    """A cloud beside it would be segmented without depth."""
    messages = list(ros.messages())
    for one in (one for topic, _, one in messages if topic == "/camera/aligned_depth"):
        one.header.stamp.sec += 5
    with pytest.warns(UserWarning, match="/camera/aligned_depth: 2 of 2 images have no image of /camera/image_raw wi"):
        assert tj.load_scene(ros.record(tmp_path / "walk", messages), fuse=False).frames[0].depth is None


def test_scans_and_odometry(tmp_path):
    bag = samples.write("ros_points", tmp_path / "bag")
    scene = tj.load_scene(bag, voxel_size=1e-4)
    expected = np.concatenate([wall(), wall() + np.array([1, 0, 0])])
    assert len(scene.points) == len(expected)
    assert torch.cdist(scene.points.double(), torch.from_numpy(expected)).amin(0).max() < 1e-5
    assert len(tj.load_scene(bag, fuse=False).points) == 1
    torch.testing.assert_close(scene.colors[0], torch.tensor([1, 128 / 255, 0]))
    assert [frame.world_to_camera[0, 3].item() for frame in scene.frames] == [0, -1]


@pytest.mark.parametrize("is_chosen", [False, True])
def test_depth_of_another_frame_is_told(is_chosen, tmp_path):
    """Depth that is not registered to colour is not used by itself, and never silently."""
    messages = list(ros.messages())
    for topic, _, message in messages:
        if topic == "/camera/aligned_depth":
            message.header.frame_id = "depth_optical"
    bag, topics = ros.record(tmp_path / "bag", messages), {"depth": "/camera/aligned_depth"} if is_chosen else {}
    told = "/camera/aligned_depth: depth of frame 'depth_optical', not of the images' 'camera_optical': register it"
    with pytest.warns(UserWarning, match=told):
        frames = tj.load_scene(bag, topics=topics, fuse=False).frames
    assert (frames[0].depth is not None) == is_chosen


@pytest.mark.parametrize("is_packed", [False, True])
@pytest.mark.parametrize("is_chosen", [False, True])
def test_grey_of_16_bits_may_be_infrared(is_chosen, is_packed, tmp_path):
    """By REP 118 depth is 16UC1 or 32FC1, but some drivers say mono16."""
    messages, topic = list(ros.messages()), "/camera/aligned_depth"
    if is_packed:
        depth = packed(np.full((ros.HEIGHT, ros.WIDTH), 2000, np.uint16), "mono16; png compressed ")
        messages = [*of(messages, topic), (topic, 0.1, depth)]
    else:
        for message in (one for name, _, one in messages if name == topic):
            message.encoding = "mono16"
    bag, topics = ros.record(tmp_path / "bag", messages), {"depth": topic} if is_chosen else {}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        frames = tj.load_scene(bag, topics=topics, fuse=False).frames
    assert ["mono16, taken as depth in millimetres" in str(one.message) for one in caught] == [True] * (not is_chosen)
    assert frames[0].depth.unique().tolist() == [2]


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


def of(messages, *topics):
    return [one for one in messages if one[0] not in topics]


def pose_stamped(seconds, x):
    types = ros.TYPES
    place, turn = (types[f"geometry_msgs/msg/{name}"] for name in ("Point", "Quaternion"))
    pose = types["geometry_msgs/msg/Pose"](place(float(x), 0.0, 0.0), turn(0.0, 0.0, 0.0, 1.0))
    return types["geometry_msgs/msg/PoseStamped"](ros.header(seconds, "map"), pose)


def path_of(poses):
    return ros.TYPES["nav_msgs/msg/Path"](ros.header(0.0, "map"), poses)


@pytest.mark.parametrize("kind", ["PoseStamped", "TransformStamped", "Path"])
def test_poses_of_other_topics(kind, tmp_path):
    """Of the body to which tf_static fixes the camera, half a metre below it."""
    poses = [pose_stamped(seconds, index) for index, seconds in enumerate((0.0, 0.1))]
    if kind == "TransformStamped":
        sent = [ros.transforms(0.1 * index, "map", "base", (index, 0, 0)).transforms[0] for index in range(2)]
    else:
        sent = poses if kind == "PoseStamped" else [path_of(poses[:1]), path_of(poses)]
    messages = [*of(ros.messages(), "/tf"), *(("/pose", 0.1 * index, one) for index, one in enumerate(sent))]
    bag = ros.record(tmp_path / "walk", messages)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        scene = tj.load_scene(bag, voxel_size=0.1)
    assert [str(one.message) for one in told if issubclass(one.category, UserWarning)] == [
        f"{bag}: the poses of /pose are taken as those of frame base"
    ] * (kind != "TransformStamped")
    centers = [-frame.world_to_camera[:3, 3] for frame in scene.frames]
    torch.testing.assert_close(
        torch.stack(centers), torch.tensor([[0.04, 0, 0.5], [1, 0, 0.5]]).double(), atol=1e-5, rtol=0
    )


def test_a_camera_without_poses_does_not_stand_still(tmp_path):
    bag = ros.record(tmp_path / "none", of(ros.messages(), "/tf", "/tf_static"))
    with pytest.raises(ValueError, match=r"expected poses of the camera, frame 'camera_optical', in tf, or as"):
        tj.load_scene(bag, voxel_size=0.1)
    scene = tj.load_scene(bag, topics={"odometry": "none"}, voxel_size=0.1)
    assert [frame.world_to_camera.tolist() for frame in scene.frames] == [np.eye(4).tolist()] * 2
    bag = ros.record(tmp_path / "fixed", of(ros.messages(), "/tf"))
    with pytest.warns(UserWarning, match=r"the camera, frame 'camera_optical', stands still in frame 'base';"):
        tj.load_scene(bag, voxel_size=0.1)


@pytest.mark.parametrize("turned", [0.001, 0.3])
@pytest.mark.parametrize("root", ["base", "footprint"])
def test_joints_of_a_robot_are_not_its_place(turned, root, tmp_path):
    """tf has a moving head, or the noise of one that rests, and does not move the base that the odometry places."""
    sent = of(ros.messages(), "/tf", "/tf_static")
    sent += [("/tf_static", 0.0, ros.transforms(0.0, "footprint", "base", (0, 0, 0.2)))] * (root == "footprint")
    for index in range(2):
        sent.append(("/odom", 0.1 * index, ros_points.odometry(0.1 * index, (index, 0, 0))))
        head = ros.transforms(0.1 * index, "base", "camera_optical", (0, 0, 0.5 + turned * index))
        sent.append(("/tf", 0.1 * index, head))
    frames = tj.load_scene(ros.record(tmp_path / "walk", sent), fuse=False).frames
    assert [round(-frame.world_to_camera[0, 3].item(), 2) for frame in frames] == [0.04, 1]


def moving_head(root="base"):
    """Six images of a camera that tf moves on a robot."""
    for index in range(6):
        at = 0.1 * index
        yield "/camera/camera_info", at, ros.camera_info(at)
        yield "/camera/image_raw", at, ros.image(at, ros.colors(index), "bgr8")
        yield "/tf", at, ros.transforms(at, root, "camera_optical", (0, 0, 0.5 + at))


@pytest.mark.parametrize("child", [None, "", "other"])
def test_poses_of_a_robot_with_a_moving_head_are_told(child, tmp_path):
    """They do not say what they place, or it is not known to tf: the robot would stand still in silence."""
    sent = [*moving_head()]
    for index in range(6):
        one = pose_stamped(0.1 * index, index) if child is None else ros_points.odometry(0.1 * index, (index, 0, 0))
        one.child_frame_id = child  # a PoseStamped has none
        sent.append(("/pose", 0.1 * index, one))
    bag = ros.record(tmp_path / "walk", sent)
    with pytest.warns(UserWarning, match="/pose: not used, as tf moves the camera in 'base'; if that is a robot which"):
        frames = tj.load_scene(bag, fuse=False).frames
    assert [frame.world_to_camera[0, 3].item() for frame in frames] == [0] * 6
    if child == "other":
        with pytest.raises(ValueError, match="/pose: expected poses of a frame that carries 'camera_optical' accordi"):
            tj.load_scene(bag, fuse=False, topics={"odometry": "/pose"})
    else:
        with pytest.warns(UserWarning, match="are taken as those of frame base") if child is None else nullcontext():
            frames = tj.load_scene(bag, fuse=False, topics={"odometry": "/pose"}).frames
        assert [-frame.world_to_camera[0, 3].item() for frame in frames] == [0, 1, 2, 3, 4, 5]


def test_odometry_beside_the_camera_is_refused(tmp_path):
    """tf fixes its frame to the robot, but not above the camera: it would have no effect."""
    sent = [("/tf_static", 0.0, ros.transforms(0.0, "base", "imu", (0, 0.2, 0))), *moving_head()]
    for index in range(6):
        one = ros_points.odometry(0.1 * index, (index, 0, 0))
        one.child_frame_id = "imu"
        sent.append(("/odom", 0.1 * index, one))
    with pytest.raises(ValueError, match="/odom: expected poses of a frame that carries 'camera_optical' according to"):
        tj.load_scene(ros.record(tmp_path / "walk", sent), fuse=False)


@pytest.mark.parametrize(("apart", "rates"), [(0.5, (20, 20)), (0.5, (10, 40)), (0, (20, 20)), (0.5, (40, 0))])
def test_two_nodes_that_place_one_frame_are_told(apart, rates, tmp_path):
    """Poses between the two are of neither. Motion there and back, as of a hand that shakes, is none of it."""
    sent = [one for one in moving_head("base") if one[0] != "/tf"]
    sent.append(("/tf_static", 0.0, ros.transforms(0.0, "base", "camera_optical", (0, 0, 0.5))))
    for which, rate in enumerate(rates):
        for at in np.arange(0.003 * which, 0.6, 1 / rate if rate else 1):
            shake = 0.03 * np.sin(2 * np.pi * 5 * at)
            place = (which * apart + at / 2, shake, 0)
            sent.append(("/tf", at, ros.transforms(at, "odom", "base", place)))
    told = r"frame 'base' jumps to and fro: do two nodes move it\?"
    with pytest.warns(UserWarning, match=told) if apart and all(rates) else nullcontext():
        tj.load_scene(ros.record(tmp_path / "walk", sorted(sent, key=lambda one: one[1])), fuse=False, time_limit=0.06)


def test_two_places_at_one_time_are_told(tmp_path):
    """As of wheels and of a filter that takes their times: the first one recorded counts."""
    sent = [*ros.messages()]
    sent += [
        ("/tf", at + 0.001, ros.transforms(at, "odom", "base", (5 + index, 0, 0))) for index, at in ((0, 0), (1, 0.1))
    ]
    with pytest.warns(UserWarning, match="tf places frame 'base' in 2 ways: .*, else the first of a time"):
        frames = tj.load_scene(ros.record(tmp_path / "walk", sorted(sent, key=lambda one: one[1])), fuse=False).frames
    assert [round(-frame.world_to_camera[0, 3].item(), 2) for frame in frames] == [0.04, 1]


@pytest.mark.parametrize("sign", [1, -1])
def test_a_quaternion_and_its_negative_are_one(sign, tmp_path):
    """Of a fixed frame this is no other transform; of one that is told again and again, no motion."""
    turn = np.array([0.5, -0.5, 0.5, 0.5])
    again = [("/tf_static", 1.0, ros.transforms(1.0, "base", "camera_optical", (0, 0, 0.5), sign * turn))]
    first = [("/tf_static", 0.0, ros.transforms(0.0, "base", "camera_optical", (0, 0, 0.5), turn))]
    sent = [*first, *of(ros.messages(), "/tf_static"), *again]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tj.load_scene(ros.record(tmp_path / "walk", sent), fuse=False)


def test_a_camera_that_zooms_is_told(tmp_path):
    messages = list(ros.messages())
    [one for topic, _, one in messages if topic == "/camera/camera_info"][1].k[0] = 24.0
    with pytest.warns(UserWarning, match="/camera/camera_info: 1 of 2 messages have another camera than the first"):
        tj.load_scene(ros.record(tmp_path / "walk", messages), voxel_size=0.1)


def test_the_latest_transform_of_a_fixed_frame_counts(tmp_path):
    """All frames before have that pose, too, which must not be silent."""
    again = [("/tf_static", 1.0, ros.transforms(1.0, "base", "camera_optical", (0, 0, 0.7)))]
    with pytest.warns(
        UserWarning, match="tf places frame 'camera_optical' in 2 ways: check the poses; of fixed ones, the"
    ):
        frames = tj.load_scene(ros.record(tmp_path / "walk", [*ros.messages(), *again]), voxel_size=0.1).frames
    assert [round(-frame.world_to_camera[2, 3].item(), 3) for frame in frames] == [0.7, 0.7]


@pytest.mark.parametrize("world", ["map", "robot/odom", "start"])
@pytest.mark.parametrize("turn", [(0.5**0.5, 0, 0.5**0.5, 0), (0, 0, 0, 1)])  # a rolled camera; one that looks along z
def test_z_of_a_map_is_up(world, turn, tmp_path):
    sent = [("/tf_static", 0.0, ros.transforms(0.0, "base", "camera_optical", (0, 0, 0.5), turn)), *ros.messages()]
    del sent[1]
    for message in [one for topic, _, one in sent if topic == "/tf"]:
        message.transforms[0].header.frame_id = world
    up = tj.load_scene(ros.record(tmp_path / "walk", sent), fuse=False).up
    assert (up is not None and up.tolist() == [0, 0, 1]) == (world != "start" and turn[3] == 0)


def test_the_camera_of_another_frame_is_told(tmp_path):
    """It may be that of the depth camera, with another focal length."""
    messages = [*ros.messages()]
    for one in (one for topic, _, one in messages if topic == "/camera/camera_info"):
        one.header.frame_id = "depth_optical"
    told = "/camera/camera_info: camera of frame 'depth_optical', taken for that of frame 'camera_optical'"
    with pytest.warns(UserWarning, match=told):
        tj.load_scene(ros.record(tmp_path / "walk", messages), fuse=False)


def test_one_camera_told_twice(tmp_path):
    messages = [*ros.messages()]
    messages += [("/depth/camera_info", time, one) for topic, time, one in messages if topic == "/camera/camera_info"]
    assert len(tj.load_scene(ros.record(tmp_path / "same", messages), voxel_size=0.1).frames) == 2


@pytest.mark.parametrize("frame", ["camera_optical", "left_optical"])
@pytest.mark.parametrize("image", ["image_rect", "image_raw"])
def test_a_right_camera_in_the_frame_of_the_left_is_told(frame, image, tmp_path):
    names = {"/camera/image_raw": f"/right/{image}", "/camera/camera_info": "/right/camera_info"}
    messages = [(names.get(topic, topic), time, message) for topic, time, message in ros.messages()]
    for topic, _, message in messages:
        if topic == "/right/camera_info":
            message.p[3] = -1.2
    bag = ros.record(tmp_path / "pair", [*messages, ("/left/camera_info", 0.0, ros.camera_info(0.0, frame))])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        tj.load_scene(bag, voxel_size=0.1, topics={"info": "/right/camera_info"})
    expected = "another camera has the frame 'camera_optical', too; P of /right/camera_info has a shift"
    assert [expected in str(one.message) for one in told] == [True] * (frame == "camera_optical")


@pytest.mark.parametrize(("image", "kind"), [("image_rect", "rectified"), ("image_raw", "unrectified")])
def test_the_rotation_of_a_stereo_pair_is_told(image, kind, tmp_path):
    messages = [(f"/camera/{image}" if "image" in topic else topic, time, one) for topic, time, one in ros.messages()]
    for topic, _, one in messages:
        if topic == "/camera/camera_info":
            one.r[:2] = one.r[3:5] = 0.9998, 0.02
    with pytest.warns(UserWarning, match=rf"R of /camera/camera_info turns .* are those of the {kind} camera"):
        tj.load_scene(ros.record(tmp_path / "pair", messages), voxel_size=0.1)


def test_two_parents_of_one_frame_are_no_tree(tmp_path):
    """Their poses would be taken for those of one world."""
    other = [("/tf", 0.1 * index, ros.transforms(0.1 * index + 0.001, "map", "base", (9, 0, 0))) for index in range(2)]
    bag = ros.record(tmp_path / "walk", [*ros.messages(), *other])
    with pytest.raises(ValueError, match=r"one parent of frame 'base' in tf, got map, odom; --topics odometry"):
        tj.load_scene(bag, voxel_size=0.1)
    right = [("/pose", 0.1 * i, ros.transforms(0.1 * i, "odom", "base", (i, 0, 0)).transforms[0]) for i in range(2)]
    bag = ros.record(tmp_path / "posed", [*ros.messages(), *other, *right])
    frames = tj.load_scene(bag, voxel_size=0.1, topics={"odometry": "/pose"}).frames
    assert [round(-frame.world_to_camera[0, 3].item(), 2) for frame in frames] == [0.04, 1]


def test_images_of_several_frames_have_no_common_pose(tmp_path):
    other = ("/camera/image_raw", 0.05, ros.image(0.05, ros.colors(2), "bgr8", "rear_optical"))
    bag = ros.record(tmp_path / "walk", [*ros.messages(), other])
    told = r"/camera/image_raw: expected messages of one frame \(frame_id\), got 'camera_optical', 'rear_optical'"
    with pytest.raises(ValueError, match=told):
        tj.load_scene(bag, voxel_size=0.1)


def test_scans_of_another_tree_have_no_place(tmp_path):
    points = [("/points", 0.0, ros_points.cloud(0.0, np.asarray(wall())))]
    points[0][2].header.frame_id = "lidar"
    bag = ros.record(tmp_path / "two", [*of(ros.messages(), "/camera/aligned_depth"), *points])
    with pytest.raises(ValueError, match=r"no pose between frame 'camera_optical' of .* and frame 'lidar' of /points"):
        tj.load_scene(bag)


@pytest.mark.parametrize(
    ("full", "sent", "binning"),
    [
        ((24, 32), (12, 16), 0),  # the part, of the whole camera
        ((12, 16), (12, 16), 0),  # sizes of the part, as Baxter writes them
        ((0, 0), (12, 16), 0),
        ((48, 64), (12, 16), 2),
        ((12, 16), None, 0),  # the whole image is sent with the region
    ],
)
def test_a_region_of_interest(tmp_path, full, sent, binning):
    def cut(info):
        info.height, info.width, info.binning_x, info.binning_y = *full, binning, binning
        height, width = (24, 32) if binning else sent or (6, 8)
        info.roi = ros.TYPES["sensor_msgs/msg/RegionOfInterest"](2, 4, height, width, False)
        return info

    messages = [(t, s, cut(m) if t == "/camera/camera_info" else m) for t, s, m in ros.messages()]
    frame = tj.load_scene(ros.record(tmp_path / "walk", messages), voxel_size=0.1).frames[0]
    K = torch.tensor([[12, 0, 7.5], [0, 12, 5.5], [0, 0, 1]], dtype=torch.float64)
    K[:2, 2] -= torch.tensor([2.0, 4.0]) if sent else 0
    if binning:
        K[:2] *= 0.5
        K[:2, 2] -= 0.25
    torch.testing.assert_close(frame.intrinsics, K)


def test_beams_without_return_are_no_points_at_the_sensor(tmp_path):
    messages = list(ros_points.messages())
    for topic, _, message in messages:
        if topic.endswith("points"):
            message.data[: message.point_step] = 0
    with pytest.warns(UserWarning, match=r"2 of \d+ points are \(0, 0, 0\), beams without return; they are left out"):
        scene = tj.load_scene(ros.record(tmp_path / "bag", messages), voxel_size=1e-4)
    expected = np.concatenate([wall()[1:], wall()[1:] + np.array([1, 0, 0])])
    assert len(scene.points) == len(expected)


def test_what_is_no_recording_of_a_camera(tmp_path):
    bag = ros.record(tmp_path / "tf", [one for one in ros.messages() if one[0] == "/tf"])
    with pytest.raises(ValueError, match=r"expected colour images \(scans alone: PCD\), got /tf"):
        tj.load_scene(bag)


def test_the_cache_knows_the_topics(tmp_path, monkeypatch):
    """A cloud that was fused from one topic is not that of another."""
    monkeypatch.setenv("TORCHJOINT_CACHE", str(tmp_path / "cache"))
    far = [
        (
            "/camera/far_depth",
            seconds,
            ros.image(seconds + 0.009, np.full((ros.HEIGHT, ros.WIDTH), 3000, np.uint16), "16UC1"),
        )
        for seconds in (0.0, 0.1)
    ]
    bag = ros.record(tmp_path / "two", [*ros.messages(), *far])
    clouds = [
        tj.load_scene(bag, topics={"depth": topic}, voxel_size=0.1).points
        for topic in ("/camera/aligned_depth", "/camera/far_depth", "/camera/aligned_depth")
    ]
    assert torch.equal(clouds[0], clouds[2])
    assert float((clouds[0].mean(0) - clouds[1].mean(0)).norm()) > 0.5


def packed(pixels, kind, suffix="PNG"):
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, suffix)
    data = np.frombuffer(file.getvalue(), np.uint8)
    return ros.TYPES["sensor_msgs/msg/CompressedImage"](ros.header(0.009, "camera_optical"), kind, data)


def test_a_png_of_16_bits_is_depth(tmp_path):
    """Some drivers write `png` for its format. It would count as colour, and with --topics color=... as nothing."""
    depth = packed(np.full((ros.HEIGHT, ros.WIDTH), 3000, np.uint16), "png")
    sent = [*of(ros.messages(), "/camera/aligned_depth"), ("/depth/compressed", 0.1, depth)]
    frames = tj.load_scene(ros.record(tmp_path / "walk", sent), fuse=False).frames
    assert frames[0].depth.unique().tolist() == pytest.approx([3])


def test_a_mosaic_is_no_grey_image():
    """image_transport packs the mosaic of a Bayer filter as a grey JPEG; its raw one is refused, too."""
    with pytest.raises(ValueError, match="a: expected colours, got a mosaic, 'bayer_rggb8; jpeg compressed '; record"):
        color_image(packed(ros.colors(0)[..., 0], "bayer_rggb8; jpeg compressed ", "JPEG"), "a")
    assert color_image(packed(ros.colors(0), "bayer_rggb8; jpeg compressed bgr8", "JPEG"), "a").shape[0] == 3


def test_packed_depth_has_16_bits():
    """A JPEG of depth has its lower 8 bits, or less."""
    for kind in (np.uint16, np.uint8):
        packed = io.BytesIO()
        Image.fromarray(np.full((4, 5), 200, kind)).save(packed, "PNG")
        data = np.frombuffer(packed.getvalue(), np.uint8)
        message = ros.TYPES["sensor_msgs/msg/CompressedImage"](ros.header(0.0, "camera"), "16UC1; png", data)
        if kind == np.uint16:
            assert depth_image(message, "depth").unique().tolist() == pytest.approx([0.2])
        else:
            with pytest.raises(ValueError, match=r"depth: expected a depth image of one channel, 16 bits, got uint8"):
                depth_image(message, "depth")


def test_packed_depth_of_floats():
    """compressed_depth_image_transport packs the inverse of metres, and tells in its header how."""
    scale, shift = np.float32(100 * 101), np.float32(1 - 100 * 101 / 10)
    steps, packed = np.uint16([[scale / 0.5 + shift, scale / 8 + shift, 0]]), io.BytesIO()
    Image.fromarray(steps).save(packed, "PNG")
    data = np.frombuffer(struct.pack("<iff", 0, scale, shift) + packed.getvalue(), np.uint8)
    message = ros.TYPES["sensor_msgs/msg/CompressedImage"](
        ros.header(0.0, "camera"), "32FC1; compressedDepth png", data
    )
    assert depth_image(message, "depth")[0].tolist() == pytest.approx([0.5, 8, 0], rel=0.01)
