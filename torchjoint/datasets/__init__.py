"""Readers of data on disk, one file a format; each converts to the conventions of :mod:`torchjoint.scene`."""

from __future__ import annotations

from pathlib import Path

from torchjoint.datasets import folder
from torchjoint.scene import Scene

__all__ = ["folder", "load_scene"]

#: Formats by name: each module has WHAT (what it looks for), recognizes(path) and load(path, ...).
FORMATS = {"folder": folder}


def load_scene(
    path: str | Path, *, cloud: str | Path | None = None, voxel_size: float = 0.02, progress: bool = False
) -> Scene:
    """Loads a scene; its format is detected, its frames are read when they are asked for.

    Args:
        path: a folder of frames. Formats: a *plain folder* in the style of 7-Scenes, with `camera-intrinsics.txt`
            and `frame-NNNNNN.color.jpg` (or png), `.pose.txt` (camera-to-world), `.depth.png` (16 bits, mm). A
            `cloud.ply` beside the frames is used as the cloud, and depth is then optional; otherwise the cloud is
            fused from the depth images.
        cloud: a PLY file to use as the cloud; where it does not exist yet, the fused cloud is written there.
        voxel_size: of the fusion, metres; points come out about this far apart.
        progress: show a progress bar while fusing.

    Raises:
        FileNotFoundError, ValueError: naming the file, and what was looked for where no format fits.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"scene: {path} does not exist")
    for module in FORMATS.values():
        if module.recognizes(path):
            return module.load(
                path, cloud=None if cloud is None else Path(cloud), voxel_size=voxel_size, progress=progress
            )
    looked_for = "; ".join(f"{name}: {module.WHAT}" for name, module in FORMATS.items())
    raise ValueError(f"scene: {path} is of no known format. Looked for: {looked_for}")
