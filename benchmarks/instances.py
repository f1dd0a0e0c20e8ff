"""Inputs for timing the operators: real photographs, rooms of points, and easy and hard minimum cuts."""

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
import skimage.data
import torch
from torch import Tensor

from torchjoint.config import ImageGraphConfig
from torchjoint.images.boundary import GradientBoundary
from torchjoint.images.pixel_graph import grid_edges, pixel_weights


class Graph(NamedTuple):
    edge_index: Tensor
    weight: Tensor
    num_nodes: int


class Cut(NamedTuple):
    edge_index: Tensor
    capacity: Tensor
    source: Tensor
    sink: Tensor
    grid: tuple[int, int] | None = None  # size, if the graph is a grid


@lru_cache(maxsize=4)
def photograph(height: int, width: int) -> Tensor:
    """Returns an image [3, H, W] in [0, 1] with little noise, so that no two weights are equal."""
    photo = cv2.resize(skimage.data.coffee(), (width, height), interpolation=cv2.INTER_CUBIC)
    noise = torch.rand(3, height, width, generator=torch.Generator().manual_seed(0))
    return (torch.from_numpy(photo).permute(2, 0, 1).contiguous() + noise) / 256


def image_graph(image: Tensor) -> Graph:
    """Returns the edge list of an image, with weights from colours and boundaries."""
    height, width = image.shape[1:]
    config = ImageGraphConfig(smoothing=0.0, color_weight=1.0, boundary_weight=0.3)
    weight = pixel_weights(image, GradientBoundary()(image[None])[0], config)
    return Graph(grid_edges(height, width), weight, height * width)


def room(num_points: int, noise: float = 0.003) -> Tensor:
    """Returns [N, 3] points on the six sides of a room of 6 x 5 x 3 m and on boxes in it, metres, in random order."""
    rng = np.random.default_rng(0)
    sizes = [(np.zeros(3), np.array([6.0, 5.0, 3.0]))]
    for _ in range(30):
        size = rng.uniform(0.1, 1.2, 3)
        sizes.append((rng.uniform(0, 1, 3) * ([6, 5, 3] - size), size))
    areas = np.array([[s[1] * s[2], s[0] * s[2], s[0] * s[1]] for _, s in sizes]).repeat(2, axis=1).ravel()
    side = rng.choice(areas.size, num_points, p=areas / areas.sum())
    box, face = np.divmod(side, 6)
    corner, extent = (np.stack(parts)[box] for parts in zip(*sizes, strict=True))
    unit = rng.uniform(0, 1, (num_points, 3))
    unit[np.arange(num_points), face // 2] = face % 2
    points = corner + unit * extent + rng.normal(0, noise, (num_points, 3))
    return torch.from_numpy(points.astype(np.float32))


def image_cut(size: int, seeds: int = 40, soft: bool = False, number: int = 0) -> Cut:
    """Returns a photograph's pixel graph as in refinement: exp(-w / mean w), seeds left and right (or soft terminals).

    `number`: selects the part of the photograph and the seeds.
    """
    top, left = 50 + 37 * number % 200, 100 + 71 * number % 300
    image = photograph(480, 640)[:, top : top + size, left : left + size].contiguous()
    graph = image_graph(image)
    capacity = torch.exp(-graph.weight / graph.weight.mean()).double()
    rng = np.random.default_rng(number)
    terminals = torch.zeros(2, size, size, dtype=torch.float64)
    if soft:
        terminals += torch.from_numpy(rng.uniform(0, 0.4, (2, size, size)))
    for terminal, start in ((0, 0), (1, size * 2 // 3)):
        rows, columns = rng.integers(0, size, seeds), rng.integers(start, start + size // 3, seeds)
        terminals[terminal, rows, columns] = torch.inf
        terminals[1 - terminal, rows, columns] = 0
    return Cut(graph.edge_index, capacity, terminals[0].flatten(), terminals[1].flatten(), (size, size))


def equal_capacities(size: int) -> Cut:
    cut = image_cut(size)
    return cut._replace(capacity=torch.ones_like(cut.capacity))


def chain(length: int, terminals_every: int) -> Cut:
    """Returns a chain with random capacities, and random terminals at one of `terminals_every` nodes on average."""
    generator = torch.Generator().manual_seed(0)
    nodes = torch.arange(length)
    source, sink = torch.rand(2, length, generator=generator, dtype=torch.float64)
    has_terminal = torch.rand(length, generator=generator) < 1 / terminals_every
    return Cut(
        torch.stack([nodes[:-1], nodes[1:]]),
        torch.rand(length - 1, generator=generator, dtype=torch.float64),
        source * has_terminal,
        sink * has_terminal,
    )


def bottleneck(size: int) -> Cut:
    """Returns two grids with strong edges, connected by one weak edge."""
    grid = grid_edges(size, size)
    count = size * size
    generator = torch.Generator().manual_seed(0)
    capacity = 1 + torch.rand(2 * grid.shape[1] + 1, generator=generator, dtype=torch.float64)
    capacity[-1] = 0.5
    bridge = torch.tensor([[count - 1], [count]])
    source, sink = torch.zeros(2, 2 * count, dtype=torch.float64)
    source[torch.randint(count, (50,), generator=generator)] = torch.inf
    sink[count + torch.randint(count, (50,), generator=generator)] = torch.inf
    return Cut(torch.cat([grid, grid + count, bridge], dim=1), capacity, source, sink)


def sparse(num_nodes: int) -> Cut:
    """Returns a random graph of mean degree 6 with terminals at all nodes."""
    generator = torch.Generator().manual_seed(0)
    edges = torch.randint(num_nodes, (2, 3 * num_nodes), generator=generator)
    capacity = torch.rand(3 * num_nodes, generator=generator, dtype=torch.float64)
    source, sink = torch.rand(2, num_nodes, generator=generator, dtype=torch.float64) * 2
    return Cut(edges, capacity, source, sink)


def square_of(num_edges: float) -> int:
    """Returns the side of a square image with about `num_edges` edges."""
    return round(math.sqrt(num_edges / 4))
