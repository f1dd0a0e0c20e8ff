"""Figures of results."""

from collections.abc import Collection
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.results.render import label_colors, render_cloud
from torchjoint.results.upright import SAMPLED, up_direction
from torchjoint.runtime.messages import printable
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene import Scene, Segmentation
from torchjoint.scene.frame import to_8_bits
from torchjoint.scene.scene import evenly_spaced_indices


def overlay(image: Tensor, labels: Tensor, num_point_segments: int | None = None) -> Tensor:
    """Blends the colours of labels over their image, half and half; borders between two labels are white.

    Args:
        image: [H, W, 3] uint8 RGB.
        labels: [H, W] int64; pixels without a label (-1) show the image.
        num_point_segments: ids >= this number have no 3D segment and are pale; None: no pale colours.

    Returns:
        [H, W, 3] uint8 RGB.
    """
    # Four bytes are one number, which is fast to look up.
    table = torch.zeros(int(labels.max()) + 2, 4, dtype=torch.uint8)
    table[:, :3] = (255 * label_colors(torch.arange(-1, len(table) - 1), num_point_segments)).round()
    paint = table.view(torch.int32).take(labels + 1).view(torch.uint8).view(*labels.shape, 4)[..., :3]
    blended = ((image.short() + paint) >> 1).to(torch.uint8)
    # NumPy sets some pixels of an image faster than torch.
    none, border, pixels = (labels < 0).numpy(), borders(labels).numpy(), blended.numpy()
    pixels[none] = image.numpy()[none]
    pixels[border] = 255
    return blended


def borders(labels: Tensor) -> Tensor:
    """Pixels whose right or lower neighbour has another label: [H, W] int64 -> [H, W] bool."""
    border = torch.zeros_like(labels, dtype=torch.bool)
    border[:, :-1] |= labels[:, :-1] != labels[:, 1:]
    border[:-1] |= labels[:-1] != labels[1:]
    return border


@on_cpu()
def overview(scene: Scene, result: Segmentation, num_frames: int = 6, names: Collection[str] = ()) -> Any:
    """Draws a matplotlib figure: input, initial and final segmentation of some frames, and the cloud.

    In the final images and in the cloud, one colour is one object; pale segments contain no point of the cloud. The
    initial segmentation has separate ids in every frame, so its colours are not comparable between frames.

    Args:
        scene: the cloud and its frames.
        result: the segmentation of the scene.
        num_frames: largest number of frames to show, evenly spread.
        names: of the frames from which these are taken, such as those with masks; empty: from all.
    """
    from matplotlib.figure import Figure

    frames = [index for index, name in enumerate(result.names) if name in names] or range(len(result.images))
    chosen = [frames[place] for place in evenly_spaced_indices(len(frames), num_frames)]
    count = len(chosen)
    width = 3.2 * max(count, 3)
    shape = max((rows / columns for rows, columns in (result.images[index].shape for index in chosen)), default=0)
    frames_height = 3 * (width / max(count, 1) * shape + 0.15) + 0.2 if count else 0.0
    figure: Any = Figure(figsize=(width, frames_height + 0.38 * width), layout="constrained")
    bottom = figure
    if count:
        top, bottom = figure.subfigures(2, 1, height_ratios=[frames_height, 0.38 * width])
        _draw_frames(top, scene, result, chosen)
    _draw_cloud(bottom, scene, result)
    return _without_tex(figure)


@on_cpu()
def cloud_figure(scene: Scene, labels: Tensor) -> Any:
    """Draws a matplotlib figure: the cloud in its own colours, and in the colours of its superpoints.

    Args:
        scene: the cloud; its frames, if there are any, determine the upward direction.
        labels: [N] int64, -1 = none.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.9), layout="constrained")
    _draw_cloud(figure, scene, Segmentation(labels, ()), "superpoints")
    return _without_tex(figure)


def _without_tex(figure: Any) -> Any:
    """Keeps LaTeX from being started: a matplotlibrc in the current folder, maybe a stranger's, can ask for it."""
    for text in figure.findobj(lambda one: hasattr(one, "set_usetex")):
        text.set_usetex(False)
    return figure


def _draw_frames(figure: Any, scene: Scene, result: Segmentation, chosen: list[int]) -> None:
    axes = figure.subplots(3 if len(result.initial_images) else 2, len(chosen), squeeze=False)
    for column, index in enumerate(chosen):
        pictures = {"input": scene.frames[index].image.permute(1, 2, 0)}
        if len(result.initial_images):  # a result that was read has none
            pictures["initial"] = label_colors(result.initial_images[index])
        pictures["final"] = label_colors(result.images[index], result.num_point_segments)
        for axis, (name, picture) in zip(axes[:, column], pictures.items(), strict=True):
            axis.imshow(to_8_bits(picture).numpy())  # matplotlib resizes bytes faster than floats
            axis.set(xticks=[], yticks=[], ylabel=name if column == 0 else "")
        axes[0, column].set_title(printable(result.names[index]), fontsize=8, parse_math=False)


def _draw_cloud(figure: Any, scene: Scene, result: Segmentation, what: str = "segments") -> None:
    colors = scene.colors
    if is_plain := colors is None or bool((colors == colors[0]).all()):
        colors = _colors_of_heights(scene)
    pictures = render_cloud(scene, torch.cat([colors, label_colors(result.points)], 1)).split(3, 2)
    titles = "cloud by height" if is_plain else "cloud", f"cloud, {result.num_point_segments} {what}"
    for axis, title, picture in zip(figure.subplots(1, 2), titles, pictures, strict=True):
        axis.imshow(to_8_bits(picture).numpy())
        axis.set(xticks=[], yticks=[], title=title)


def _colors_of_heights(scene: Scene) -> Tensor:
    """[N, 3] RGB in [0, 1]: dark blue is low, yellow is high."""
    from matplotlib import colormaps

    heights = scene.points.double() @ up_direction(scene)
    low, high = np.quantile(heights[:: -(-len(heights) // SAMPLED)].numpy(), (0.02, 0.98))
    share = ((heights - low) / max(high - low, 1e-9)).clamp(0, 1)
    return torch.from_numpy(colormaps["viridis"]((share * 255).long().numpy())[:, :3]).float()
