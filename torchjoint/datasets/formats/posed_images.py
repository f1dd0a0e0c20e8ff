"""Reads posed_images/SCAN, the frames of ScanNet as MMDetection3D and its followers export them.

NNNNN.jpg, NNNNN.png, NNNNN.txt    8-bit RGB; depth, 16-bit, millimetres (optional); 4x4 camera-to-world, -inf = lost
intrinsic.txt                      4x4 (or 3x3), of the images
depth_intrinsic.txt                4x4 (or 3x3), of the depth images (optional: else intrinsic.txt, scaled)
SCAN_vh_clean_2.ply                the cloud, with ScanNet's annotation (optional; here, or in scans/SCAN beside
                                   posed_images/; fused from depth if absent)
"""

from functools import partial
from pathlib import Path

from torchjoint.datasets.formats.scannet import CLOUD, frames_of, read_cameras
from torchjoint.datasets.recording import Options, find_cloud, scene_of_frames, sorted_images
from torchjoint.datasets.truth import vertex_instances
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame, Scene

WHAT = "intrinsic.txt with NNNNN.jpg and NNNNN.txt (posed_images)"


def recognizes(path: Path) -> bool:
    return has_folder(path) and has_file(path / "intrinsic.txt") and bool(_images(path))


def load(path: Path, options: Options) -> Scene:
    scan, beside = path.name, path.absolute().parent.parent / "scans" / path.name
    folder = path if find_cloud(path, options, [path / f"{scan}{CLOUD}"]) else beside
    cloud = folder / f"{scan}{CLOUD}"
    instances = partial(vertex_instances, folder, scan)
    return scene_of_frames(path, _read_frames(path), options, [cloud], instances=instances)


def _read_frames(path: Path) -> LazySequence[Frame]:
    images = _images(path)
    frames = frames_of(path, images, read_cameras(path / "intrinsic.txt", path / "depth_intrinsic.txt"), (path, path))
    frames.like_depth = r"\d"
    return frames


def _images(path: Path) -> list[Path]:
    files = (file for file in path.glob("*.[jJ][pP][gG]") if file.stem.isascii() and file.stem.isdigit())
    return sorted_images(path, files)
