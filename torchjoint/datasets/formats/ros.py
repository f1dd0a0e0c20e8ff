"""Reads a ROS 1 or ROS 2 recording: .bag, .mcap, .db3, or a folder with metadata.yaml; no ROS is needed.

Topics are found by their types. If several topics fit a role, `topics` must name one:

color     sensor_msgs/Image or CompressedImage, in colour or grey
info      sensor_msgs/CameraInfo of the colour camera: with the same frame, or else the only one
depth     sensor_msgs/Image (16UC1: millimetres, 32FC1: metres) or CompressedImage (16 bits), in the same frame
points    sensor_msgs/PointCloud2: the cloud, unless there is depth
odometry  nav_msgs/Odometry, geometry_msgs/TransformStamped, PoseStamped or PoseWithCovarianceStamped, or nav_msgs/Path;
          used if the camera does not move according to tf, or only on the robot that they place, as a moving head
          does. `none`: the camera stands still

An image gets the depth nearest in time; the nearest pairs are matched first. Its pose is interpolated between the
transforms before and after it. Both must be within `time_limit`; images without a pose are left out, and a warning says
how many. The world is the root of the tree of tf, or the frame of the odometry; z of `map`, `odom` and `world` is up.
Scans are moved to the world with their own poses, and thinned to one point per voxel.
"""

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.cameras import invert_pose
from torchjoint.datasets.files import ros_messages as messages
from torchjoint.datasets.files.ros_bag import SUFFIXES, Bag, Stamp
from torchjoint.datasets.formats.tum import associate
from torchjoint.datasets.recording import Options, Shot, find_cloud, posed, read_shots, scene_of_frames, tell_left_out
from torchjoint.runtime.foreign_files import has_file
from torchjoint.scene import Frame, Scene
from torchjoint.scene.scene import voxel_subsample

WHAT = "a ROS recording: .bag, .mcap, .db3, or a folder with metadata.yaml"
INFO, POINTS = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/PointCloud2"
#: The keys of `topics`.
ROLES = ("color", "info", "depth", "points", "odometry")
#: In place of a topic of odometry.
STILL = "none"
#: Worlds whose z axis is up, by ROS's REP 105 and by custom; without the name of a robot before them.
UPRIGHT, ALONG = ("map", "odom", "world"), 0.9

#: The sine of the angle below which the rectifying rotation of a camera does not matter.
MOST_TURNED = 1e-3

#: Points that are collected before they are thinned.
COLLECTED = 1_000_000


class _Topics(NamedTuple):
    color: str
    info: str
    depth: str | None
    points: str | None
    odometry: str | None


def recognizes(path: Path) -> bool:
    if has_file(path):
        return path.suffix.lower() in SUFFIXES
    return has_file(path / "metadata.yaml") and any(".mcap" in one.name or ".db3" in one.name for one in path.iterdir())


def load(path: Path, options: Options) -> Scene:
    bag = Bag(path)
    poses = messages.Poses(bag, options.time_limit)
    topics = _find_topics(bag, poses, options.topics)
    frame = _frame(bag.first(topics.color))
    if topics.odometry is not None and topics.odometry != STILL:
        poses.add_odometry(topics.odometry, frame)
    if topics.odometry != STILL:
        _check_poses(bag, topics, poses, frame)
    frames = _frames(bag, topics, poses, options.time_limit)
    if topics.points is None or not options.fuse or find_cloud(path, options) is not None:
        scene = scene_of_frames(path, frames, options)
    else:
        points, colors = _merged_scans(bag, topics.points, poses, options.voxel_size)
        scene = Scene(points, frames, colors, name=path.stem)
    # A camera that looks along z at first is the world of a program that knows nothing of gravity: its z is forward.
    is_upright = poses.root(frame).rpartition("/")[2] in UPRIGHT and abs(frames[0].world_to_camera[2, 2]) < ALONG
    return replace(scene, up=torch.tensor([0.0, 0.0, 1.0])) if scene.up is None and is_upright else scene


