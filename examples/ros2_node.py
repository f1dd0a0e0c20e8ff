"""A ROS 2 node: depth camera in, labelled cloud out. It was never run under ROS, only with stand-ins of its messages.

    python examples/ros2_node.py --ros-args -r color:=/camera/color/image_raw -r info:=/camera/color/camera_info
        -r depth:=/camera/aligned_depth_to_color/image_raw -p world:=map

It needs rclpy, message_filters, tf2_ros and NumPy of your ROS, and torchjoint in the same Python. Depth must be aligned
with the colour image. Published are `things`, a PointCloud2 with the field `label`, and `changes`, a String of JSON.
"""

from __future__ import annotations

import json
import threading

import message_filters
import numpy as np
import rclpy
import tf2_ros
import torch
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField
from std_msgs.msg import String

import torchjoint as tj

#: Bytes of a pixel's channels, and the channels that are red, green and blue.
COLORS = {"rgb8": (3, [0, 1, 2]), "bgr8": (3, [2, 1, 0]), "rgba8": (4, [0, 1, 2]), "bgra8": (4, [2, 1, 0])}
#: Types of depth, and metres for each unit.
DEPTHS = {"16UC1": (np.uint16, 0.001), "mono16": (np.uint16, 0.001), "32FC1": (np.float32, 1.0)}
FIELDS = ("x", "y", "z", "rgb", "label")


def color_image(message: Image) -> torch.Tensor:
    """[3, H, W] float32 RGB in [0, 1]."""
    channels, order = _known(COLORS, message, "color")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)[:, : message.width * channels]
    pixels = rows.reshape(message.height, message.width, channels)[:, :, order]
    return torch.from_numpy(pixels.transpose(2, 0, 1).copy()).float() / 255


def depth_image(message: Image) -> torch.Tensor:
    """[H, W] float32 metres; 0 is unknown."""
    kind, unit = _known(DEPTHS, message, "depth")
    kind = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    depth = rows[:, : message.width * kind.itemsize].copy().view(kind).astype(np.float32) * unit
    return torch.from_numpy(np.nan_to_num(depth, posinf=0.0, neginf=0.0))


def _known(table: dict, message: Image, topic: str) -> tuple:
    if message.encoding not in table:
        raise ValueError(f"{topic}: expected one of the encodings {', '.join(table)}, got {message.encoding}")
    return table[message.encoding]


def camera_matrix(message: CameraInfo) -> torch.Tensor:
    """[3, 3]; the images must be rectified."""
    return torch.tensor(message.k, dtype=torch.float64).reshape(3, 3)


def world_to_camera(stamped) -> torch.Tensor:
    """[4, 4] of a TransformStamped from the world to the optical frame of the camera."""
    q, t = stamped.transform.rotation, stamped.transform.translation
    x, y, z, w = (value / (q.x**2 + q.y**2 + q.z**2 + q.w**2) ** 0.5 for value in (q.x, q.y, q.z, q.w))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), t.x],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), t.y],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), t.z],
        [0.0, 0.0, 0.0, 1.0],
    ]
    return torch.tensor(rows, dtype=torch.float64)


def labelled_cloud(result: tj.LiveResult, header) -> PointCloud2:
    """The points, their colours, and the lasting ids of their things."""
    count = len(result.cloud.points)
    rows = np.zeros(count, [(name, "<u4" if name in ("rgb", "label") else "<f4") for name in FIELDS])
    for name, values in zip("xyz", result.cloud.points.float().numpy().T, strict=True):
        rows[name] = values
    red, green, blue = (result.cloud.colors * 255).round().numpy().astype(np.uint32).T
    rows["rgb"], rows["label"] = red << 16 | green << 8 | blue, result.labels.numpy()
    types = [PointField.UINT32 if name in ("rgb", "label") else PointField.FLOAT32 for name in FIELDS]
    places = enumerate(zip(FIELDS, types, strict=True))
    fields = [PointField(name=name, offset=4 * i, datatype=kind, count=1) for i, (name, kind) in places]
    size = rows.itemsize
    return PointCloud2(
        header=header, height=1, width=count, fields=fields, is_bigendian=False, point_step=size,
        row_step=size * count, data=rows.tobytes(), is_dense=True,
    )  # fmt: skip


class Things(Node):
    """Fuses every frame that has a pose; computes the things in a thread of its own, one time after the other."""

    def __init__(self) -> None:
        super().__init__("torchjoint")
        self.world = self.declare_parameter("world", "map").value
        self.segmenter = tj.LiveSegmenter(voxel_size=self.declare_parameter("voxel_size", 0.02).value)
        self.transforms = tf2_ros.Buffer()
        self.listener = tf2_ros.TransformListener(self.transforms, self)
        self.things = self.create_publisher(PointCloud2, "things", 1)
        self.changes = self.create_publisher(String, "changes", 10)
        self.last, self.new = None, threading.Event()
        topics = [(Image, "color"), (Image, "depth"), (CameraInfo, "info")]
        inputs = [message_filters.Subscriber(self, kind, name) for kind, name in topics]
        self.synchronized = message_filters.ApproximateTimeSynchronizer(inputs, queue_size=5, slop=0.02)
        self.synchronized.registerCallback(self.on_frame)
        threading.Thread(target=self.work, daemon=True).start()

    def on_frame(self, color: Image, depth: Image, info: CameraInfo) -> None:
        """Adds a frame whose pose is known."""
        try:
            pose = self.transforms.lookup_transform(color.header.frame_id, self.world, color.header.stamp)
        except tf2_ros.TransformException as error:
            self.get_logger().warning(f"frame left out: {error}", throttle_duration_sec=5.0)
            return
        frame = tj.Frame(color_image(color), camera_matrix(info), world_to_camera(pose), depth=depth_image(depth))
        self.segmenter.update(frame)
        self.last = color.header
        self.new.set()

    def work(self) -> None:
        """Computes and publishes the things whenever there are new frames."""
        while self.new.wait():
            self.new.clear()
            last = self.last
            try:
                self.publish(self.segmenter.result(images=False), last)
            except ValueError as error:  # no surface yet
                self.get_logger().warning(str(error), throttle_duration_sec=5.0)

    def publish(self, result: tj.LiveResult, last) -> None:
        """Publishes the things, and what has become of those before; `last` is the header of the last colour image."""
        header = type(last)(stamp=last.stamp, frame_id=self.world)
        self.things.publish(labelled_cloud(result, header))
        self.changes.publish(String(data=json.dumps(result.changes._asdict())))


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Things())
