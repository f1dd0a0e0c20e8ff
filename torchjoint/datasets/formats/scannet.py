"""Reads ScanNet v2: one scan, sceneXXXX_XX, as downloaded or with exported frames.

A. Dai et al., "ScanNet: Richly-annotated 3D Reconstructions of Indoor Scenes" (CVPR 2017).

SCAN.sens                              the frames; if absent, the frames are single files:
color/N.jpg, depth/N.png, pose/N.txt   8-bit RGB; 16-bit, millimetres; 4x4 camera-to-world, -inf = lost (left out)
intrinsic/intrinsic_{color,depth}.txt  4x4, of the exported frames; or SCAN.txt, which holds the calibrations, too
SCAN_vh_clean_2.ply                    the cloud: the mesh's vertices (fused from depth if absent)
SCAN_vh_clean_2.0.010000.segs.json,    the vertices' instances (optional)
SCAN.aggregation.json
instance-filt/N.png                    the pixels' instances, objectId + 1, 0 = none (optional; or
                                       SCAN_2d-instance-filt.zip, as downloaded)

Images keep their size, mostly 1296x968. ScanNet's authors have aligned the 640x480 depth to the same view. It is
resampled to the image by nearest neighbour with the intrinsics of both cameras. Neither the extrinsics between the
cameras nor SCAN.txt's axis alignment are applied.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.cameras import register_depth
from torchjoint.datasets.files.readers import read_depth, read_image, read_matrix
from torchjoint.datasets.files.sens import SensFile
from torchjoint.datasets.recording import Options, find_cloud, invert_pose, read_shots, scene_of_frames, tell_left_out
from torchjoint.datasets.scannet_cameras import Calibration, Cameras, find_cameras
from torchjoint.datasets.scannet_truth import has_point_instances, image_instances, read_point_instances
from torchjoint.runtime.foreign_files import has_file, has_folder, no_twice, or_unreadable
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame, Scene, Truth
from torchjoint.scene.checks import as_pose

WHAT = "SCAN.sens, or SCAN_vh_clean_2.ply, or color/, pose/ and intrinsic/, in a folder called SCAN (ScanNet)"
CLOUD = "_vh_clean_2.ply"
_SUFFIXES = (".jpg", ".jpeg", ".png")


def recognizes(path: Path) -> bool:
    """Returns whether `path` is a scan's folder, or a .sens file."""
    if has_file(path):
        return path.suffix == ".sens"
    own = any(has_file(path / f"{path.name}{suffix}") for suffix in (".sens", CLOUD))
    exported = has_folder(path / "intrinsic") or has_file(path / f"{path.name}.txt")
    return own or (exported and has_frames(path))


def load(path: Path, options: Options) -> Scene:
    """Loads a scan; see :func:`torchjoint.load_scene`."""
    folder, scan = (path.parent, path.stem) if has_file(path) else (path, path.name)
    frames = _read_frames(folder, scan)
    cloud = folder / f"{scan}{CLOUD}"
    scene = scene_of_frames(folder, frames, options, [cloud])
    is_annotated = find_cloud(folder, options, [cloud]) == cloud and has_point_instances(folder, scan)
    points = read_point_instances(folder, scan, len(scene.points)) if is_annotated else None
    images = image_instances(folder, scan, frames)
    return replace(scene, name=scan, truth=Truth(points, images) if points is not None or images else None)


def scenes(path: Path) -> dict[str, Path]:
    """Returns the scans of the data set's own folder, which holds them in `scans/` and `scans_test/`."""
    folders = [one for name in ("scans", "scans_test") if has_folder(path / name) for one in (path / name).iterdir()]
    folders = [one for one in sorted(folders) if or_unreadable(has_folder, one)]
    return {one.name: one for one in folders if or_unreadable(recognizes, one)}


def _read_frames(folder: Path, scan: str) -> LazySequence[Frame]:
    if has_file(folder / f"{scan}.sens"):
        return _stream_frames(SensFile(folder / f"{scan}.sens"))
    if not has_frames(folder):
        return read_shots(())
    cameras = find_cameras(folder, folder / f"{scan}.txt")
    if cameras is None:
        raise FileNotFoundError(f"{folder}/intrinsic/intrinsic_color.txt: missing, and {scan}.txt has no calibration")
    return read_frames(folder, cameras)


