"""Scans made by hand: rays of a LiDAR against a plane and boxes."""

import math

import torch
from torch import Tensor

from torchjoint.segments.scan.ground import ground_below
from torchjoint.segments.scan.recognition import directions

HEIGHT = 1.7


def height_over_ground(points: Tensor) -> Tensor:
    """[N] float64 metres."""
    height = points[:, 2].double()
    return height - ground_below(directions(points), height)


def rays(beams: int = 40, steps: int = 720) -> Tensor:
    """[beams * steps, 3] unit directions all around, from 25 degrees below level to 3 above."""
    elevation = torch.linspace(math.radians(-25), math.radians(3), beams, dtype=torch.float64)[:, None]
    azimuth = (torch.arange(steps, dtype=torch.float64) / steps * 2 - 1)[None] * math.pi
    x, y = elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin()
    return torch.stack([x, y, elevation.sin().expand_as(x)], dim=2).view(-1, 3)


def plane_hits(directions: Tensor, slope: float = 0.0) -> Tensor:
    """[R] metres to the plane z = slope * x - HEIGHT; inf = never."""
    down = slope * directions[:, 0] - directions[:, 2]
    return torch.where(down > 1e-9, HEIGHT / down.clamp(min=1e-9), torch.inf)


def box_hits(directions: Tensor, low: tuple[float, float, float], high: tuple[float, float, float]) -> Tensor:
    """[R] metres to an upright box; inf = past it."""
    near = torch.tensor(low, dtype=torch.float64) / directions
    far = torch.tensor(high, dtype=torch.float64) / directions
    enter, leave = torch.minimum(near, far).amax(1), torch.maximum(near, far).amin(1)
    return torch.where((enter <= leave) & (enter > 0), enter, torch.inf)


def scan(
    *boxes: tuple[tuple[float, float, float], tuple[float, float, float]],
    slope: float = 0.0,
    reach: float = 60,
    beams: int = 40,
):
    """Points [N, 3] float32, and what each is of, [N]: 0 = the ground, 1, 2, ... = boxes."""
    directions = rays(beams)
    ranges = torch.stack([plane_hits(directions, slope), *(box_hits(directions, *box) for box in boxes)])
    nearest, what = ranges.min(dim=0)
    seen = nearest < reach
    return (directions * nearest[:, None])[seen].float(), what[seen]
