"""Generated inputs of the tasks; nothing here is measured."""

import torch
from torch import Tensor


def room(num_points: int) -> Tensor:
    """Points on the walls of a room of 5 x 4 x 2.5 m, with 3 mm of noise."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(num_points, 3, generator=generator)
    side = torch.randint(6, (num_points,), generator=generator)
    points[torch.arange(num_points), side % 3] = (side // 3).float()
    return points * torch.tensor([5.0, 4.0, 2.5]) + 0.003 * torch.randn(num_points, 3, generator=generator)


def grid_with_seeds(height: int, width: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """A 4-connected grid, random weights in [0, 1], and terminals at its left and its right side."""
    index = torch.arange(height * width).reshape(height, width)
    pairs = ((index[:, :-1], index[:, 1:]), (index[:-1], index[1:]))
    edges = torch.cat([torch.stack([first.flatten(), second.flatten()]) for first, second in pairs], dim=1)
    weight = torch.rand(edges.shape[1], generator=torch.Generator().manual_seed(0))
    source, sink = torch.zeros(2, height, width)
    source[:, 0], sink[:, -1] = torch.inf, torch.inf
    return edges, weight, source.flatten(), sink.flatten()
