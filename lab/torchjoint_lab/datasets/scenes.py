"""Loads the scenes that the lab's commands read: those of the package's formats, and the examples of 3D-SIS."""

from __future__ import annotations

from pathlib import Path

from torchjoint import datasets
from torchjoint.datasets.recording import Options
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene import Scene
from torchjoint_lab.datasets import sis3d


@on_cpu()
def load_scene(path: Path, *, progress: bool | None = None) -> Scene:
    """Loads a scan of 3D-SIS' examples, or what :func:`torchjoint.load_scene` loads.

    Args:
        path: a folder or a file.
        progress: show a progress bar while a cloud is fused; None: if there is a terminal.

    Raises:
        FileNotFoundError, ValueError: the message names the file; if no format fits, it lists the expected files.
    """
    if sis3d.recognizes(path):
        return sis3d.load(path, Options(progress=progress))
    return datasets.load_scene(path, progress=progress)


def list_scenes(path: Path) -> dict[str, Path]:
    """Returns the scenes of a folder by name, for :func:`load_scene`. A path may be a single scene.

    Raises:
        FileNotFoundError, ValueError: as :func:`torchjoint.datasets.list_scenes`.
    """
    if sis3d.recognizes(path):
        return {path.name: path}
    scans = sis3d.scenes(path)
    if scans:
        return scans
    inside = {one.name: one for one in path.iterdir() if sis3d.recognizes(one)} if path.is_dir() else {}
    try:
        others = datasets.list_scenes(path)
    except ValueError:
        if not inside:
            raise
        others = {}
    return dict(sorted((others | inside).items())) if inside else others
