"""An HTML page that shows a cloud (output after step 8)."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from torchjoint.results.label_colors import label_colors


def write_viewer(path: Path, points: Tensor, labels: Tensor, colors: Tensor | None, most: int = 150_000) -> None:
    """Writes an HTML page with an interactive view of the cloud; it works in any browser, without a network.

    Args:
        path: file to write.
        points: [N, 3] metres.
        labels: [N] int64, -1 = none.
        colors: [N, 3] RGB in [0, 1], or None.
        most: largest number of points to show; larger clouds are subsampled evenly.
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
