"""Reads the TUM RGB-D benchmark (J. Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012).

rgb.txt                  one line per image: timestamp (seconds), path
depth.txt                the same for depth images (optional): 16-bit, 5000 per metre, registered to colour, 0 = unknown
groundtruth.txt          timestamp tx ty tz qx qy qz qw: pose of the colour camera, camera-to-world, OpenCV axes
camera-intrinsics.txt    3x3 (optional, not part of the benchmark)
cloud.ply                the cloud (optional: fused from depth if absent)

The clocks of images, depth and poses are independent. An image gets the depth image nearest in time, within 0.02 s; the
nearest pairs are matched first and each image is used once, as in the benchmark's own tool. The pose of an image is
interpolated between the previous and the next pose (the rotation spherically). Images without a pose within 0.02 s, for
example before tracking began, are left out.

Without camera-intrinsics.txt, the name of the folder or of one above it (freiburg1, 2 or 3) selects a published
calibration, and colour and depth are undistorted. Other names are an error: recordings of this layout have all cameras.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from torchjoint.datasets.cameras import Camera, interpolate_poses, invert_pose, pinhole_matrix
from torchjoint.datasets.files.readers import read_matrix
from torchjoint.datasets.files.text import fields, frame_names, parse_numbers, path_inside, read_lines, read_timed_rows
from torchjoint.datasets.recording import Options, Shot, posed, read_shots, scene_of_frames, tell_unlisted
from torchjoint.runtime.foreign_files import has_file, has_folder, present
from torchjoint.runtime.groups import each_once
from torchjoint.scene import Frame, Scene

WHAT = "rgb.txt and groundtruth.txt, with rgb/ depth.txt depth/ (TUM RGB-D benchmark)"

#: Largest difference between the timestamps of a match, seconds.
TOLERANCE = 0.02
#: Metres per unit of the depth images.
DEPTH_UNIT = 1 / 5000
#: Published calibrations, all of 640 x 480 images: fx, fy, cx, cy, and OpenCV's k1, k2, p1, p2, k3.
_CALIBRATIONS = {
    "1": (517.306408, 516.469215, 318.643040, 255.313989, (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)),
    "2": (520.908620, 521.007327, 325.141442, 249.701764, (0.231222, -0.784899, -0.003257, -0.000105, 0.917205)),
    "3": (535.4, 539.2, 320.1, 247.6, ()),
}


def recognizes(path: Path) -> bool:
    return has_folder(path) and has_file(path / "rgb.txt") and has_file(path / "groundtruth.txt")


def load(path: Path, options: Options) -> Scene:
    return scene_of_frames(path, read_frames(path), options)


def read_frames(path: Path) -> Sequence[Frame]:
    """Returns the frames of a recording; each frame is read on access."""
    colors = _read_files(path / "rgb.txt")
    depths = _read_files(path / "depth.txt") if has_file(path / "depth.txt") else []
    times, images = [time for time, _ in colors], [file for _, file in colors]
    depth_of = dict(associate(times, [time for time, _ in depths]))
    track = path / "groundtruth.txt"
    rows = read_timed_rows(track, "timestamp tx ty tz qx qy qz qw", 8)
    poses = interpolate_poses(rows, np.array(times), TOLERANCE, str(track))
    kept = posed(list(enumerate(poses)), str(path), track.name, TOLERANCE)
    tell_unlisted(str(path), images)
    camera, shots = _camera(path), []
    for (index, pose), name in zip(kept, frame_names([str(images[index]) for index, _ in kept]), strict=True):
        color, depth = images[index], depths[depth_of[index]][1] if index in depth_of else None
        for file in (color, depth or color):
            present(file, "the image that rgb.txt or depth.txt lists")
        shots.append(Shot(color, camera, invert_pose(pose), name, depth, DEPTH_UNIT, first=images[kept[0][0]]))
    return read_shots(shots)


def associate(first: Sequence[float], second: Sequence[float], tolerance: float = TOLERANCE) -> list[tuple[int, int]]:
    """Matches timestamps greedily: the nearest pair first, then the nearest of the rest. Each timestamp is used once.

    Args:
        first: seconds, ascending.
        second: seconds, ascending; at most 200 Hz, so that only the 8 nearest candidates need to be tested.
        tolerance: largest difference in a pair, seconds.

    Returns:
        Pairs of indices into `first` and `second`, in the order of `first`.
    """
    candidates = []
    for i, place in enumerate(np.searchsorted(second, first)):
        near = range(max(int(place) - 4, 0), min(int(place) + 4, len(second)))
        candidates += [(abs(first[i] - second[j]), i, j) for j in near]
    return sorted(each_once((i, j) for apart, i, j in sorted(candidates) if apart <= tolerance).items())


def _read_files(path: Path) -> list[tuple[float, Path]]:
    """Reads a list of timestamps and paths, sorted by time; of lines with equal times the first is used."""
    files: dict[float, Path] = {}
    for name, (time, file) in fields(read_lines(path, "lines of a time and a path"), "a timestamp and a path", 2):
        files.setdefault(parse_numbers([time], name)[0], path_inside(path.parent, file, name))
    return sorted(files.items())


def _camera(path: Path) -> Camera:
    file = path / "camera-intrinsics.txt"
    if has_file(file):
        return Camera(read_matrix(file, (3, 3)), name=str(file))
    known = re.findall(r"(?<![a-z0-9])(?:freiburg|fr)([123])(?![0-9])", str(path.absolute()))
    if not known:
        told = f"{path}: expected camera-intrinsics.txt with fx 0 cx, 0 fy cy, 0 0 1 in pixels of its images"
        raise ValueError(f"{told}, or a name of the TUM benchmark (freiburg1, 2, 3), found neither")
    fx, fy, cx, cy, distortion = _CALIBRATIONS[known[-1]]
    return Camera(pinhole_matrix(fx, fy, cx, cy), (480, 640), distortion, name=f"calibration of {path.name}")
