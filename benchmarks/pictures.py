"""Makes pictures for the documents from generated scenes: `python benchmarks/pictures.py` (about a minute).

docs/mistakes.jpg and the table of messages in docs/your_data.md; docs/parameters-images.jpg and parameters-scan.jpg.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import report
import torch
from matplotlib.figure import Figure
from torch import Tensor

import torchjoint as tj
from torchjoint.config import VisibilityConfig
from torchjoint.points.lidar.scan_segments import segment_scan
from torchjoint.points.neighbors import nearest_neighbors
from torchjoint.results.label_colors import label_colors
from torchjoint.results.render import render_cloud
from torchjoint.views.pose_check import PoseWarning, check_poses
from torchjoint.views.projection import project
from torchjoint.views.visibility import Visible, visible_points

DOCS = Path(__file__).parents[1] / "docs"
#: OpenCV's axes (x right, y down, z forward) from OpenGL's (x right, y up, z backward).
FLIP = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))


def recording() -> tj.Scene:
    """A small room of which the depth images are known."""
    return tj.synthetic.make_scene(seed=0, num_views=6, height=180, width=240, num_points=30_000).scene


def _with_poses(scene: tj.Scene, change: Callable[[Tensor], Tensor]) -> tj.Scene:
    frames = [replace(frame, world_to_camera=change(frame.world_to_camera)) for frame in scene.frames]
    return replace(scene, frames=frames)


def _of_other_frames(scene: tj.Scene) -> tj.Scene:
    poses = [frame.world_to_camera for frame in scene.frames]
    frames = [replace(f, world_to_camera=pose) for f, pose in zip(scene.frames, reversed(poses), strict=True)]
    return replace(scene, frames=frames)


def _in_millimetres(pose: Tensor) -> Tensor:
    pose = pose.clone()
    pose[:3, 3] *= 1000
    return pose


def _of_another_size(scene: tj.Scene) -> tj.Scene:
    double = torch.tensor([2.0, 2.0, 1.0], dtype=torch.float64)
    frames = [replace(frame, intrinsics=double[:, None] * frame.intrinsics) for frame in scene.frames]
    return replace(scene, frames=frames)


MISTAKES: dict[str, Callable[[tj.Scene], tj.Scene]] = {
    "none": lambda scene: scene,
    "poses are camera-to-world": lambda scene: _with_poses(scene, torch.linalg.inv),
    "axes of OpenGL: y up, z backward": lambda scene: _with_poses(scene, lambda pose: FLIP @ pose),
    "translations in millimetres": lambda scene: _with_poses(scene, _in_millimetres),
    "intrinsics of an image twice as large": _of_another_size,
    "poses of other frames": _of_other_frames,
}


def message(scene: tj.Scene) -> str:
    """What the check of the poses says."""
    spacing = nearest_neighbors(scene.points, 4).spacing
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_poses(scene, spacing, VisibilityConfig())
    said = [str(warning.message) for warning in caught if issubclass(warning.category, PoseWarning)]
    return "; ".join(text.partition(": ")[2] for text in said)


def messages() -> str:
    """The table of mistakes, in Markdown."""
    scene = recording()
    rows = [[name, message(make(scene)) or "nothing"] for name, make in MISTAKES.items()]
    return report.table(["mistake", "warning"], rows).replace("---:", "---")


def draw_mistakes() -> Figure:
    """The first image of the recording, grey, and what the camera sees of the cloud, in the colours of the points."""
    right = recording()
    figure = Figure(figsize=(10, 5.6), layout="constrained")
    for axis, (name, make) in zip(figure.subplots(2, 3).flat, MISTAKES.items(), strict=True):
        scene = make(right)
        frame = scene.frames[0]
        picture = (0.3 + 0.5 * frame.image.mean(0))[..., None].repeat(1, 1, 3)
        seen = project(scene.points, frame.intrinsics, frame.world_to_camera, frame.size)
        near_last = seen.z.argsort(descending=True)
        row, column = seen.v.round().long()[near_last], seen.u.round().long()[near_last]
        _dots(picture, row, column, scene.colors[seen.point[near_last]])
        axis.imshow(picture.clamp(0, 1).numpy())
        axis.set(title="as it should be" if name == "none" else name, xticks=[], yticks=[])
    return figure


def _dots(picture: Tensor, row: Tensor, column: Tensor, colors: Tensor) -> None:
    """Draws squares of 2 x 2 pixels into a picture [H, W, 3], the last over the others."""
    height, width, _ = picture.shape
    for down, right in itertools.product((0, 1), (0, 1)):
        picture[(row + down).clamp(0, height - 1), (column + right).clamp(0, width - 1)] = colors


def draw_images() -> Figure:
    """Initial segments, and visible points, for values of parameters that are too low, the default, and too high."""
    scene = tj.synthetic.make_domain_scene("desk", seed=40, num_views=6, num_points=30_000).scene
    frame = scene.frames[0]
    values = {"image_segments.scale": (0.1, 3.0, 100.0), "image_segments.min_size": (5, 100, 3000)}
    figure = Figure(figsize=(10, 6.6), layout="constrained")
    rows = figure.subplots(3, 4)
    for axes, (name, three) in zip(rows, values.items(), strict=False):
        axes[0].imshow(frame.image.permute(1, 2, 0).numpy())
        axes[0].set_ylabel(name)
        for axis, value in zip(axes[1:], three, strict=True):
            segmenter = tj.JointSegmenter(tj.Config().set([f"{name}={value}"]))
            segmenter.reset(scene.points, scene.colors)
            segmenter.update(frame)
            axis.imshow(label_colors(segmenter.state.observations[0].labels).numpy())
            axis.set_title(str(value))
    rows[2, 0].imshow(frame.image.permute(1, 2, 0).numpy())
    rows[2, 0].set_ylabel("visibility.depth_tolerance")
    spacing = nearest_neighbors(scene.points, 4).spacing
    for axis, value in zip(rows[2, 1:], (0.0005, 0.01, 0.3), strict=True):
        config = VisibilityConfig(depth_tolerance=value)
        seen = visible_points(scene.points, spacing, frame.intrinsics, frame.world_to_camera, frame.size, config)
        axis.imshow(_by_distance(frame, seen).numpy())
        axis.set_title(f"{value}: {len(seen.point):,} points")
    for axis in rows.flat:
        axis.set(xticks=[], yticks=[])
    return figure


def _by_distance(frame: tj.Frame, seen: Visible) -> Tensor:
    """The image in grey, its visible points in colours of their distance."""
    picture = (0.5 + 0.5 * frame.image.mean(0))[..., None].repeat(1, 1, 3)
    low, high = seen.z.quantile(torch.tensor([0.02, 0.98])).tolist()
    near = ((high - seen.z) / (high - low)).clamp(0, 1)
    order = seen.z.argsort(descending=True)
    _dots(picture, seen.row[order], seen.column[order], torch.stack([near, 0.2 + 0 * near, 1 - near], 1)[order])
    return picture


def draw_scan() -> Figure:
    """Segments of a scan for values of parameters that are too low, the default, and too high."""
    scene = tj.synthetic.make_domain_scene("street", seed=40).scene
    near = scene.points[:, :2].norm(dim=1) < 25
    scene = tj.Scene(scene.points[near])
    values = {"object_height": (0.02, 0.25, 1.5), "gap": (0.03, 0.2, 1.5)}
    figure = Figure(figsize=(10, 5.4), layout="constrained")
    for axes, (name, three) in zip(figure.subplots(2, 3), values.items(), strict=True):
        for axis, value in zip(axes, three, strict=True):
            config = tj.Config().set([f"scan.{name}={value}"]).scan
            labels = segment_scan(scene.points, config)
            axis.imshow(render_cloud(scene, label_colors(labels), (330, 440)).numpy())
            axis.set(title=f"scan.{name} {value}: {int(labels.max()) + 1} segments", xticks=[], yticks=[])
    return figure


def main() -> None:
    """Writes pictures and table."""
    jpeg = {"dpi": 100, "pil_kwargs": {"quality": 85, "subsampling": 0}}
    draw_mistakes().savefig(DOCS / "mistakes.jpg", **jpeg)
    draw_images().savefig(DOCS / "parameters-images.jpg", **jpeg)
    draw_scan().savefig(DOCS / "parameters-scan.jpg", **jpeg)
    report.write_part("mistakes", messages(), DOCS / "your_data.md")


if __name__ == "__main__":
    main()