def _find_topics(bag: Bag, poses: messages.Poses, chosen: Mapping[str, str]) -> _Topics:
    if unknown := [role for role in chosen if role not in ROLES]:
        raise ValueError(f"topics: expected some of {', '.join(ROLES)}, got {', '.join(unknown)}")
    for role, topic in chosen.items():
        if topic not in bag.kinds and (role, topic) != ("odometry", STILL):
            raise ValueError(f"topics: {role}: {bag.path} has no messages of {topic}; it has {', '.join(bag.kinds)}")
    heads = {topic: bag.first(topic) for topic in bag.topics(messages.IMAGE, messages.COMPRESSED)}
    color = _only("color", [topic for topic, head in heads.items() if not messages.is_depth(head)], chosen, bag)
    if color is None:
        raise ValueError(f"{bag.path}: expected colour images (scans alone: PCD), got {', '.join(bag.kinds) or 'none'}")
    frame = _frame(heads[color] if color in heads else bag.first(color))
    infos = [topic for topic in bag.topics(INFO) if _frame(bag.first(topic)) == frame] or bag.topics(INFO)
    # Drivers tell the same camera again for the depth in its frame.
    same = len({repr(messages.matrices_of(bag.first(topic))) for topic in infos}) == 1
    info = _only("info", infos[:1] if same else infos, chosen, bag)
    if info is None:
        raise ValueError(f"{bag.path}: expected a topic of CameraInfo for {color}, got {', '.join(bag.kinds)}")
    if "info" not in chosen and (other := _frame(bag.first(info))) not in ("", frame):
        warnings.warn(f"{bag.path}: {info}: camera of frame {other!r}, taken for that of frame {frame!r}", stacklevel=3)
    depths = [topic for topic, head in heads.items() if messages.is_depth(head)]
    depth = _only("depth", [topic for topic in depths if _frame(heads[topic]) == frame], chosen, bag)
    for topic in (one for one in depths if _frame(heads[one]) != frame and depth in (None, one)):
        told = f"depth of frame {_frame(heads[topic])!r}, not of the images' {frame!r}: register it to {color}"
        warnings.warn(f"{bag.path}: {topic}: {told}; --topics depth={topic} takes it as registered", stacklevel=3)
    head = heads.get(depth or "")
    if "depth" not in chosen and getattr(head, "encoding", getattr(head, "format", "")).startswith("mono16"):
        warnings.warn(f"{bag.path}: {depth}: mono16, taken as depth in millimetres: not infrared?", stacklevel=3)
    points = _only("points", bag.topics(POINTS) if depth is None else (), chosen, bag)
    best = next(filter(None, map(bag.topics, messages.ODOMETRY)), ())
    if poses.moves(frame):  # perhaps only on a robot, which tf does not move
        placed, root = {one: getattr(bag.first(one), "child_frame_id", "") for one in best}, poses.root(frame)
        apart = [one for one in best if root not in (poses.root(placed[one]), poses.root(_frame(bag.first(one))))]
        best = [one for one in best if poses.root(placed[one]) == root and not poses.moves(placed[one])]
        if apart and not best and "odometry" not in chosen:
            told = f"{', '.join(apart)}: not used, as tf moves the camera in {root!r}; if that is a robot which moves"
            warnings.warn(f"{bag.path}: {told}, too, its poses are missing: --topics odometry={apart[0]}", stacklevel=3)
    return _Topics(color, info, None if "points" in chosen else depth, points, _only("odometry", best, chosen, bag))


def _check_poses(bag: Bag, topics: _Topics, poses: messages.Poses, frame: str) -> None:
    """A camera whose poses are missing must not count as one that stands still."""
    if topics.points is not None and poses.root(of_points := _frame(bag.first(topics.points))) != poses.root(frame):
        told = f"between frame {frame!r} of {topics.color} and frame {of_points!r} of {topics.points}"
        raise ValueError(f"{bag.path}: expected one tree of tf, got no pose {told}; record /tf and /tf_static")
    if poses.moves(frame) or len(bag.stamps(topics.color)) < 2:
        return
    way_out = "if it stood still, --topics odometry=none says so"
    if poses.root(frame) == frame:
        got = f"none in {topics.odometry}" if topics.odometry else "none"
        told = f"{bag.path}: expected poses of the camera, frame {frame!r}, in tf, or as odometry, got {got}"
        raise ValueError(f"{told}; record them, or name their topic (--topics odometry=TOPIC); {way_out}")
    told = f"according to tf the camera, frame {frame!r}, stands still in frame {poses.root(frame)!r}"
    way_out = f"if it moved, its poses are missing (--topics odometry=TOPIC); {way_out}"
    warnings.warn(f"{bag.path}: no pose changes: {told}; {way_out}", stacklevel=3)


def _only(role: str, found: Sequence[str], chosen: Mapping[str, str], bag: Bag) -> str | None:
    if role in chosen:
        return chosen[role]
    if len(found) > 1:
        raise ValueError(f"{bag.path}: {len(found)} topics could be {role}; choose: --topics {role}={found[0]}, or "
                         f"{', '.join(found[1:])}")  # fmt: skip
    return found[0] if found else None


def _frame(message: Any) -> str:
    return str(message.header.frame_id).lstrip("/")


