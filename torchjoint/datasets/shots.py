"""The frames of a recording before their files are read: their cameras, poses and files are known."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from torchjoint.datasets.cameras import Camera
from torchjoint.datasets.files.readers import read_depth, read_image
from torchjoint.runtime.foreign_files import has_file
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame


class Shot(NamedTuple):
    """What is known of a frame before its files are read."""

    color: Path
    camera: Camera
    world_to_camera: Tensor  #: [4, 4]
    name: str
    depth: Path | None = None  #: 16-bit; without depth if the file is not there
    unit: float = 0.001  #: of depth, metres

    def read(self) -> Frame:
        """Reads the frame."""
        depth = read_depth(self.depth, self.unit) if self.depth is not None and has_file(self.depth) else None
        return self.camera.frame(read_image(self.color, self.camera.size), self.world_to_camera, depth, self.name)


def tell_left_out(name: str, left: int, total: int, why: str = "have no pose") -> None:
    """Warns of images that are left out; readers of all formats tell it with these words."""
    if left:
        warnings.warn(f"{name}: {left} of {total} images {why} and are left out", stacklevel=4)


def tell_unlisted(name: str, files: Sequence[Path]) -> None:
    """Warns of images beside those with a pose, `files`, which a list of poses does not name: they are left out.

    An image is one of theirs if it differs in its number only.
    """
    kinds = {(file.parent, _without_number(file)) for file in files}
    folders, used = {file.parent for file in files}, set(files)
    beside = {one for folder in folders for one in folder.iterdir() if (folder, _without_number(one)) in kinds}
    tell_left_out(name, len(beside - used), len(beside | used))


def _without_number(file: Path) -> str:
    return re.sub(r"\d+", "#", file.name)


def read_shots(shots: Sequence[Shot]) -> LazySequence[Frame]:
    """Returns the frames in the order of the shots; each frame is read on access."""
    return LazySequence(len(shots), lambda index: shots[index].read(), [shot.name for shot in shots])
