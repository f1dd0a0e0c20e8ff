"""The frames of a recording before their files are read: their cameras, poses and files are known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from torchjoint.datasets.cameras import Camera
from torchjoint.datasets.files.readers import read_depth, read_image
from torchjoint.runtime.foreign_files import has_file
from torchjoint.runtime.lazy import LazySequence
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


def read_shots(shots: Sequence[Shot]) -> LazySequence[Frame]:
    """Returns the frames in the order of the shots; each frame is read on access."""
    return LazySequence(len(shots), lambda index: shots[index].read(), [shot.name for shot in shots])
