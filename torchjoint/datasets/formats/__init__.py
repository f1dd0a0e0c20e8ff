"""The formats of data sets, one module each; all convert to the conventions of :mod:`torchjoint.scene.scene`.

A format is a module with

* ``WHAT``: a few words on the files it expects,
* ``recognizes(path) -> bool``: whether `path` is one scene of this format; cheap, never raises,
* ``load(path, options) -> Scene``: with ground truth if the data set has any; frames are lazy,

and, if a data set holds many scenes, ``scenes(path) -> dict[str, Path]``: scene paths by name; empty if `path` is no
data set of this format.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, cast

from torchjoint.datasets.formats import (
    arkitscenes,
    bop,
    cloud_alone,
    colmap,
    folder,
    kitti,
    lidar_image,
    nerfstudio,
    nuscenes,
    organized_pcd,
    polycam,
    posed_images,
    record3d,
    replica,
    ros,
    s3dis,
    scannet,
    scannetpp,
    tum,
    ycb_video,
)
from torchjoint.datasets.recording import Options
from torchjoint.scene import Scene


class Format(Protocol):
    """The functions that a format's module must have."""

    WHAT: str

    def recognizes(self, path: Path) -> bool:
        """Returns whether `path` is one scene of this format."""

    def load(self, path: Path, options: Options) -> Scene:
        """Loads the scene."""


#: Formats by name, in the order in which they are tried.
FORMATS: dict[str, Format] = {
    "folder": cast(Format, folder),
    "scannet": cast(Format, scannet),
    "tum": cast(Format, tum),
    "nerfstudio": cast(Format, nerfstudio),
    "colmap": cast(Format, colmap),
    "kitti": cast(Format, kitti),
    "nuscenes": cast(Format, nuscenes),
    "lidar_image": cast(Format, lidar_image),
    "organized_pcd": cast(Format, organized_pcd),
    "bop": cast(Format, bop),
    "ycb_video": cast(Format, ycb_video),
    "posed_images": cast(Format, posed_images),
    "replica": cast(Format, replica),
    "arkitscenes": cast(Format, arkitscenes),
    "record3d": cast(Format, record3d),
    "polycam": cast(Format, polycam),
    "scannetpp": cast(Format, scannetpp),
    "s3dis": cast(Format, s3dis),
    "ros": cast(Format, ros),
    "cloud_alone": cast(Format, cloud_alone),  # last: other formats have clouds with images
}
