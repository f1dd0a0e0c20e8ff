"""Times fusing depth images, against Open3D: `python benchmarks/fusion.py RECORDING [--voxel-size 0.02 ...]`.

RECORDING has depth images and no cloud, such as the kitchen of 7-Scenes. Both get the same decoded images, in turn.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import numpy as np
import report
from interleaved import medians
from open3d import camera, geometry, pipelines
from scipy.spatial import KDTree
from torch import Tensor

import torchjoint as tj
from torchjoint.datasets.fusion import FAR
from torchjoint.datasets.volume import Volume
from torchjoint.scene import Frame

Image = tuple[Frame, Tensor]  # and its colours [H, W, 3] uint8


def ours(images: list[Image], voxel_size: float) -> np.ndarray:
    volume = Volume(voxel_size, FAR)
    for frame, color in images:
        volume.integrate(frame.depth, color, frame.intrinsics.double(), frame.world_to_camera.double())
    return volume.surface()[0].numpy()


def theirs(images: list[Image], voxel_size: float) -> np.ndarray:
    color_type = pipelines.integration.TSDFVolumeColorType.RGB8
    volume = pipelines.integration.ScalableTSDFVolume(voxel_size, 4 * voxel_size, color_type)
    for frame, color in images:
        both = geometry.RGBDImage.create_from_color_and_depth(
            geometry.Image(color.numpy()), geometry.Image(frame.depth.numpy()), 1.0, FAR, False
        )
        focal_and_center = (float(frame.intrinsics[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
        pinhole = camera.PinholeCameraIntrinsic(*frame.size[::-1], *focal_and_center)
        volume.integrate(both, pinhole, frame.world_to_camera.double().numpy())
    return np.asarray(volume.extract_point_cloud().points)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--voxel-size", type=float, nargs="+", default=[0.02, 0.01])
    arguments = parser.parse_args()
    frames = tj.load_scene(arguments.recording, fuse=False).frames
    images = [(frame, (frame.image * 255).round().byte().permute(1, 2, 0).contiguous()) for frame in frames]
    rows = []
    for voxel_size in arguments.voxel_size:
        functions = {"torchjoint": partial(ours, images, voxel_size), "Open3D": partial(theirs, images, voxel_size)}
        one, other = (function() for function in functions.values())
        apart = max(np.quantile(KDTree(b).query(a)[0], 0.95) for a, b in ((one, other), (other, one)))
        times = medians(functions)
        ratio = times["Open3D"] / times["torchjoint"]
        name = f"{arguments.recording.name}, {len(images)} images, voxels of {100 * voxel_size:g} cm"
        rows.append([name, f"{len(one):,}", f"{len(other):,}", *times.values(), ratio, 1e6 * apart])
        print(rows[-1], flush=True)
    columns = {"recording": 0, "points": 0, "Open3D's": 0, "torchjoint, ms": 0, "Open3D, ms": 0}
    report.save("fusion", [report.Table(columns | {"Open3D / torchjoint": 1, "apart, µm": 1}, rows)])


if __name__ == "__main__":
    main()
