"""Reads the ScanNet scenes that come with 3D-SIS: resized frames, volumes, and meshes of the scans.

J. Hou, A. Dai, M. Niessner, "3D-SIS: 3D Semantic Instance Segmentation of RGB-D Scans" (CVPR 2019).

images_square/SCAN/color/N.jpg ...     frames as ScanNet exports them, resized
images_square/SCAN/world2grid.txt      4x4, world to padded voxels, y up
scans/SCAN/SCAN_vh_clean_2.ply         the cloud (fused from depth if absent)
scans/SCAN/SCAN.txt                    the calibrations (optional; default: the one that 3D-SIS uses for all scans)

Ground truth comes from the first of these that exists: ScanNet's own annotation in scans/SCAN/; gt_insts/SCAN.txt; the
objects of scenes/SCAN__0__.scene, where a point gets the object whose surface contains the point's voxel. `load` takes
the folder images_square/SCAN or scans/SCAN, or their parent folder if it holds just one scan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.datasets.formats.scannet import (
    CLOUD,
    DEPTH_SIZE,
    Calibration,
    SceneCameras,
    find_cameras,
    has_frames,
    read_frames,
)
from torchjoint.datasets.recording import Options, find_cloud, scene_of_frames
from torchjoint.datasets.truth import image_instances, vertex_instances
from torchjoint.scene import Scene, Truth
from torchjoint_lab.datasets.sis3d_volume import read_volume
from torchjoint_lab.datasets.vertex_numbers import read_vertex_instances
from torchjoint_lab.datasets.voxels import label_voxels, read_world_to_scene, voxels_of

_NOMINAL = Calibration(
    torch.tensor([[577.870605, 0, 319.5], [0, 577.870605, 239.5], [0, 0, 1]], dtype=torch.float64), (DEPTH_SIZE,)
)

#: The calibration that 3D-SIS uses for every scan: the calibration of the most common sensor.
NOMINAL = SceneCameras(_NOMINAL, _NOMINAL)

WHAT = "images_square/SCAN with color/, pose/ and world2grid.txt, or scans/SCAN beside it (3D-SIS)"

GRID = "world2grid.txt"
_IMAGES = ("images_square", "images")


class Folders(NamedTuple):
    """The folders of a scan's parts."""

    scan: str
    root: Path
    images: Path  #: frames and world2grid.txt
    mesh: Path  #: cloud and annotation; may be absent

    @property
    def cloud(self) -> Path:
        """The mesh file; its vertices are the cloud."""
        return self.mesh / f"{self.scan}{CLOUD}"


def recognizes(path: Path) -> bool:
    """Returns whether `path` is one scan of this layout, or holds only one; False for a mesh with its own frames."""
    is_scannet = (path / f"{path.name}.sens").is_file() or (has_frames(path) and not _is_scan(path))
    return not is_scannet and find_folders(path) is not None


def load(path: Path, options: Options) -> Scene:
    """Loads a scan; see :func:`torchjoint_lab.datasets.scenes.load_scene`."""
    folders = find_folders(path)
    if folders is None:
        raise ValueError(f"{path}: expected {WHAT}")
    info = folders.mesh / f"{folders.scan}.txt"
    frames = read_frames(folders.images, find_cameras(folders.images, info) or NOMINAL)
    scene = scene_of_frames(folders.images, frames, options, [folders.cloud])
    points = _point_truth(folders, scene.points, options)
    images: Sequence[Tensor] = ()
    for folder in (folders.images, folders.mesh):
        images = images or image_instances(folder, folders.scan, frames)
    return replace(scene, truth=Truth(points, images) if points is not None or images else None)


def scenes(path: Path) -> dict[str, Path]:
    """Returns the scans of a folder of this layout."""
    images = next((path / name for name in _IMAGES if (path / name).is_dir()), None)
    folders = sorted(images.iterdir()) if images is not None else []
    return {one.name: one for one in folders if _is_scan(one)}


def find_folders(path: Path) -> Folders | None:
    """Finds the folders of a scan, from any path that `load` accepts; None if `path` is no scan."""
    if not path.is_dir():
        return None
    inside = scenes(path)
    beside = (
        [path, *(path.parent.parent / name / path.name for name in _IMAGES)] if path.parent.name == "scans" else [path]
    )
    found = list(inside.values()) if len(inside) == 1 else [one for one in beside if _is_scan(one)][:1]
    if not found:
        return None
    images = found[0]
    root = images.parent.parent
    return Folders(images.name, root, images, root / "scans" / images.name)


def _is_scan(folder: Path) -> bool:
    return (folder / GRID).is_file() and has_frames(folder)


def _point_truth(folders: Folders, points: Tensor, options: Options) -> Tensor | None:
    scan = folders.scan
    # Names are compared without case, as the cloud's was when it was found.
    if str(find_cloud(folders.images, options, [folders.cloud])).lower() == str(folders.cloud).lower():
        annotated = vertex_instances(folders.mesh, scan, points)
        if annotated is not None:
            return annotated
        vertices = folders.root / "gt_insts" / f"{scan}.txt"
        if vertices.is_file():
            return read_vertex_instances(vertices, len(points))
    volumes = sorted((folders.root / "scenes").glob(f"{scan}__*.scene")) or [folders.root / "scenes" / f"{scan}.scene"]
    if not volumes[0].is_file():
        return None
    volume = read_volume(volumes[0])
    if not volume.masks:  # scenes of the test split have no annotation
        return None
    voxels = voxels_of(points, read_world_to_scene(folders.images / GRID))
    surfaces = [mask == 1 for mask in volume.masks]
    return label_voxels(voxels, volume.corners, surfaces, range(len(surfaces) - 1, -1, -1))
