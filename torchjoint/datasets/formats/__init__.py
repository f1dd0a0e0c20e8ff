"""The formats of data sets, one module each; all convert to the conventions of :mod:`torchjoint.scene.scene`.

A format is a module with

* ``WHAT``: a few words on the files it expects,
* ``recognizes(path) -> bool``: whether `path` is one scene of this format; cheap; raises ValueError if this cannot be
  known, because a link leads nowhere or a pipe stands in the place of a file,
* ``load(path, options) -> Scene``: with ground truth if the data set has any; frames are lazy,

and, if a data set holds many scenes, ``scenes(path) -> dict[str, Path]``: scene paths by name; empty if `path` is no
data set of this format.
"""

from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

from torchjoint.datasets.recording import Options
from torchjoint.scene import Scene


class Format(Protocol):
    """The functions that a format's module must have."""

    WHAT: str

    def recognizes(self, path: Path) -> bool:
        """Returns whether `path` is one scene of this format."""

    def load(self, path: Path, options: Options) -> Scene:
        """Loads the scene."""


#: Formats by name, in the order in which they are tried; `cloud_alone` is last: other formats have clouds with images.
FORMATS: dict[str, Format] = {
    name: cast(Format, import_module(f"{__name__}.{name}"))
    for name in (
        "folder", "scannet", "tum", "nerfstudio", "colmap", "kitti", "nuscenes", "lidar_image", "organized_pcd", "bop",
        "ycb_video", "posed_images", "replica", "arkitscenes", "record3d", "polycam", "scannetpp", "s3dis", "vggt",
        "ros", "cloud_alone",
    )
}  # fmt: skip