def _frames(bag: Bag, topics: _Topics, poses: messages.Poses, limit: float) -> Sequence[Frame]:
    colors, total = bag.stamps(topics.color), bag.counts[topics.color]
    tell_left_out(f"{bag.path}: {topics.color}", total - len(colors), total, "have the time of another in a header,")
    depths = [] if topics.depth is None else bag.stamps(topics.depth)
    depth_of = dict(associate([one.time for one in colors], [one.time for one in depths], limit))
    lost, why = 0 if depth_of else len(depths), f"have no image of {topics.color} within {limit} s (another clock?),"
    tell_left_out(f"{bag.path}: {topics.depth}", lost, lost, why)
    at = poses.world_from(_frame(bag.first(topics.color)), [one.time for one in colors])
    kept = posed(list(enumerate(at)), str(bag.path), "tf or odometry; --time-limit", limit)
    rectified = re.search(r"(?:^|[/_])rect", topics.color) is not None
    info = bag.first(topics.info)
    changed = [repr(messages.matrices_of(one)) != repr(messages.matrices_of(info)) for one in bag.messages(topics.info)]
    if any(changed):
        told = f"{sum(changed)} of {len(changed)} messages have another camera than the first, taken for all images"
        warnings.warn(f"{bag.path}: {topics.info}: {told}", stacklevel=3)
    _tell_pair(bag, topics, info, rectified)
    size = messages.color_image(bag.first(topics.color), f"{bag.path}: {topics.color}").shape[1:]
    lens = messages.camera(info, rectified, f"{bag.path}: {topics.info}", size)
    shots = []
    for index, pose in kept:
        name, depth = f"{colors[index].time:.6f}", None
        if topics.depth is not None and index in depth_of:
            depth = partial(_read, messages.depth_image, bag, topics.depth, depths[depth_of[index]], name)
        color = partial(_read, messages.color_image, bag, topics.color, colors[index], name)
        shots.append(Shot(color, lens, invert_pose(pose), name, depth))
    return read_shots(shots)


def _tell_pair(bag: Bag, topics: _Topics, info: Any, rectified: bool) -> None:
    """P of the right camera of a stereo pair has a shift, and R of both turns them: poses may be without these."""
    frame, (_, P, _, R) = _frame(bag.first(topics.color)), messages.matrices_of(info)
    if (P[3] or P[7]) and sum(_frame(bag.first(topic)) == frame for topic in bag.topics(INFO)) > 1:
        told = f"another camera has the frame {frame!r}, too; P of {topics.info} has a shift, as of a stereo pair's"
        warnings.warn(f"{bag.path}: {told} right camera, which is not applied; check the poses", stacklevel=4)
    if any(R) and np.abs(np.reshape(R, (3, 3)) - np.eye(3)).max() > MOST_TURNED:
        told = f"R of {topics.info} turns the camera, as of a stereo pair, and is not applied; check that the poses"
        told += f" of frame {frame!r} are those of the {'' if rectified else 'un'}rectified camera"
        warnings.warn(f"{bag.path}: {told}", stacklevel=4)


def _read(convert: Callable[[Any, str], Tensor], bag: Bag, topic: str, stamp: Stamp, name: str) -> Tensor:
    return convert(bag.read(topic, stamp), f"{bag.path}: {topic} at {name}")


def _merged_scans(bag: Bag, topic: str, poses: messages.Poses, voxel_size: float) -> tuple[Tensor, Tensor | None]:
    """The points [N, 3] float64 of all scans in the world, one per voxel, and their colours if every scan has them."""
    stamps = bag.stamps(topic)
    at = poses.world_from(_frame(bag.first(topic)), [one.time for one in stamps])
    points, colors, thinned = torch.empty(0, 3, dtype=torch.float64), torch.empty(0, 3), 0
    colored, used, without, given = 0, 0, 0, 0
    for stamp, pose in zip(stamps, at, strict=True):
        if pose is None:
            continue
        scan, no_return = messages.cloud_points(bag.read(topic, stamp), f"{bag.path}: {topic}")
        used, colored = used + 1, colored + (scan.colors is not None)
        without, given = without + no_return, given + no_return + len(scan.points)
        points = torch.cat([points, scan.points @ pose[:3, :3].T + pose[:3, 3]])
        colors = torch.cat([colors, torch.zeros(len(scan.points), 3) if scan.colors is None else scan.colors])
        if len(points) > 2 * thinned + COLLECTED:
            kept = voxel_subsample(points, voxel_size)
            points, colors, thinned = points[kept], colors[kept], len(kept)
    if not len(points):
        raise ValueError(f"{bag.path}: no scan of {topic} has points and a pose within {poses.limit} s")
    for count, of, told in (
        (len(stamps) - used, len(stamps), f"scans have no pose within {poses.limit} s"),
        (bag.counts[topic] - len(stamps), bag.counts[topic], "scans have the time of another in their header"),
        (without, given, "points are (0, 0, 0), beams without return"),
        (colored and used - colored, used, "scans have no colours, so those of the others"),
    ):
        if count:
            warnings.warn(f"{bag.path}: {topic}: {count} of {of} {told}; they are left out", stacklevel=3)
    kept = voxel_subsample(points, voxel_size)
    return points[kept], colors[kept] if colored == used else None
