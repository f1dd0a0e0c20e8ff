"""A ROS 2 recording (SQLite in a folder): compressed images, scans of a LiDAR, odometry."""

import io

import numpy as np
from PIL import Image
from rosbags.rosbag2 import StoragePlugin

from samples import ros
from samples._parts import wall

FORMAT = "ros"


def cloud(seconds, points):
    field = ros.TYPES["sensor_msgs/msg/PointField"]
    fields = [field(name, 4 * index, 7, 1) for index, name in enumerate(("x", "y", "z", "rgb"))]
    rows = np.zeros((len(points), 5), "<f4")
    rows[:, :3] = points
    rows[:, 3] = np.array([0xFF8000], "<u4").view("<f4")
    return ros.TYPES["sensor_msgs/msg/PointCloud2"](
        header=ros.header(seconds, "base"), height=1, width=len(points), fields=fields, is_bigendian=False,
        point_step=20, row_step=20 * len(points), data=rows.reshape(-1).view(np.uint8), is_dense=True,
    )  # fmt: skip


def odometry(seconds, place):
    types, zeros = ros.TYPES, np.zeros(36)
    vector, twist = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0), types["geometry_msgs/msg/Twist"]
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](*map(float, place)), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    return types["nav_msgs/msg/Odometry"](
        ros.header(seconds, "odom"), "base", types["geometry_msgs/msg/PoseWithCovariance"](pose, zeros),
        types["geometry_msgs/msg/TwistWithCovariance"](twist(vector, vector), zeros),
    )  # fmt: skip


def messages():
    yield "/tf_static", 0.0, ros.transforms(0.0, "base", "camera_optical", (0, 0, 0.5))
    for index, seconds in enumerate((0.0, 0.1)):
        yield "/odom", seconds, odometry(seconds, (index, 0, 0))
        yield "/camera/camera_info", seconds, ros.camera_info(seconds)
        stream = io.BytesIO()
        Image.fromarray(ros.colors(index)).save(stream, "PNG")
        data = np.frombuffer(stream.getvalue(), np.uint8)
        head = ros.header(seconds, "camera_optical")
        yield "/camera/compressed", seconds, ros.TYPES["sensor_msgs/msg/CompressedImage"](head, "bgr8; png", data)
        yield "/points", seconds, cloud(seconds, np.asarray(wall()))


def write(folder):
    return ros.record(folder / "drive", messages(), StoragePlugin.SQLITE3)
