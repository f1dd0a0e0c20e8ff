"""Converts ROS messages: images, depth images, point clouds, cameras; and poses, of the tree of tf or another topic."""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.cameras import Camera, interpolate_poses
from torchjoint.datasets.files.columns import POINTS, Array, CloudFile, cloud_of, plain, repaired
from torchjoint.datasets.files.readers import decode_image, rgb_of
from torchjoint.datasets.files.ros_bag import Bag
from torchjoint.runtime.foreign_files import dict_of

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
#: By encoding of a colour image: numbers per pixel, and the indices of red, green and blue among them.
_COLORS = {
    "rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0)),
    "8UC3": (3, (2, 1, 0)), "8UC4": (4, (2, 1, 0)), "mono8": (1, (0, 0, 0)), "8UC1": (1, (0, 0, 0)),
}  # fmt: skip
#: By encoding of a depth image: type of a pixel, and its unit in metres.
_DEPTHS = {"16UC1": ("u2", 0.001), "mono16": ("u2", 0.001), "32FC1": ("f4", 1.0)}
#: NumPy types of a point's fields, by their number in sensor_msgs/PointField.
_FIELDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
#: compressed_depth_image_transport writes its own header before the PNG.
_DEPTH_HEADER = 12
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
#: Other topics with poses, the better ones first: those that name the frame that they place.
ODOMETRY = (
    "nav_msgs/msg/Odometry", "geometry_msgs/msg/TransformStamped", "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Path",
)  # fmt: skip
#: Metres, and parts of a quaternion: the joints of a robot that stands still are told with so much noise.
NOISE = 0.01
#: Two nodes place a frame, if more than this share of its steps lead away and back, to within a fifth of the step.
MOST_BACK = 0.1
#: A chain of more frames than this is taken for a cycle.
_DEEPEST = 64


def is_depth(message: Any) -> bool:
    """Whether an Image or CompressedImage holds depth."""
    if hasattr(message, "encoding"):
        return message.encoding in _DEPTHS
    is_png = bytes(message.data[:4]) == b"\x89PNG" and bytes(message.data[24:26]) == b"\x10\0"  # grey, of 16 bits
    return is_png or "compressedDepth" in message.format or message.format.startswith(("16UC1", "32FC1"))


def color_image(message: Any, name: str) -> Tensor:
    """[3, H, W] uint8 RGB of an Image or CompressedImage."""
    if not hasattr(message, "encoding"):
        image = decode_image(message.data.tobytes(), name)
        if image.mode == "L" and message.format.startswith("bayer"):
            raise ValueError(f"{name}: expected colours, got a mosaic, {message.format!r}; record those of image_proc")
        return rgb_of(image, name)
    if message.encoding not in _COLORS:
        raise ValueError(f"{name}: expected an encoding of {', '.join(_COLORS)}, got {message.encoding!r}")
    channels, order = _COLORS[message.encoding]
    pixels = _pixels(message, np.dtype("u1"), channels, name)
    return torch.from_numpy(pixels[..., list(order)].copy()).permute(2, 0, 1).contiguous()


def depth_image(message: Any, name: str) -> Tensor:
    """[H, W] float32 metres of an Image or CompressedImage, 0 = unknown."""
    if not hasattr(message, "encoding"):
        skipped = _DEPTH_HEADER if "compressedDepth" in message.format else 0
        if "32FC1" in message.format and not skipped:
            raise ValueError(f"{name}: expected compressed depth of 16 bits, got {message.format!r}")
        raw, unit = np.array(decode_image(message.data[skipped:].tobytes(), name)), 0.001
    elif message.encoding in _DEPTHS:
        kind, unit = _DEPTHS[message.encoding]
        raw = _pixels(message, np.dtype(kind), 1, name)[..., 0]
    else:
        raise ValueError(f"{name}: expected an encoding of {', '.join(_DEPTHS)}, got {message.encoding!r}")
    if raw.ndim != 2 or raw.dtype == np.uint8:
        raise ValueError(f"{name}: expected a depth image of one channel, 16 bits, got {raw.dtype} {list(raw.shape)}")
    depth = raw.astype(np.float32) * np.float32(unit)
    if "32FC1" in getattr(message, "format", ""):  # the inverse, in equal steps: scale / metres + shift, 0 = unknown
        scale, shift = message.data[4:_DEPTH_HEADER].view("<f4")
        depth = scale / np.where(raw, raw - shift, np.float32(np.inf))
    return torch.from_numpy(np.where(np.isfinite(depth) & (depth > 0) & (raw != 65535), depth, np.float32(0)))


