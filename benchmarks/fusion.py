"""Fusing depth images, against Open3D: `python benchmarks/fusion.py RECORDING [--voxel-size 0.02 ...] [--rooms 4]`.

RECORDING has depth images and no cloud, such as the kitchen of 7-Scenes. Both get the same decoded images, in turn: on
the machine as it is, and while other processes keep all processors busy. Generated rooms tell how near the surface is
to the true one: their depth has noise and holes, and the truth is what the same cameras see without them.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import report
from interleaved import medians
from open3d import camera, geometry, pipelines
from scipy.spatial import KDTree
from torch import Tensor
from torchjoint_lab.synthetic import make_scene

import torchjoint as tj
from torchjoint.datasets.fusion import MAX_DEPTH
from torchjoint.datasets.volume import Volume
from torchjoint.scene import Frame

#: Points of a true surface, which are then 6 mm apart or so.
TRUE_POINTS = 800_000
Image = tuple[Frame, Tensor]  # and its colours [H, W, 3] uint8


def ours(images: list[Image], voxel_size: float) -> np.ndarray:
    volume = Volume(voxel_size, MAX_DEPTH)
    for frame, color in images:
        volume.integrate(frame.depth, color, frame.intrinsics.double(), frame.world_to_camera.double())
    return volume.surface()[0].numpy()


def theirs(images: list[Image], voxel_size: float) -> np.ndarray:
    color_type = pipelines.integration.TSDFVolumeColorType.RGB8
    volume = pipelines.integration.ScalableTSDFVolume(voxel_size, 4 * voxel_size, color_type)
    for frame, color in images:
        both = geometry.RGBDImage.create_from_color_and_depth(
            geometry.Image(color.numpy()), geometry.Image(frame.depth.numpy()), 1.0, MAX_DEPTH, False
        )
        focal_and_center = (float(frame.intrinsics[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
        pinhole = camera.PinholeCameraIntrinsic(*frame.size[::-1], *focal_and_center)
        volume.integrate(both, pinhole, frame.world_to_camera.double().numpy())
    return np.asarray(volume.extract_point_cloud().points)


def images_of(frames: Sequence[Frame]) -> list[Image]:
    return [(frame, (frame.image * 255).round().byte().permute(1, 2, 0).contiguous()) for frame in frames]


@contextmanager
def all_busy() -> Iterator[None]:
    """Keeps every processor busy with something else."""
    spinning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for one in spinning:
            one.kill()
            one.wait()


def timed(name: str, images: list[Image], voxel_size: float) -> list[str | float]:
    """Times and distances of a recording: a row of the first table."""
    functions = {"torchjoint": partial(ours, images, voxel_size), "Open3D": partial(theirs, images, voxel_size)}
    one, other = (function() for function in functions.values())
    apart = max(np.quantile(KDTree(b).query(a)[0], 0.95) for a, b in ((one, other), (other, one)))
    times = medians(functions)
    with all_busy():
        busy = medians(functions)
    ratios = [values["Open3D"] / values["torchjoint"] for values in (times, busy)]
    sizes = f"{len(one):,}", f"{len(other):,}"
    return [f"{name}, {len(images)} images, {100 * voxel_size:g} cm", *sizes, *times.values(), *ratios, 1e6 * apart]


def judged(seed: int, voxel_size: float) -> list[str | float]:
    """How near both surfaces are to that of a generated room: a row of the second table."""
    room = partial(make_scene, seed, "medium", pose_error=0.0)
    true = room(depth_noise=0.0, depth_holes=0.0, num_points=TRUE_POINTS).scene.points.numpy()
    images = images_of(room(num_points=1).scene.frames)
    found = [function(images, voxel_size) for function in (ours, theirs)]
    complete = [100 * float((KDTree(one).query(true)[0] <= voxel_size).mean()) for one in found]
    surface = KDTree(true)
    away = [(1000 * np.quantile(surface.query(one)[0], (0.5, 0.95))).tolist() for one in found]
    each = [value for both in zip(*away, strict=True) for value in both]
    return [f"room {seed}, {100 * voxel_size:g} cm", *(f"{len(one):,}" for one in found), *complete, *each]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--voxel-size", type=float, nargs="+", default=[0.02, 0.01])
    parser.add_argument("--rooms", type=int, default=4)
    arguments = parser.parse_args()
    images = images_of(tj.load_scene(arguments.recording, fuse=False).frames)
    speed, distance = [], []
    for voxel_size in arguments.voxel_size:
        speed.append(timed(arguments.recording.name, images, voxel_size))
        print(speed[-1], flush=True)
        distance += [judged(seed, voxel_size) for seed in range(arguments.rooms)]
        print(distance[-arguments.rooms :], flush=True)
    columns = {"recording": 0, "points": 0, "Open3D's": 0, "torchjoint, ms": 0, "Open3D, ms": 0}
    columns |= {"Open3D / torchjoint": 1, "on a busy machine": 1, "apart, µm": 1}
    of_rooms = {"room": 0, "points": 0, "Open3D's": 0, "complete, %": 1, "Open3D's, %": 1}
    of_rooms |= {"half within, mm": 1, "Open3D's, mm": 1, "95 % within, mm": 1, "of Open3D's, mm": 1}
    title = "Against the truth: true points with a fused one within a voxel; fused points' distance from true ones"
    report.save("fusion", [report.Table(columns, speed), report.Table(of_rooms, distance, title)])


if __name__ == "__main__":
    main()
