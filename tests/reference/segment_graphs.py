"""segment_graphs: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from reference.arguments import LABELS, NAN, PIXELS

EXAMPLE: dict[str, Any] = {
    "labels": LABELS, "chosen": torch.tensor([False, True]), "colors": torch.rand(3, 3, 4),
    "boundary": torch.rand(3, 4), "color_weight": 1.0, "boundary_weight": 0.5,
}  # fmt: skip
ERRORS = [
    ({"labels": LABELS[0]}, ValueError, "labels: expected 2 dimensions"),
    ({"labels": LABELS + 1}, ValueError, "labels: expected numbers in [0, 2), got 2 at 2"),
    ({"labels": LABELS - 1}, ValueError, "labels: expected numbers in [0, 2), got -2 at 3"),
    ({"chosen": PIXELS}, ValueError, "chosen: expected another dtype"),
    ({"colors": torch.rand(3, 4, 3)}, ValueError, "colors: expected length 3 in dimension 1, got 4"),
    ({"boundary": torch.rand(3)}, ValueError, "boundary: expected 2 dimensions"),
    ({"color_weight": -1}, ValueError, "color_weight: expected a number >= 0, got -1"),
    ({"boundary_weight": NAN}, ValueError, "boundary_weight: expected a number >= 0, got nan"),
]
REFUSED = [
    {"colors": torch.rand(3, 4, 3)},
    {"boundary": torch.rand(3)},
    {"chosen": PIXELS},
    {"color_weight": NAN},
]


def segment_graphs_reference(
    labels: Tensor, chosen: Tensor, colors: Tensor, boundary: Tensor, color_weight: float, boundary_weight: float
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """What :func:`torchjoint.ops.internal.segment_graphs` computes; the arguments are not checked."""
    pixels: list[int] = []
    edges: list[tuple[int, int]] = []
    weights: list[float] = []
    node_ptr, edge_ptr = [0], [0]
    for segment in torch.nonzero(chosen).flatten().tolist():
        places = torch.nonzero(labels == segment).tolist()
        number = {tuple(place): i for i, place in enumerate(places)}
        own = []
        for down, right in ((0, 1), (1, 0), (1, 1), (-1, 1)):
            for i, (row, column) in enumerate(places):
                here, there = (row, column), (row + down, column + right)
                if there not in number:
                    continue
                red, green, blue = (colors[:, *here] - colors[:, *there]).square().numpy()
                distance = np.sqrt((red + green) + blue)  # correctly rounded, unlike torch's sqrt (from MKL)
                weakest = min(boundary[here].numpy(), boundary[there].numpy())
                own.append(float(np.float32(color_weight) * distance + np.float32(boundary_weight) * weakest))
                edges.append((i, number[there]))
        total = 0.0
        for weight in own:  # not sum(): since Python 3.12 it is more precise than plain addition
            total += weight
        mean = total / max(len(own), 1)
        weights += [weight / mean if mean > 0 else weight for weight in own]
        pixels += [row * labels.shape[1] + column for row, column in places]
        node_ptr.append(len(pixels))
        edge_ptr.append(len(edges))
    edge_index = torch.tensor(edges, dtype=torch.int64).reshape(-1, 2).T.contiguous()
    relative_weight = torch.tensor(weights, dtype=torch.float64)
    return (
        torch.tensor(pixels, dtype=torch.int64),
        torch.tensor(node_ptr),
        edge_index,
        torch.tensor(edge_ptr),
        relative_weight,
    )
