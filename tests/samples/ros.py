"""A ROS 2 recording (MCAP in a folder): two images with depth, their camera, and a moving camera in tf."""

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from samples._parts import HEIGHT, WIDTH

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
START = 1_700_000_000


def stamp(seconds):
    whole = int(seconds)
    return TYPES["builtin_interfaces/msg/Time"](sec=START + whole, nanosec=round((seconds - whole) * 1e9))


def header(seconds, frame, types=TYPES, **more):
    return types["std_msgs/msg/Header"](**more, stamp=stamp(seconds), frame_id=frame)


def image(seconds, pixels, encoding, frame="camera_optical", types=TYPES, **more):
    data = np.ascontiguousarray(pixels)
    return types["sensor_msgs/msg/Image"](
        header=header(seconds, frame, types, **more), height=HEIGHT, width=WIDTH, encoding=encoding, is_bigendian=0,
        step=data.nbytes // HEIGHT, data=data.reshape(-1).view(np.uint8),
    )  # fmt: skip


def transforms(seconds, parent, child, place, turn=(0, 0, 0, 1)):
    one = TYPES["geometry_msgs/msg/TransformStamped"](
        header=header(seconds, parent), child_frame_id=child,
        transform=TYPES["geometry_msgs/msg/Transform"](
            translation=TYPES["geometry_msgs/msg/Vector3"](*map(float, place)),
            rotation=TYPES["geometry_msgs/msg/Quaternion"](*map(float, turn)),
        ),
    )  # fmt: skip
    return TYPES["tf2_msgs/msg/TFMessage"](transforms=[one])


def camera_info(seconds, frame="camera_optical"):
    roi = TYPES["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    K = np.array([12.0, 0, 7.5, 0, 12, 5.5, 0, 0, 1])
    return TYPES["sensor_msgs/msg/CameraInfo"](
        header=header(seconds, frame), height=HEIGHT, width=WIDTH, distortion_model="plumb_bob", d=np.zeros(5), k=K,
        r=np.eye(3).reshape(-1), p=np.insert(K, [3, 6, 9], 0.0), binning_x=0, binning_y=0, roi=roi,
    )  # fmt: skip


def colors(seed):
    return np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)


def record(path, messages, storage=StoragePlugin.MCAP):
    """Writes (topic, seconds, message) in their order."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        known = {}
        for topic, seconds, message in messages:
            if topic not in known:
                known[topic] = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            data = STORE.serialize_cdr(message, message.__msgtype__)
            writer.write(known[topic], int((START + seconds) * 1e9), data)
    return path


def messages():
    yield "/tf_static", 0.0, transforms(0.0, "base", "camera_optical", (0, 0, 0.5))
    for index, seconds in enumerate((0.0, 0.1)):
        yield "/tf", seconds, transforms(seconds, "odom", "base", (index, 0, 0))
        yield "/camera/camera_info", seconds, camera_info(seconds)
        yield "/camera/image_raw", seconds, image(seconds + 0.004, colors(index), "bgr8")
        depth = np.full((HEIGHT, WIDTH), 2000, np.uint16)
        yield "/camera/aligned_depth", seconds, image(seconds + 0.009, depth, "16UC1")


def write(folder):
    return record(folder / "walk", messages())
