"""Step 6, method learned: draws the surface of a cloud anew, as if the cloud had been measured once more.

Small regions, and pieces after them, grow greedily: a tenth of a millimetre decides where they end, and so what a judge
sees. Judges who see different draws do not all make the same accidental merge.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from torchjoint.cloud._vectors import dot
from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.normals import estimate_normals
from torchjoint.cloud.scales import Scales

#: Number of draws; the first one is the cloud itself.
DRAWS = 3
#: Standard deviation of the noise of the points along each axis, in multiples of their spacing.
DEVIATION = 0.1


def drawn_anew(graph: PointGraph, scales: Scales, number: int) -> PointGraph:
    """The graph with its points moved a little, and with the normals of the moved points.

    Edges and neighbours stay, and each normal keeps its side, so all evidence of images is valid for it. Given normals
    stay, too.

    Args:
        graph: the cloud itself.
        scales: its noise and spacing.
        number: of the draw, 1, 2, ...; equal numbers give equal draws.
    """
    random = torch.Generator().manual_seed(number)
    # uniform, as the judges' noise
    noise = 2 * torch.rand(graph.points.shape, generator=random, dtype=graph.points.dtype) - 1
    points = graph.points + DEVIATION * 3**0.5 * scales.spacing[:, None] * noise
    normals = graph.normals
    if not graph.has_given_normals:
        fitted = estimate_normals(points, graph.neighbors[:, : scales.normal_neighbors].contiguous())
        normals = torch.where(dot(fitted, normals)[:, None] < 0, -fitted, fitted)
    return replace(graph, points=points, normals=normals, wide_normals=estimate_normals(points, graph.neighbors))
