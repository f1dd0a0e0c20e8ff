"""The ROS 2 node of examples/, with stand-ins of ROS: what it takes from messages, and what it publishes."""

from __future__ import annotations

import importlib.util
import json
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import torchjoint as tj

NODE = Path(__file__).parents[1] / "examples" / "ros2_node.py"
MESSAGES = ("CameraInfo", "Image", "PointCloud2", "PointField")


class Message(SimpleNamespace):
    """A message with the fields that it is given."""

    UINT32, FLOAT32 = 6, 7


class NoTransformError(Exception):
    """There is no pose."""


class Publisher(list):
    """Keeps what is published."""

    publish = list.append


class Node:
    """A node without ROS."""

    def __init__(self, name):
        self.said = []

    def declare_parameter(self, name, default):
        return SimpleNamespace(value={"voxel_size": 0.05}.get(name, default))

    def create_publisher(self, kind, name, depth):
        return Publisher()

    def get_logger(self):
        return SimpleNamespace(warning=lambda text, **_: self.said.append(text))


class Buffer:
    """Knows the poses of the frames by their time stamps."""

    poses = ()

    def lookup_transform(self, target, source, stamp):
        assert (target, source) == ("optical", "map")
        if stamp >= len(self.poses):
            raise NoTransformError(f"no pose at {stamp}")
        return self.poses[stamp]


@pytest.fixture
def node(monkeypatch):
    """The module, in a Python that has (our) ROS."""
    filters = SimpleNamespace(
        Subscriber=lambda *_: None,
        ApproximateTimeSynchronizer=lambda *_, **__: SimpleNamespace(registerCallback=lambda call: None),
    )
    parts = {
        "message_filters": filters,
        "rclpy": SimpleNamespace(),
        "rclpy.node": SimpleNamespace(Node=Node),
        "tf2_ros": SimpleNamespace(
            Buffer=Buffer, TransformListener=lambda *_: None, TransformException=NoTransformError
        ),
        "sensor_msgs.msg": SimpleNamespace(**dict.fromkeys(MESSAGES, Message)),
        "std_msgs.msg": SimpleNamespace(String=Message),
    }
    for name, content in parts.items():
        module = ModuleType(name)
        vars(module).update(vars(content))
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("ros2_node", NODE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def transform(pose):
    x, y, z, w = Rotation.from_matrix(pose[:3, :3].numpy()).as_quat()
    translation = SimpleNamespace(**dict(zip("xyz", pose[:3, 3].tolist(), strict=True)))
    return SimpleNamespace(
        transform=SimpleNamespace(rotation=SimpleNamespace(x=x, y=y, z=z, w=w), translation=translation)
    )


def image(pixels, encoding, stamp, padding=0):
    rows = np.ascontiguousarray(pixels).reshape(len(pixels), -1).view(np.uint8)
    data = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    return Message(
        header=Message(frame_id="optical", stamp=stamp), height=pixels.shape[0], width=pixels.shape[1],
        encoding=encoding, is_bigendian=pixels.dtype.byteorder == ">", step=data.shape[1], data=data.tobytes(),
    )  # fmt: skip


def messages(frame, stamp):
    color = (frame.image * 255).round().byte().permute(1, 2, 0).numpy()
    depth = (frame.depth * 1000).round().numpy().astype(np.uint16)
    info = Message(k=frame.intrinsics.flatten().tolist())
    return image(color[:, :, ::-1], "bgr8", stamp, 5), image(depth, "16UC1", stamp, 2), info


@pytest.mark.parametrize(("encoding", "kind", "unit"), [("16UC1", ">u2", 1000), ("32FC1", "<f4", 1)])
def test_depth_is_in_metres(node, encoding, kind, unit):
    depth = np.array([[0, 1, 2], [3, 4, 5]]) * unit
    found = node.depth_image(image(depth.astype(kind), encoding, 0))
    assert torch.allclose(found, torch.tensor([[0.0, 1, 2], [3, 4, 5]]))


def test_another_encoding_is_named(node):
    with pytest.raises(ValueError, match=r"color: expected one of the encodings rgb8, .*, got yuv422"):
        node.color_image(Message(encoding="yuv422"))
    with pytest.raises(ValueError, match=r"depth: expected one of the encodings 16UC1, .*, got rgb8"):
        node.depth_image(Message(encoding="rgb8"))


def test_unknown_depth_is_zero(node):
    depth = np.array([[np.nan, np.inf, -np.inf, 1]], dtype=np.float32)
    assert node.depth_image(image(depth, "32FC1", 0)).tolist() == [[0, 0, 0, 1]]


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8"])
def test_colours_are_red_green_blue(node, encoding):
    values = {"r": 255, "g": 51, "b": 0, "a": 9}
    pixels = np.array([[[values[channel] for channel in encoding[:-1]]]], dtype=np.uint8)
    assert torch.allclose(node.color_image(image(pixels, encoding, 0, 3)).flatten(), torch.tensor([1.0, 0.2, 0.0]))


def test_frames_become_a_labelled_cloud(node, monkeypatch):
    frames = tj.synthetic.make_scene(0, num_views=3, num_points=500, height=48, width=64).scene.frames
    monkeypatch.setattr(Buffer, "poses", [transform(frame.world_to_camera) for frame in frames])
    things = node.Things()
    for stamp, frame in enumerate([*frames, frames[0]]):  # the last has no pose
        things.on_frame(*messages(frame, stamp))
    assert things.said == ["frame left out: no pose at 3"]
    expected = tj.LiveSegmenter(voxel_size=0.05)
    for frame in frames:
        expected.update(frame)
    result = expected.result(images=False)
    cloud = node.labelled_cloud(result, Message())
    rows = np.frombuffer(cloud.data, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4"), ("label", "<u4")])
    assert np.array_equal(np.stack([rows["x"], rows["y"], rows["z"]], 1), result.cloud.points.numpy())
    assert np.array_equal(rows["label"], result.labels.numpy())
    colors = np.stack([rows["rgb"] >> 16, rows["rgb"] >> 8 & 255, rows["rgb"] & 255], 1) / 255
    assert np.allclose(colors, result.cloud.colors.numpy(), atol=1e-6)
    places = [(field.name, field.offset, field.datatype) for field in cloud.fields]
    assert places[3:] == [("rgb", 12, 6), ("label", 16, 6)]
    end = time.monotonic() + 60  # only ends a test that has failed anyway
    while not (things.changes and abs(things.things[-1].width - cloud.width) < 0.05 * cloud.width):  # in millimetres
        assert time.monotonic() < end
        time.sleep(0.05)
    last = things.things[-1]
    assert (last.header.frame_id, last.header.stamp) == ("map", 2)
    assert set(json.loads(things.changes[0].data)) == {"born", "gone", "merged", "split"}
