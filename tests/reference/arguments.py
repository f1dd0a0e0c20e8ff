"""Arguments that several operators share."""

from __future__ import annotations

import torch
from torch import Tensor

EDGES = torch.tensor([[0, 1, 2], [1, 2, 3]])
VALUES = torch.tensor([0.1, 5.0, 0.2])
SOURCE = torch.tensor([torch.inf, 0.0, 0.0, 0.0])
SINK = torch.tensor([0.0, 0.0, 0.0, 2.0])
NAN = float("nan")
IMAGES = torch.arange(48.0).view(2, 3, 2, 4) / 48
POINTS = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]])
NEIGHBORS = torch.tensor([[1, 2], [0, 2], [0, 1], [1, 2]])
ROWS = torch.tensor([2, 0, 3, 1], dtype=torch.int32)
EYE = torch.eye(4, dtype=torch.float64)
PIXELS = torch.tensor([0, 1, 2])
POSITIONS = torch.tensor([0.0, 1.0, 2.0])
LABELS = torch.tensor([[0, 0, 1, -1], [0, 1, 1, 1], [1, 1, 0, 0]], dtype=torch.int32)


def changed(tensor: Tensor, value: float, *position: int) -> Tensor:
    tensor = tensor.clone()
    tensor[position] = value
    return tensor


def large_graph(num_edges: int) -> tuple[Tensor, Tensor]:
    """Edges [2, E] between E nodes, and their weights."""
    generator = torch.Generator().manual_seed(0)
    return torch.randint(num_edges, (2, num_edges), generator=generator), torch.rand(num_edges, generator=generator)
