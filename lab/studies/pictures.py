"""Makes pictures for the documents from generated scenes: `python lab/studies/pictures.py` (about two minutes).

docs/mistakes.jpg and the table of messages in docs/your_data.md; docs/parameters-images.jpg and parameters-scan.jpg;
docs/instances.jpg; docs/meshes.jpg and boxes.jpg, which need Open3D.
"""

from __future__ import annotations

import itertools
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import report
import torch
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from normals import of_mesh
from torch import Tensor
from torch.nn.functional import normalize
from torchjoint_lab.evaluation.predictions import read_prediction
from torchjoint_lab.synthetic import make_domain_scene, make_scene

import torchjoint as tj
from torchjoint.cloud.local import LocalFrame
from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.config import VisibilityConfig
from torchjoint.metrics.scannet import scannet_average_precision
from torchjoint.results.boxes import boxes_of
from torchjoint.results.exports import FORMATS
from torchjoint.results.render import label_colors, render_cloud
from torchjoint.scene.frame import PoseWarning
from torchjoint.segments.scan.method import segment_levels
from torchjoint.views.pose_check import PoseCheck, frames_to_check
from torchjoint.views.visibility import Visible, project, visible_points

DOCS = Path(__file__).parents[2] / "docs"
#: OpenCV's axes (x right, y down, z forward) from OpenGL's (x right, y up, z backward).
FLIP = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))


def recording() -> tj.Scene:
    """A small room of which the depth images are known."""
    return make_scene(seed=0, num_views=6, height=180, width=240, num_points=30_000).scene


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
        check = PoseCheck(scene.cloud, spacing, VisibilityConfig(), LocalFrame.of_world(), scene.name)
        check.check_all(frames_to_check(scene).values())
        check.warn()
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
    figure = Figure(figsize=(10, 6.9), layout="constrained")
    rows = figure.subplots(3, 4)
    _draw_initial_segments(rows[:2])
    _draw_visible_points(rows[2])
    for axis in rows.flat:
        axis.set(xticks=[], yticks=[])
    return figure


def _draw_initial_segments(rows: Any) -> None:
    """A table with a printed cloth."""
    scene = make_domain_scene("table", seed=40, num_views=4, num_points=20_000).scene
    frame = scene.frames[0]
    values = {"image_segments.scale": (0.1, 3.0, 100.0), "image_segments.min_size": (5, 100, 3000)}
    for axes, (name, three) in zip(rows, values.items(), strict=True):
        axes[0].imshow(frame.image.permute(1, 2, 0).numpy())
        axes[0].set_ylabel(name)
        for axis, value in zip(axes[1:], three, strict=True):
            segmenter = tj.JointSegmenter(tj.Config().set([f"{name}={value}"]))
            segmenter.reset(scene.points, scene.colors)
            segmenter.update(frame)
            labels = segmenter.state.observations[0].labels
            axis.imshow(label_colors(labels).numpy())
            axis.set_title(f"{value}: {len(labels.unique())} segments")


def _draw_visible_points(axes: Any) -> None:
    """A screen in front of a wall: points that each tolerance loses or adds, beside those of the default, are red."""
    scene = make_domain_scene("desk", seed=40, num_views=6, num_points=30_000).scene
    frame = scene.frames[0]
    spacing = nearest_neighbors(scene.points, 4).spacing
    axes[0].imshow(frame.image.permute(1, 2, 0).numpy())
    axes[0].set_ylabel("visibility.depth_tolerance")

    def seen(value: float) -> Visible:
        config = VisibilityConfig(depth_tolerance=value)
        return visible_points(scene.points, spacing, frame.intrinsics, frame.world_to_camera, frame.size, config)

    low, usual, high = map(seen, (0.0005, 0.01, 0.3))
    lost, added = ~torch.isin(usual.point, low.point), ~torch.isin(high.point, usual.point)
    for axis, title, points, red in (
        (axes[1], f"0.0005: {int(lost.sum())} points are lost", usual, lost),
        (axes[2], f"0.01: {len(usual.point):,} points", usual, torch.zeros_like(lost)),
        (axes[3], f"0.3: {int(added.sum()):,} points are added", high, added),
    ):
        axis.imshow(_marked(frame, points, red).numpy())
        axis.set_title(title)


def _marked(frame: tj.Frame, seen: Visible, red: Tensor) -> Tensor:
    """The image in grey, its visible points in blue, some [M] of them red and over the others."""
    picture = (0.5 + 0.5 * frame.image.mean(0))[..., None].repeat(1, 1, 3)
    order = red.int().argsort(stable=True)
    colors = torch.where(red[order, None], torch.tensor([0.9, 0.0, 0.0]), torch.tensor([0.45, 0.6, 0.85]))
    _dots(picture, seen.row[order], seen.column[order], colors)
    return picture


def draw_scan() -> Figure:
    """Segments of scans for values of parameters that are too low, the default, and too high."""
    streets = {"object_height": (43, 16), "gap": (40, 25)}  # seed, and metres around the sensor
    values = {"object_height": (0.02, 0.25, 1.5), "gap": (0.03, 0.2, 1.5)}
    figure = Figure(figsize=(10, 5.6), layout="constrained")
    for axes, (name, (seed, radius)) in zip(figure.subplots(2, 3), streets.items(), strict=True):
        points = make_domain_scene("street", seed=seed).scene.points
        scene = tj.Scene(points[points[:, :2].norm(dim=1) < radius])
        for axis, value in zip(axes, values[name], strict=True):
            labels = segment_levels(scene.points, tj.Config().set([f"scan.{name}={value}"]).scan).at()
            axis.imshow(render_cloud(scene, label_colors(labels), (330, 440)).numpy())
            axis.set(title=f"scan.{name} {value}: {int(labels.max()) + 1} segments", xticks=[], yticks=[])
    return figure


