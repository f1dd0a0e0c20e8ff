"""Figures, a viewer for the browser, and one colour for one object everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.render import render_cloud
from torchjoint.scene import Scene, Segmentation

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


def overview(scene: Scene, result: Segmentation, num_frames: int = 6) -> Any:
    """A matplotlib figure: for some frames the input, the initial and the final segmentation; and the cloud.

    In the final images and in the cloud one colour is one object; pale regions have no point of the cloud. The
    initial segmentations have ids, and so colours, of their own in every frame.
    """
    from matplotlib.figure import Figure

    count = min(num_frames, len(result.images))
    width = 3.2 * max(count, 3)
    shape = max((image.shape[0] / image.shape[1] for image in result.initial_images), default=0)
    frames_height = 3 * (width / max(count, 1) * shape + 0.15) + 0.2 if count else 0.0
    figure = Figure(figsize=(width, frames_height + 0.38 * width), layout="constrained")
    if not count:
        _draw_cloud(figure, scene, result)
        return figure
    parts: Any = figure.subfigures(2, 1, height_ratios=[frames_height, 0.38 * width])
    top, bottom = parts
    _draw_frames(top, scene, result, torch.linspace(0, len(result.images) - 1, count).round().long().tolist())
    _draw_cloud(bottom, scene, result)
    return figure


def cloud_figure(scene: Scene, labels: Tensor) -> Any:
    """A matplotlib figure: the cloud in its colours, and beside it in those of its labels.

    Args:
        scene: the cloud; its frames, where there are any, tell which way is up.
        labels: [N] int64, -1 = none.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.9), layout="constrained")
    _draw_cloud(figure, scene, Segmentation(labels, ()))
    return figure


def _draw_frames(figure: Any, scene: Scene, result: Segmentation, chosen: list[int]) -> None:
    axes = figure.subplots(3, len(chosen), squeeze=False)
    for column, index in enumerate(chosen):
        pictures = {
            "input": scene.frames[index].image.permute(1, 2, 0),
            "initial": label_colors(result.initial_images[index]),
            "final": label_colors(result.images[index], result.num_point_segments),
        }
        for axis, (name, picture) in zip(axes[:, column], pictures.items(), strict=True):
            axis.imshow(picture.numpy())
            axis.set(xticks=[], yticks=[], ylabel=name if column == 0 else "")
        axes[0, column].set_title(result.names[index], fontsize=8)


def _draw_cloud(figure: Any, scene: Scene, result: Segmentation) -> None:
    colors = scene.colors if scene.colors is not None else torch.full_like(scene.points, 0.7)
    clouds = {"cloud": colors, f"cloud, {result.num_point_segments} segments": label_colors(result.points)}
    for axis, (title, paint) in zip(figure.subplots(1, 2), clouds.items(), strict=True):
        axis.imshow(render_cloud(scene, paint).numpy())
        axis.set(xticks=[], yticks=[], title=title)


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
