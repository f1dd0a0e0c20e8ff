"""Makes a scene from posed frames: with the cloud of the recording, or a cloud fused from depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.datasets.fused_clouds import fuse_or_recall
from torchjoint.runtime.foreign_files import has_file
from torchjoint.runtime.outputs import Output
from torchjoint.scene import Frame, Scene
from torchjoint.scene.checks import Invalid
from torchjoint.scene.frame import camera_center

#: Suffixes of a file `cloud` in a recording's folder; the first that exists is used.
CLOUD_SUFFIXES = (".ply", ".pcd", ".las", ".laz", ".copc.laz", ".e57")


@dataclass(frozen=True)
class Options:
    """Options of :func:`torchjoint.load_scene`; a format ignores the options that it does not need."""

    cloud: Path | None = None  #: a cloud file to use; if it does not exist, a fused cloud is written there
    voxel_size: float = 0.02  #: of the fusion, metres
    progress: bool | None = False  #: show a progress bar while fusing; None: if there is a terminal
    topics: Mapping[str, str] = field(default_factory=dict)  #: for a ROS recording: topics by role
    time_limit: float = 0.02  #: for a ROS recording: most seconds from an image to its depth and pose
    invalid: Invalid = "refuse"  #: what becomes of points of the cloud that are NaN or infinite
    least_opacity: float = 0.1  #: of the cloud, if it consists of Gaussian splats
    fuse: bool = True  #: False: one point stands for a cloud that would have to be fused


def scene_of_frames(path: Path, frames: Sequence[Frame], options: Options, clouds: Sequence[Path] = ()) -> Scene:
    """Makes a scene from a folder's frames, with the cloud of :func:`find_cloud`, or else with a fused cloud.

    Raises:
        ValueError: there is no cloud, and no depth to fuse a cloud from.
    """
    file = find_cloud(path, options, clouds)
    if file is not None:
        cloud = read_cloud_file(file, invalid=options.invalid, least_opacity=options.least_opacity)
        return Scene(cloud.points, frames, cloud.colors, cloud.normals, name=path.name)
    if not options.fuse:
        return Scene(torch.zeros(1, 3), frames, name=path.name)
    made = None if options.cloud is None else Output(options.cloud, overwrite=False, option="cloud")
    points, colors = fuse_or_recall(path, frames, options.voxel_size, options.progress)
    if made is not None:
        with made.written() as file:
            write_cloud(file, points, colors)
    return Scene(points, frames, colors, name=path.name)


def find_cloud(path: Path, options: Options, clouds: Sequence[Path] = ()) -> Path | None:
    """Returns the first cloud that exists: `options.cloud`, `cloud.*` in the folder, the format's own `clouds`."""
    candidates = (options.cloud, *(path / f"cloud{suffix}" for suffix in CLOUD_SUFFIXES), *clouds)
    return next((file for file in candidates if file is not None and has_file(file)), None)


def invert_pose(pose: Tensor) -> Tensor:
    """Returns the inverse of a rigid transform [4, 4], for example world-to-camera from camera-to-world."""
    inverse = torch.eye(4, dtype=pose.dtype)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = camera_center(pose)
    return inverse