def segmented_mesh() -> tj.Result:
    """The vertices of a room that was fused to a mesh, and their segments."""
    (room, _, kinds), _ = of_mesh(make_scene(12, "medium"))
    scene = tj.Scene(room.points.float(), colors=room.colors, normals=kinds["triangles"])
    return tj.Result.of(tj.JointSegmenter()(scene), scene)


def draw_mesh(result: tj.Result) -> Figure:
    """A mesh, its segments, and the segments apart, as in files of their own."""
    points, normals, labels = result.scene.points, result.scene.normals, result.points
    light = normalize(torch.tensor([0.3, -0.5, 0.8]), dim=0)
    shade = 0.55 + 0.45 * (normals @ light)[:, None]
    middles = torch.stack([points[labels == one].mean(0) for one in range(result.num_point_segments)])
    apart = points + 0.8 * (middles - points.mean(0))[labels]
    figure = Figure(figsize=(10, 2.75), layout="constrained")
    three = (points, result.scene.colors), (points, label_colors(labels)), (apart, result.scene.colors)
    for axis, (at, colors) in zip(figure.subplots(1, 3), three, strict=True):
        axis.imshow(render_cloud(tj.Scene(at), (colors * shade).clamp(0, 1), (500, 640)).numpy())
        axis.set(xticks=[], yticks=[])
    return figure


def draw_boxes(result: tj.Result) -> Figure:
    """A cloud, and the boxes of its things that are no walls and not tiny."""
    boxes = {one: box for one, box in boxes_of(result).items() if 0.2 < max(box.size) < 2.5}
    corners = torch.tensor(list(itertools.product((-0.5, 0.5), repeat=3)), dtype=torch.float64)
    pairs = [pair for pair in itertools.combinations(corners, 2) if (pair[0] != pair[1]).sum() == 1]
    edges = torch.cat([torch.lerp(*pair, torch.linspace(0, 1, 200, dtype=torch.float64)[:, None]) for pair in pairs])
    points, colors = [result.scene.points.double()], [0.4 + 0.6 * result.scene.colors]
    for one, box in boxes.items():
        turn = torch.tensor([box.yaw]).double()
        turned = torch.tensor([[turn.cos(), turn.sin(), 0], [-turn.sin(), turn.cos(), 0], [0, 0, 1]]).double()
        points.append(edges * torch.tensor(box.size) @ turned + torch.tensor(box.center))
        colors.append(label_colors(torch.full((len(edges),), one)))
    figure = Figure(figsize=(6, 4.2), layout="constrained")
    axis = figure.subplots()
    axis.imshow(render_cloud(tj.Scene(torch.cat(points)), torch.cat(colors), (560, 800)).numpy())
    axis.set(xticks=[], yticks=[])
    return figure


def draw_instances() -> Figure:
    """A room's true instances, and what `export --format masks` writes: the predicted ones and their scores."""
    scene = make_scene(12, "medium").scene
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "predictions.npz"
        FORMATS["masks"](file, tj.Result.of(tj.JointSegmenter()(scene), scene))
        found = read_prediction(file, scene)
    ap, ap50, ap25 = scannet_average_precision(found.instances.points, scene.truth.points, found.scores)
    number = len(found.instances.points)
    sure = torch.tensor(colormaps["viridis"](found.scores.numpy())[:, :3]).float()
    three = {
        f"truth: {len(scene.truth.points[scene.truth.points >= 0].unique())} instances": label_colors(
            scene.truth.points
        ),
        f"{number} predictions: AP {ap:.2f}, AP50 {ap50:.2f}, AP25 {ap25:.2f}": label_colors(found.points),
        "their scores": sure[found.points],
    }
    figure = Figure(figsize=(9.6, 2.65), layout="constrained")
    axes = figure.subplots(1, 3)
    for axis, (title, colors) in zip(axes, three.items(), strict=True):
        axis.imshow(render_cloud(scene, colors, (420, 520)).numpy())
        axis.set(xticks=[], yticks=[])
        axis.set_title(title, fontsize=10)
    figure.colorbar(ScalarMappable(cmap="viridis"), ax=axes[2], shrink=0.8)
    return figure


def main() -> None:
    """Writes pictures and table."""
    jpeg = {"dpi": 100, "pil_kwargs": {"quality": 85, "subsampling": 0}}
    draw_mistakes().savefig(DOCS / "mistakes.jpg", **jpeg)
    draw_images().savefig(DOCS / "parameters-images.jpg", **jpeg)
    draw_scan().savefig(DOCS / "parameters-scan.jpg", **jpeg)
    draw_instances().savefig(DOCS / "instances.jpg", **jpeg)
    result = segmented_mesh()
    draw_mesh(result).savefig(DOCS / "meshes.jpg", **jpeg)
    draw_boxes(result).savefig(DOCS / "boxes.jpg", **jpeg)
    report.write_part("mistakes", messages(), DOCS / "your_data.md")


if __name__ == "__main__":
    main()