def _pixels(message: Any, dtype: np.dtype[Any], channels: int, name: str) -> Array:
    """[H, W, channels] of an Image, whose rows may be longer than their pixels."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    used = width * channels * dtype.itemsize
    if not 0 < used <= step or height < 1 or len(message.data) < height * step:
        told = f"{name}: expected {height} rows of {width} pixels, each {channels * dtype.itemsize} bytes"
        raise ValueError(f"{told}, got {len(message.data)} bytes in rows of {step}")
    rows = np.ascontiguousarray(message.data[: height * step].reshape(height, step)[:, :used])
    order = dtype.newbyteorder(">" if message.is_bigendian else "<")
    return rows.view(order).astype(dtype).reshape(height, width, channels)


def matrices_of(message: Any) -> list[list[float]]:
    """The numbers K, P, D and R of a CameraInfo, whose names are capital in ROS 1."""
    names = "kpdr" if hasattr(message, "k") else "KPDR"
    return [np.asarray(getattr(message, name), np.float64).tolist() for name in names]


def camera(message: Any, rectified: bool, name: str, image_size: Sequence[int]) -> Camera:
    """The camera of a CameraInfo: K and the distortion, or P of rectified images.

    Args:
        message: the CameraInfo.
        rectified: the images are.
        name: for messages.
        image_size: (H, W) of an image: some drivers send whole images with a region of interest.
    """
    K, P, D, _ = map(np.array, matrices_of(message))
    K, P = K.reshape(3, 3), P.reshape(3, 4)
    size = (int(message.height), int(message.width)) if message.height and message.width else None
    if min(message.roi.height, message.roi.width) > 0:  # images show a part of what K and P describe
        part = (int(message.roi.height), int(message.roi.width))
        bins = (max(int(message.binning_y), 1), max(int(message.binning_x), 1))
        if size is None or part == size or image_size != (size[0] // bins[0], size[1] // bins[1]):
            size = part
            for matrix in (K, P):
                matrix[:2, 2] -= message.roi.x_offset, message.roi.y_offset
    if rectified and P[0, 0] > 0:
        return Camera(torch.from_numpy(P[:, :3]), size, (), name)
    if D.any() and message.distortion_model not in ("plumb_bob", "rational_polynomial", ""):
        raise ValueError(f"{name}: expected distortion plumb_bob or rational_polynomial, got "
                         f"{message.distortion_model!r}; record the rectified images")  # fmt: skip
    if len(D) not in (0, 4, 5, 8):
        raise ValueError(f"{name}: expected 4, 5 or 8 coefficients of distortion, got {len(D)}")
    return Camera(torch.from_numpy(K), size, tuple(D.tolist()) if D.any() else (), name)


def cloud_points(message: Any, name: str) -> tuple[CloudFile, int]:
    """The finite points of a PointCloud2, float64 in the message's frame, with their colours, if any.

    And how many points are left out because they are (0, 0, 0), as drivers write a beam without return.
    """
    fields = dict_of([(one.name, one) for one in message.fields if one.name != "_"], f"{name}: field")  # "_": padding
    height, width, step = int(message.height), int(message.width), int(message.point_step)
    row_step = int(message.row_step) or step * width
    size = row_step * height
    floats = {plain(field.name) for field in message.fields if field.datatype in (7, 8)}
    if not floats.issuperset(POINTS[0]) or row_step < step * width or len(message.data) < size:
        told = f"{name}: expected fields x, y, z and {height * width} points of {step} bytes"
        raise ValueError(f"{told}, got fields {', '.join(fields)} and {len(message.data)} bytes")
    rows = message.data[:size].reshape(height, row_step)[:, : step * width].reshape(height * width, step)
    order = ">" if message.is_bigendian else "<"
    columns = {}
    for field in fields.values():
        kind, number = np.dtype(f"{order}{_FIELDS.get(field.datatype, 'u1')}"), max(int(field.count), 1)
        end = field.offset + kind.itemsize * number
        if end > step:
            raise ValueError(f"{name}: field {field.name} ends at byte {end} of {step}")
        values = np.ascontiguousarray(rows[:, field.offset : end]).view(kind)
        columns[field.name] = values[:, 0] if number == 1 else values
    cloud = cloud_of(columns, name)
    if cloud.normals is not None:
        warnings.warn(f"{name}: normals of scans are not read", stacklevel=3)
    finite, returned = cloud.points.isfinite().all(1), cloud.points.any(1)
    kept = repaired(cloud._replace(points=cloud.points.double(), normals=None).chosen(finite & returned), name)
    return kept, int((finite & ~returned).sum())


class Poses:
    """Transforms between frames over time; the world is the frame at the root of their tree.

    Args:
        bag: the recording; all messages of tf are read.
        limit: largest time between a wanted time and the nearest transform, seconds.
    """

    def __init__(self, bag: Bag, limit: float) -> None:
        self.bag, self.limit = bag, limit
        self._parents: dict[str, str] = {}
        self._ways: dict[str, set[Any]] = {}  # parents of each frame; of a fixed one also its transforms, to two digits
        self._rows: dict[str, dict[float, list[float]]] = {}
        self._fixed: dict[str, bool] = {}
        for topic in bag.topics(*TF):
            for message in bag.messages(topic):
                for one in message.transforms:
                    self._add(one.header, one.child_frame_id, one.transform, topic.endswith("static"))

    def moves(self, frame: str) -> bool:
        """Whether a frame moves in the world: its transform, or one above it, changes by more than noise."""
        return any(np.ptp([*self._rows[one].values()], axis=0)[1:].max() > NOISE for one in self._chain(frame))

    def root(self, frame: str) -> str:
        """The frame at the root of a frame's tree."""
        return self._parents[chain[-1]] if (chain := self._chain(frame)) else frame.lstrip("/")

    def world_from(self, frame: str, times: Sequence[float]) -> list[Tensor | None]:
        """The poses [4, 4] float64, world from frame, at each time; None where no transform is near enough in time."""
        wanted = np.array(times, np.float64)
        poses: list[Tensor | None] = [torch.eye(4, dtype=torch.float64) for _ in times]
        for one in self._chain(frame):
            if len(several := {parent for parent, *_ in self._ways[one]}) > 1:
                told = f"{self.bag.path}: expected one parent of frame {one!r} in tf, got {', '.join(sorted(several))}"
                raise ValueError(f"{told}; --topics odometry=TOPIC takes other poses")
            if len(self._ways[one]) > 1:
                told = f"{self.bag.path}: tf places frame {one!r} in {len(self._ways[one])} ways: check the poses;"
                warnings.warn(f"{told} of fixed ones, the last counts, else the first of a time", stacklevel=4)
            rows = np.array([self._rows[one][time] for time in sorted(self._rows[one])])
            away, after = (np.linalg.norm(rows[gap:, 1:4] - rows[:-gap, 1:4], axis=1) for gap in (1, 2))
            if np.sum((away[:-1] > NOISE) & (5 * after < away[:-1])) > MOST_BACK * len(rows):
                warnings.warn(f"{self.bag.path}: frame {one!r} jumps to and fro: do two nodes move it?", stacklevel=4)
            limit = np.inf if self._fixed[one] else self.limit
            step = interpolate_poses(rows, wanted, limit, f"{self.bag.path}: transform of {one}")
            poses = [None if a is None or b is None else a @ b for a, b in zip(step, poses, strict=True)]
        return poses

    def add_odometry(self, topic: str, frame: str) -> None:
        """Takes poses from a topic of a type in ODOMETRY instead of from tf.

        Poses that do not name the frame that they place are those of the frame at the root of `frame`'s tree, which a
        warning tells.
        """
        messages = list(self.bag.messages(topic))
        messages = getattr(messages[-1] if messages else None, "poses", messages)
        body = self.root(frame)
        children = [getattr(message, "child_frame_id", "").lstrip("/") or body for message in messages]
        if body in children and not hasattr(messages[0], "child_frame_id"):
            warnings.warn(f"{self.bag.path}: the poses of {topic} are taken as those of frame {body}", stacklevel=4)
        for child in set(children):
            self._rows.pop(child, None)
            self._ways.pop(child, None)
        for child, message in zip(children, messages, strict=True):
            transform = message.transform if hasattr(message, "transform") else message.pose
            self._add(message.header, child, getattr(transform, "pose", transform), False)
        if self.moves(frame) and not {*children} & {*self._chain(frame)}:  # it would have no effect
            told = f"expected poses of a frame that carries {frame!r} according to tf, got those of {children[:1]}"
            raise ValueError(f"{self.bag.path}: {topic}: {told}; record the tf between them, or choose other poses")

    def _chain(self, frame: str) -> list[str]:
        """A frame and the frames above it in the tree, without the root."""
        chain, frame = [], frame.lstrip("/")
        while frame in self._parents:
            chain.append(frame)
            frame = self._parents[frame]
            if len(chain) > _DEEPEST:
                raise ValueError(f"{self.bag.path}: expected a tree of frames, got a cycle: {', '.join(chain[:5])} ...")
        return chain

    def _add(self, header: Any, child: str, transform: Any, fixed: bool) -> None:
        child = child.lstrip("/")
        moved = transform.translation if hasattr(transform, "translation") else transform.position
        turned = transform.rotation if hasattr(transform, "rotation") else transform.orientation
        time = header.stamp.sec + header.stamp.nanosec * 1e-9
        row = [time, moved.x, moved.y, moved.z, turned.x, turned.y, turned.z, turned.w]
        if not np.isfinite(row).all():
            raise ValueError(f"{self.bag.path}: expected finite transforms of frame {child}, got {row}")
        first = next(iter(self._rows.get(child, {}).values()), row)
        row[4:] = [one * (-1 if np.dot(row[4:], first[4:]) < 0 else 1) for one in row[4:]]  # q and -q are one rotation
        self._parents[child] = header.frame_id.lstrip("/")
        self._ways.setdefault(child, set()).add((self._parents[child], *(np.round(row[1:], 2) if fixed else ())))
        if fixed and self._fixed.get(child):  # as in tf2, the latest counts
            del self._rows[child]
        self._fixed[child] = fixed
        if np.abs(np.subtract(self._rows.setdefault(child, {}).setdefault(time, row), row)).max() > NOISE:
            self._ways[child].add((self._parents[child], "at one time"))
