"""A picture of the worst scene of each set of real recordings: its truth, and its segments."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchjoint.results.render import label_colors, render_cloud
from torchjoint.runtime.files import atomic_write
from torchjoint.scene import Scene
from torchjoint_lab.benchmark.real import Results, labels_of_first, worst_scenes
from torchjoint_lab.benchmark.real_scenes import RealScene

#: Metres around a sensor that are drawn.
NEAR = 25.0
#: Columns of scenes.
COLUMNS = 2
SIZE = (300, 400)
VOID, STUFF = 0.9, 0.6  #: greys of points without a truth, and of those that are no thing


def draw_worst(results: Results, folder: Path, path: Path) -> None:
    """Draws the scenes; `folder` has the labels of their first runs. The picture replaces the file when it is whole."""
    from matplotlib.figure import Figure

    scenes = worst_scenes(results)
    rows = -(-len(scenes) // COLUMNS)
    figure = Figure(figsize=(4 * COLUMNS * 2 * 0.9, 3.2 * rows * 0.9), layout="constrained")
    axes = figure.subplots(rows, 2 * COLUMNS, squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
    for place, one in enumerate(scenes):
        pair = axes[place // COLUMNS, 2 * (place % COLUMNS) : 2 * (place % COLUMNS) + 2]
        truth, found = pictures(one, torch.from_numpy(np.load(labels_of_first(one, folder))).long())
        run = results[one][0]
        for axis, picture in zip(pair, (truth, found), strict=True):
            axis.imshow(picture.numpy())
        pair[0].set_title(f"{one.name}: truth", fontsize=9)
        pair[1].set_title(f"F {run['f']:.2f}, best IoU {run['best_iou']:.2f}", fontsize=9)
    with atomic_write(path) as partial:
        figure.savefig(partial, dpi=75, pil_kwargs={"quality": 85})


def pictures(one: RealScene, labels: Tensor) -> tuple[Tensor, Tensor]:
    """The truth and the labels [N] of a scene, [H, W, 3] each; of a scan what is near."""
    scene, truth = one.load()
    instance = label_colors(truth.instance.clamp(min=0))
    instance[truth.instance < 0] = VOID
    instance[truth.other] = STUFF
    segments = label_colors(labels.clamp(min=0))
    segments[labels < 0] = VOID
    if one.is_scan:
        segments[labels == labels[labels >= 0].bincount().argmax()] = STUFF  # the ground
    near = scene.points[:, :2].norm(dim=1) < NEAR if one.is_scan else torch.ones(len(scene.points), dtype=torch.bool)
    drawn = Scene(scene.points[near], () if one.is_scan else scene.frames)
    both = render_cloud(drawn, torch.cat([instance, segments], 1)[near], SIZE)
    return both[..., :3], both[..., 3:]
