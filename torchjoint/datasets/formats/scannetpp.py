"""Reads ScanNet++ (Yeshwanth et al., ICCV 2023): one scene, data/SCENE, or its folder dslr or iphone.

scans/mesh_aligned_0.05.ply        the cloud: the mesh's vertices (fused from the iPhone's depth if absent)
scans/segments.json,               the vertices' instances (optional); a vertex of several objects belongs to the
scans/segments_anno.json           smallest, as in the data set's toolkit
dslr/colmap/                       poses in the mesh's world, and cameras, as text or .bin
dslr/resized_images/NAME.JPG       the images (fisheye); or, without distortion, resized_undistorted_images/ (or
                                   undistorted_images/), with the camera of nerfstudio/transforms_undistorted.json
iphone/rgb/frame_NNNNNN.jpg        as the toolkit (iphone/prepare_iphone_data.py) extracts them from rgb.mkv,
iphone/depth/frame_NNNNNN.png      and from depth.bin: 16-bit, millimetres (optional)
iphone/colmap/                     poses and cameras of some frames; without it all frames are read, with
iphone/pose_intrinsic_imu.json     {"frame_NNNNNN": {"aligned_pose": 4x4 camera-to-world, "intrinsic": 3x3}}

A scene has the images of dslr if they are there, else those of iphone. Images that are not there are left out. Poses
of transforms*.json are not read: their world is not that of the mesh. No scene was at hand: the layout is that of the
toolkit, github.com/scannetpp/scannetpp (common/scene_release.py, iphone/arkit_pcl.py, semantic/transforms/mesh.py).
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

from torchjoint.datasets.cameras import Camera, world_to_camera
from torchjoint.datasets.files.text import read_record
from torchjoint.datasets.formats.colmap import read_images
from torchjoint.datasets.formats.nerfstudio import read_camera
from torchjoint.datasets.recording import Options, Shot, read_shots, scene_of_frames, tell_lost, tell_unlisted
from torchjoint.datasets.truth import point_instances
from torchjoint.runtime.foreign_files import has_file, has_folder, or_unreadable
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame, Scene

WHAT = "scans/mesh_aligned_0.05.ply, dslr/colmap/ with images, or iphone/ with rgb/ (ScanNet++)"
MESH, SEGMENTS, OBJECTS = "mesh_aligned_0.05.ply", "segments.json", "segments_anno.json"
POSES, UNDISTORTED = "pose_intrinsic_imu.json", "nerfstudio/transforms_undistorted.json"
#: (H, W) of the images of an iPhone.
PHONE_SIZE = (1440, 1920)
#: The folders of a scene's cameras, and those of their images; the first that exists is used.
CAMERAS = ("dslr", "iphone")
IMAGES = ("resized_undistorted_images", "undistorted_images", "resized_images", "rgb")


def recognizes(path: Path) -> bool:
    scene, camera = _places(path)
    return has_folder(path) and (has_file(scene / "scans" / MESH) or _images(scene / camera) is not None)


def load(path: Path, options: Options) -> Scene:
    folder, camera = _places(path)
    mesh = folder / "scans" / MESH
    instances = partial(point_instances, *truth_files(path), smallest=True)
    scene = scene_of_frames(path, _read_frames(folder / camera), options, [mesh], instances=instances)
    return replace(scene, name=folder.name)


def truth_files(path: Path) -> tuple[Path, Path]:
    """Returns the file with the segment of each vertex, and the one with the objects; neither needs to exist."""
    scans = _places(path)[0] / "scans"
    return scans / SEGMENTS, scans / OBJECTS


def scenes(path: Path) -> dict[str, Path]:
    """Returns the scenes of the data set's own folder, which holds them in `data/`."""
    folders = sorted((path / "data").iterdir()) if has_folder(path / "data") else []
    return {one.name: one for one in folders if or_unreadable(recognizes, one)}


def _places(path: Path) -> tuple[Path, str]:
    """The scene's folder, and the camera whose images are read."""
    path = path.absolute()
    if path.name in CAMERAS:
        return path.parent, path.name
    return path, next((camera for camera in CAMERAS if _images(path / camera) is not None), CAMERAS[0])


def _images(folder: Path) -> Path | None:
    return next((folder / name for name in IMAGES if has_folder(folder / name)), None)


def _read_frames(folder: Path) -> LazySequence[Frame]:
    images = _images(folder)
    if images is None:
        return read_shots(())
    model = folder / "colmap"
    posed = read_images(model) if folder.name == CAMERAS[0] or has_folder(model) else _read_shots(folder / POSES)
    # A name may begin with a folder that is not there: it does not matter, nor can it lead out of the folder.
    files = [(images / Path(shot.name).name, shot) for shot in posed]
    kept = [(file, shot) for file, shot in files if has_file(file)]
    if not kept:
        raise FileNotFoundError(f"{images}: expected images that have poses, such as {files[0][0].name}, got none")
    tell_lost(str(images), (file for file, _ in files), [file for file, _ in kept])
    tell_unlisted(str(images), [file for file, _ in kept])
    if "undistorted" in images.name:
        camera = read_camera(read_record(folder / UNDISTORTED, "the camera of images"), kept[0][0])
        kept = [(file, shot._replace(camera=camera)) for file, shot in kept]
    depth = folder / "depth"
    shots = [Shot(file, one.camera, one.world_to_camera, file.stem, depth / f"{file.stem}.png") for file, one in kept]
    frames = read_shots(shots)
    frames.like_depth = "depth" if has_folder(depth) else None  # that of the iPhone is not that of dslr
    return frames


def _read_shots(file: Path) -> list[Shot]:
    """The poses of ARKit."""
    values, shots = read_record(file, "poses of an iPhone"), []
    for name in sorted(values.values):
        frame = values.record(name)
        pose = world_to_camera(frame.matrix("aligned_pose", 4), f"{frame.name}: aligned_pose")
        camera = Camera(frame.matrix("intrinsic", 3), PHONE_SIZE, name=frame.name)
        shots.append(Shot(Path(f"{name}.jpg"), camera, pose, f"{name}.jpg"))
    if not shots:
        raise ValueError(f"{file}: expected poses of frames, got none")
    return shots
