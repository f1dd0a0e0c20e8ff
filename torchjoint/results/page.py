"""Writes a result as one HTML file to share: the cloud, and a row of its images (output after step 8)."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from PIL import Image
from torch import Tensor

from torchjoint.results.label_colors import label_colors
from torchjoint.results.oriented_box import level_axes
from torchjoint.results.overlays import overlay
from torchjoint.results.result import Result
from torchjoint.results.upright import up_direction, view_from_above
from torchjoint.runtime.extras import needed_for
from torchjoint.runtime.files import write_text
from torchjoint.runtime.messages import printable
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.subset import evenly_spaced_indices

#: Largest number of points and of images in the page, and height of an image in pixels.
MOST_POINTS, MOST_IMAGES, HEIGHT = 100_000, 8, 150
#: Size of the palette for the points' own colours: one byte per point keeps the page small.
PALETTE = 255


@on_cpu()
def write_page(path: Path, result: Result, up: Tensor | None = None) -> int:
    """Writes a page that works in any browser, without a network; an earlier file is replaced atomically.

    Args:
        path: file to write.
        result: the labels, and the scene; its truth, if it has one, can be shown in place of the labels.
        up: [3] upward direction; None: as :func:`~torchjoint.results.upright.up_direction`.

    Returns:
        the number of points that it shows: all, or an even selection of them; the page shows this number.
    """
    scene = result.scene
    upward = (up_direction(scene) if up is None else torch.nn.functional.normalize(up.double(), dim=0)).numpy()
    keep = torch.arange(0, len(scene.points), max(1, -(-len(scene.points) // MOST_POINTS)))
    figure = _figure(result, keep, upward)
    count = f"{len(keep)} of {len(scene.points)}" if len(keep) < len(scene.points) else f"{len(keep)}"
    title = escape(f"{scene.name}: {result.num_point_segments} segments, {count} points".removeprefix(": "))
    plot = figure.to_html(include_plotlyjs=True, full_html=False, default_height="calc(100vh - 230px)")
    strip = "".join(_thumbnail(result, i) for i in evenly_spaced_indices(len(result.images), MOST_IMAGES))
    write_text(
        path,
        f'<!DOCTYPE html><html><head><meta charset="utf-8"><title>{title}</title></head>'
        f'<body style="margin:0;font-family:sans-serif"><div style="padding:6px">{title}</div>{plot}'
        f'<div style="display:flex;overflow-x:auto;gap:4px;padding:4px">{strip}</div></body></html>\n',
    )
    return len(keep)


def _figure(result: Result, keep: Tensor, up: npt.NDArray[np.float64]) -> Any:
    with needed_for("an HTML file of a result", "plotly", "torchjoint[viewer]"):
        import plotly.graph_objects as go

    scene = result.scene
    center, eye = view_from_above(scene, up)
    upright = np.concatenate([level_axes(up), up[None]])  # turns `up` to +z, which plotly's camera keeps upright
    shown = (scene.points[keep].double().numpy() - center) @ upright.T
    x, y, z = (shown / max(float(np.abs(shown).max()), 1e-9) * 32767).round().astype(np.int16).T  # small, in any unit
    paints = {"segments": _paint(result.points[keep].numpy(), label_colors(torch.arange(result.num_point_segments)))}
    if scene.colors is not None:
        paints["colours"] = _paint(*_palette((scene.colors[keep].numpy() * 255).round().astype(np.uint8)))
    if scene.truth is not None and scene.truth.points is not None:
        instances, index = scene.truth.points[keep].unique(return_inverse=True)
        paints["truth"] = _paint(index.numpy(), label_colors(instances))
    first = paints["segments"]
    figure = go.Figure()
    figure.add_scatter3d(
        x=x, y=y, z=z, mode="markers", hovertemplate="segment %{marker.color}<extra></extra>",
        marker={"size": 1.8, **first},
    )  # fmt: skip
    figure.update_layout(
        scene={"aspectmode": "data", "camera": _camera(upright @ (eye - center))}
        | {axis: {"visible": False} for axis in ("xaxis", "yaxis", "zaxis")},
        margin={"l": 0, "r": 0, "t": 0, "b": 0}, showlegend=False,
        updatemenus=[{"type": "buttons", "direction": "left", "x": 0.02, "y": 0.98, "buttons": [
            _button(name, paint) for name, paint in paints.items()
        ]}],
    )  # fmt: skip
    return figure


def _camera(view: npt.NDArray[np.float64]) -> dict[str, Any]:
    return {"eye": dict(zip("xyz", (1.6 * view / np.linalg.norm(view)).tolist(), strict=True))}


def _paint(index: npt.NDArray[np.int64], colors: Tensor) -> dict[str, Any]:
    """A marker's settings: point i has the colour `colors[index[i]]`."""
    small = np.uint8 if len(colors) < 256 else np.int32
    return {"color": index.astype(small), "colorscale": _colorscale(colors), "cmin": -0.5, "cmax": len(colors) - 0.5}


def _button(name: str, paint: dict[str, Any]) -> dict[str, Any]:
    values = {f"marker.{key}": [value.tolist() if key == "color" else value] for key, value in paint.items()}
    hover = "segment %{marker.color}<extra></extra>" if name == "segments" else "<extra></extra>"
    return {"label": name, "method": "restyle", "args": [values | {"hovertemplate": hover}]}


def _palette(colors: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.int64], Tensor]:
    """The nearest of few colours for each point: indices [N] and colours [K, 3] in [0, 1]."""
    picture = Image.fromarray(colors[None]).quantize(PALETTE)
    found = torch.tensor(picture.getpalette()).view(-1, 3) / 255
    index = np.array(picture)[0].astype(np.int64)
    return index, found[: int(index.max()) + 1]


def _colorscale(colors: Tensor) -> list[tuple[float, str]]:
    """A colour scale in steps: index i gets colour i."""
    names = [f"rgb({r},{g},{b})" for r, g, b in (colors * 255).round().int().tolist()]
    ends: Sequence[float] = np.linspace(0, 1, len(names) + 1).tolist()
    return [(end, name) for i, name in enumerate(names) for end in (ends[i], ends[i + 1])]


def _thumbnail(result: Result, index: int) -> str:
    if len(result.scene.frames):
        painted = overlay(result.scene.frames[index].image, result.images[index], result.num_point_segments)
    else:
        painted = label_colors(result.images[index], result.num_point_segments).permute(2, 0, 1)
    picture = Image.fromarray((painted * 255).round().to(torch.uint8).permute(1, 2, 0).numpy())
    picture.thumbnail((4 * HEIGHT, HEIGHT))
    stream = io.BytesIO()
    picture.save(stream, "jpeg", quality=80)
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    name = escape(printable(result.names[index]))
    return f'<img alt="{name}" title="{name}" src="data:image/jpeg;base64,{data}">'
