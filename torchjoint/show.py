"""Pictures: figures, a viewer for the browser, and one colour for one object everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.config import VisibilityConfig
from torchjoint.scene import Scene, Segmentation
from torchjoint.visibility import visible_points

NONE_COLOR = 0.12


def label_colors(labels: Tensor, num_point_segments: int | None = None) -> Tensor:
    """A colour for each label: the same id has the same colour in every picture and cloud.

    Args:
        labels: [...] int64, -1 = none (dark grey).
        num_point_segments: ids from here on have no 3D segment and are drawn pale.

    Returns:
        [..., 3] float32 RGB in [0, 1].
    """
    from matplotlib.colors import hsv_to_rgb

    ids = labels.clamp(min=0).double().numpy()
    # Steps of the golden ratio spread hues so that neighbouring ids never look alike.
    hue = np.mod(0.07 + ids * 0.6180339887498949, 1.0)
    saturation = 0.45 + 0.5 * np.mod(ids * 0.7548776662466927, 1.0)
    value = 0.6 + 0.4 * np.mod(ids * 0.5698402909980532, 1.0)
    if num_point_segments is not None:
        pale = labels.numpy() >= num_point_segments
        saturation = np.where(pale, 0.15, saturation)
        value = np.where(pale, 0.35 + 0.3 * value, value)
    colors = torch.from_numpy(hsv_to_rgb(np.stack([hue, saturation, value], axis=-1))).float()
    return torch.where(labels[..., None] < 0, NONE_COLOR, colors)


def overview(scene: Scene, result: Segmentation, num_frames: int = 5) -> Any:
    """A matplotlib figure: for some frames the input, the initial and the final segmentation; and the cloud.

    In the final images and in the cloud one colour is one object; pale regions have no point of the cloud. The
    initial segmentations have ids, and so colours, of their own in every frame.
    """
    from matplotlib.figure import Figure

    count = min(num_frames, len(result.images))
    chosen = torch.linspace(0, len(result.images) - 1, count).round().long().tolist() if count else []
    num_segments = result.num_point_segments
    figure = Figure(figsize=(3.2 * max(count, 2), 2.5 * (3 if count else 0) + 5.0), layout="constrained")
    top: Any = None
    bottom: Any = figure
    if count:
        top, bottom = figure.subfigures(2, 1, height_ratios=[7.5, 5.0])
    if top is not None:
        axes = top.subplots(3, count, squeeze=False)
        for column, index in enumerate(chosen):
            pictures = (
                scene.frames[index].image.permute(1, 2, 0),
                label_colors(result.initial_images[index]),
                label_colors(result.images[index], num_segments),
            )
            for row, picture in enumerate(pictures):
                axes[row, column].imshow(picture.numpy())
                axes[row, column].set(xticks=[], yticks=[])
            axes[0, column].set_title(result.names[index], fontsize=8)
        for row, name in enumerate(("input", "initial", "final")):
            axes[row, 0].set_ylabel(name)
    cloud_axes = bottom.subplots(1, 2)
    clouds = ((scene.colors, "cloud"), (label_colors(result.points), f"cloud, {num_segments} segments"))
    for axis, (colors, title) in zip(cloud_axes, clouds, strict=True):
        picture = render_cloud(scene, colors if colors is not None else torch.full_like(scene.points, 0.7))
        axis.imshow(picture.numpy())
        axis.set(xticks=[], yticks=[], title=title)
    return figure


def render_cloud(scene: Scene, colors: Tensor, size: tuple[int, int] = (480, 640)) -> Tensor:
    """Draws the cloud from behind and above the cameras (or from a corner, without any): [H, W, 3]."""
    pose, focal = _bird_view(scene, size)
    intrinsics = torch.tensor([[focal, 0, size[1] / 2], [0, focal, size[0] / 2], [0, 0, 1]], dtype=torch.float64)
    spacing = _spacing(scene.points)
    picture = torch.ones(size[0] * size[1], 3)
    depth = torch.full((size[0] * size[1],), torch.inf)
    config = VisibilityConfig(near=0.01, far=1e6, depth_tolerance=float(spacing) * 3)
    seen = visible_points(scene.points, spacing.expand(len(scene.points)), intrinsics, pose, size, config)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            pixel = (seen.row + down).clamp(0, size[0] - 1) * size[1] + (seen.column + right).clamp(0, size[1] - 1)
            depth.scatter_reduce_(0, pixel, seen.z, "amin")
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            pixel = (seen.row + down).clamp(0, size[0] - 1) * size[1] + (seen.column + right).clamp(0, size[1] - 1)
            front = seen.z <= depth[pixel]
            picture[pixel[front]] = colors[seen.point[front]]
    return picture.view(*size, 3)


def write_viewer(path: Path, points: Tensor, labels: Tensor, colors: Tensor | None, most: int = 150_000) -> None:
    """Writes a page that shows the cloud in any browser, to be turned with the mouse; needs no network.

    Args:
        points: [N, 3]; labels: [N]; colors: [N, 3] or None. Clouds of more than `most` points are thinned evenly.
    """
    import plotly.graph_objects as go

    keep = torch.arange(0, len(points), max(1, -(-len(points) // most)))
    shown = points[keep].numpy()
    paints = {"segments": label_colors(labels[keep])} | ({} if colors is None else {"colours": colors[keep]})
    figure = go.Figure()
    for name, paint in paints.items():
        figure.add_scatter3d(
            x=shown[:, 0], y=shown[:, 1], z=shown[:, 2], mode="markers", name=name, text=labels[keep].numpy(),
            hovertemplate="segment %{text}<extra></extra>", visible=name == "segments",
            marker={"size": 1.6, "color": [f"rgb({r},{g},{b})" for r, g, b in (paint * 255).int().tolist()]},
        )  # fmt: skip
    buttons = [
        {"label": name, "method": "update", "args": [{"visible": [name == other for other in paints]}]}
        for name in paints
    ]
    figure.update_layout(
        scene={"aspectmode": "data"}, margin={"l": 0, "r": 0, "t": 0, "b": 0}, showlegend=False,
        updatemenus=[{"type": "buttons", "direction": "left", "x": 0.02, "y": 0.98, "buttons": buttons}],
    )  # fmt: skip
    figure.write_html(path, include_plotlyjs=True)


def _spacing(points: Tensor) -> Tensor:
    """A typical distance of neighbouring points, taken from the area of the cloud's bounding box."""
    extent = (points.quantile(0.98, dim=0) if len(points) < 1_000_000 else points.amax(0)) - points.amin(0)
    return (extent.square().sum() / len(points)).sqrt().clamp(min=1e-6)