def _stream_frames(stream: SensFile) -> LazySequence[Frame]:
    cameras = Cameras(
        Calibration(stream.color_intrinsics, (stream.color_size,)),
        Calibration(stream.depth_intrinsics, (stream.depth_size,)),
    )
    kept = torch.isfinite(stream.poses).all(dim=(1, 2)).nonzero().flatten().tolist()
    tell_left_out(str(stream.path), len(stream) - len(kept), len(stream))
    extrinsics = [invert_pose(as_pose(stream.poses[i], f"{stream.path}, pose of frame {i}")) for i in kept]

    def read(place: int) -> Frame:
        i = kept[place]
        return make_frame(str(i), stream.color(i), stream.depth(i), cameras, extrinsics[place])

    return LazySequence(len(kept), read, [str(i) for i in kept])


def has_frames(folder: Path) -> bool:
    """Returns whether the folder has images and poses of this layout."""
    return has_folder(folder / "color") and has_folder(folder / "pose")


def read_frames(folder: Path, cameras: Cameras) -> LazySequence[Frame]:
    """Returns the frames with valid poses, sorted by number; each frame is read on access.

    Poses are camera-to-world, OpenCV axes, metres. Where tracking was lost, poses hold -inf; these frames are left out.
    Depth is in millimetres and is registered to the colour image by nearest neighbour.

    Args:
        folder: holds color/, pose/ and (optional) depth/.
        cameras: colour and depth cameras.
    """
    images = sorted(
        (file for file in (folder / "color").iterdir() if file.suffix.lower() in _SUFFIXES),
        key=lambda file: _order(file.stem),
    )
    no_twice((file.stem for file in images), f"{folder / 'color'}: the colour image of frame")
    return frames_of(folder, images, cameras, (folder / "pose", folder / "depth"))


def frames_of(folder: Path, images: Sequence[Path], cameras: Cameras, beside: tuple[Path, Path]) -> LazySequence[Frame]:
    """Returns the frames with valid poses, in the order of `images`; poses and depth are in the folders `beside`."""
    pose_files = [beside[0] / f"{file.stem}.txt" for file in images]
    poses = [read_matrix(file, (4, 4)) for file in pose_files]
    kept = [i for i, pose in enumerate(poses) if torch.isfinite(pose).all()]
    tell_left_out(str(folder), len(images) - len(kept), len(images))
    extrinsics = {i: invert_pose(as_pose(poses[i], str(pose_files[i]))) for i in kept}

    def read(place: int) -> Frame:
        file, pose = images[kept[place]], extrinsics[kept[place]]
        depth = beside[1] / f"{file.stem}.png"
        return make_frame(file.stem, read_image(file), read_depth(depth) if has_file(depth) else None, cameras, pose)

    return LazySequence(len(kept), read, [images[i].stem for i in kept])


def make_frame(name: str, image: Tensor, depth: Tensor | None, cameras: Cameras, world_to_camera: Tensor) -> Frame:
    """Makes a frame from a colour image [3, H, W] and a depth image [h, w], metres, of two cameras at one place."""
    size = (image.shape[1], image.shape[2])
    intrinsics = cameras.color.scaled_to(size)
    if depth is not None:
        # One calibration for both applies to the size that was chosen for the colour image.
        of_depth = Calibration(intrinsics, (size,)) if cameras.depth is cameras.color else cameras.depth
        depth_intrinsics = of_depth.scaled_to((depth.shape[0], depth.shape[1]))
        depth = register_depth(depth, depth_intrinsics, intrinsics, size)
    return Frame(image, intrinsics, world_to_camera, depth=depth, name=name)


def _order(stem: str) -> tuple[int, str]:
    """Sort key: by number, 2 before 10."""
    return (int(stem) if stem.isascii() and stem.isdigit() else -1, stem)
