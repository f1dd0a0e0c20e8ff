"""Poses of the sensors of a ROS recording: of the tree of tf, or of another topic and the fixed part of the tree."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.cameras import interpolate_poses
from torchjoint.datasets.files.ros_bag import Bag

TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
#: Other topics with poses, the better ones first: those that name the frame that they place.
ODOMETRY = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/TransformStamped",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Path",
)
#: A chain of more frames than this is taken for a cycle.
_DEEPEST = 64


class Poses:
    """Transforms between frames over time; the world is the frame at the root of their tree.

    Args:
        bag: the recording; all messages of tf are read.
        limit: largest time between a wanted time and the nearest transform, seconds.
    """

    def __init__(self, bag: Bag, limit: float) -> None:
        self.bag, self.limit = bag, limit
        self._parents: dict[str, str] = {}
        self._rows: dict[str, dict[float, list[float]]] = {}
        self._fixed: dict[str, bool] = {}
        for topic in bag.topics(*TF):
            for message in bag.messages(topic):
                for one in message.transforms:
                    self._add(one.header, one.child_frame_id, one.transform, topic.endswith("static"))

    def moves(self, frame: str) -> bool:
        """Whether a frame moves in the world: its transform, or one above it in the tree, changes over time."""
        return any(len({tuple(row[1:]) for row in self._rows[one].values()}) > 1 for one in self._chain(frame))

    def names(self, frame: str) -> bool:
        """Whether there is a transform of this frame."""
        return bool(self._chain(frame))

    def root(self, frame: str) -> str:
        """The frame at the root of a frame's tree."""
        return self._parents[chain[-1]] if (chain := self._chain(frame)) else frame.lstrip("/")

    def world_from(self, frame: str, times: Sequence[float]) -> list[Tensor | None]:
        """The poses [4, 4] float64, world from frame, at each time; None where no transform is near enough in time."""
        wanted = np.array(times, np.float64)
        poses: list[Tensor | None] = [torch.eye(4, dtype=torch.float64) for _ in times]
        for one in self._chain(frame):
            rows = np.array([self._rows[one][time] for time in sorted(self._rows[one])])
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
        if messages and hasattr(messages[-1], "poses"):
            messages = messages[-1].poses
        body = self.root(frame)
        children = [getattr(message, "child_frame_id", "").lstrip("/") or body for message in messages]
        if body in children and not hasattr(messages[0], "child_frame_id"):
            warnings.warn(f"{self.bag.path}: the poses of {topic} are taken as those of frame {body}", stacklevel=4)
        for child in set(children):
            self._rows.pop(child, None)
        for child, message in zip(children, messages, strict=True):
            transform = message.transform if hasattr(message, "transform") else message.pose
            self._add(message.header, child, getattr(transform, "pose", transform), False)

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
        self._parents[child] = header.frame_id.lstrip("/")
        self._fixed[child] = fixed
        self._rows.setdefault(child, {}).setdefault(time, row)