def _bird_view(scene: Scene, size: tuple[int, int]) -> tuple[Tensor, float]:
    """World-to-camera pose and focal length of a camera that sees most of the cloud."""
    points = scene.points.double()
    center = points.median(dim=0).values
    radius = (
        (points - center).norm(dim=1).quantile(0.9)
        if len(points) < 1_000_000
        else (points - center).norm(dim=1).mean() * 1.5
    )
    count = min(16, len(scene.frames))
    poses = [scene.frames[i].world_to_camera for i in torch.linspace(0, len(scene.frames) - 1, count).long().tolist()]
    if poses:
        # Hand-held and mounted cameras are upright: the mean of -y is up, the mean of z where they look.
        up = -torch.stack([pose[1, :3] for pose in poses]).mean(0)
        forward = torch.stack([pose[2, :3] for pose in poses]).mean(0)
    else:
        up, forward = points.new_tensor([0.0, 0.0, 1.0]), points.new_tensor([1.0, 1.0, 0.0])
    up = up / up.norm().clamp(min=1e-9)
    forward = forward - up * (up @ forward)
    if forward.norm() < 1e-3:
        forward = torch.linalg.cross(up, up.roll(1))
    forward = forward / forward.norm() - 0.9 * up  # look down at about 40 degrees
    forward = forward / forward.norm()
    right = torch.linalg.cross(forward, up)
    right = right / right.norm().clamp(min=1e-9)
    down = torch.linalg.cross(forward, right)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = torch.stack([right, down, forward])
    pose[:3, 3] = -(pose[:3, :3] @ (center - 2.6 * radius.clamp(min=1e-6) * forward))
    return pose, 1.15 * size[1]
