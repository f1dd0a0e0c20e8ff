"""Compares visibility methods, to choose the default: `python lab/studies/visibility.py`.

Synthetic scenes have the exact depth of every pixel. A point of the cloud is truly visible if it lies at most 3 cm
behind the surface at its pixel. Pixels within 2 px of a depth edge are left out, since their ground truth depends on
sub-pixel positions. False-hidden: share of the truly visible points that a method calls hidden; false-visible: share of
the truly hidden points that a method calls visible.
"""

import argparse
import time
from unittest import mock

import report
import torch
from torchjoint_lab.synthetic import make_scene

from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.config import VisibilityConfig
from torchjoint.views import visibility
from torchjoint.views.visibility import project

#: By name: the config, and the factor on the radius of hidden point removal's sphere.
METHODS = {
    f"z-buffer, footprint {footprint:g}": (VisibilityConfig(footprint=footprint), visibility.RADIUS_FACTOR)
    for footprint in (0.5, 1.0, 1.5, 2.0)
} | {
    f"hidden point removal, radius_factor {factor:g}": (VisibilityConfig(method="hidden_point_removal"), factor)
    for factor in (0.001, 0.01, 0.1)
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="number of scenes")
    report.add_write(parser)
    arguments = parser.parse_args()
    counts = {name: torch.zeros(4) for name in METHODS}
    seconds = dict.fromkeys(METHODS, 0.0)
    num_frames = 0
    for seed in range(arguments.seeds):
        noisy = make_scene(seed, "medium")
        clean = make_scene(seed, "medium", depth_noise=0, depth_holes=0, pose_error=0)
        spacing = nearest_neighbors(noisy.scene.points, 16).spacing
        for frame, exact in zip(noisy.scene.frames, clean.scene.frames, strict=True):
            num_frames += 1
            near_edge = _near_depth_edge(exact.depth)
            for name, (config, factor) in METHODS.items():
                camera = (frame.intrinsics, frame.world_to_camera, frame.size, config)
                start = time.perf_counter()
                with mock.patch.object(visibility, "RADIUS_FACTOR", factor):
                    visible = visibility.visible_points(noisy.scene.points, spacing, *camera)
                seconds[name] += time.perf_counter() - start
                seen = torch.zeros(len(noisy.scene.points), dtype=torch.bool)
                seen[visible.point] = True
                inside = project(noisy.scene.points, *camera[:3])
                row, column = (inside.v + 0.5).long(), (inside.u + 0.5).long()
                truth = inside.z <= exact.depth[row, column] + 0.03
                judged = ~near_edge[row, column] & (exact.depth[row, column] > 0)
                called = seen[inside.point][judged]
                truth = truth[judged]
                counts[name] += torch.tensor(
                    [(~called & truth).sum(), truth.sum(), (called & ~truth).sum(), (~truth).sum()]
                )
    rows = [
        [name, f"{c[0] / c[1]:.3f}", f"{c[2] / c[3]:.3f}", f"{seconds[name] / num_frames * 1000:.0f}"]
        for name, c in counts.items()
    ]
    text = report.table(["method", "false-hidden", "false-visible", "ms a frame"], rows) + f"\n\n{report.machine()}."
    report.show("visibility", text, arguments.write)


def _near_depth_edge(depth: torch.Tensor, reach: int = 2) -> torch.Tensor:
    pool = torch.nn.functional.max_pool2d
    nearest, farthest = (-pool(-depth[None], 2 * reach + 1, 1, reach))[0], pool(depth[None], 2 * reach + 1, 1, reach)[0]
    return farthest - nearest > 0.1


if __name__ == "__main__":
    main()
