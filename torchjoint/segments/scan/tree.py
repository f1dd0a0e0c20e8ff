"""Step 6, method scan: the parts of a scan over growing gaps, which are a tree, and what is known about its nodes."""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.segments.scan.gaps import LEVELS, Gaps

#: What is known about a node, and about its two largest parts.
SHAPE = (
    *("points", "lowest", "highest", "mean_height", "height_deviation", "range"),
    *("length", "width", "depth", "breadth", "density", "level"),
)
#: What else is known about a node: the neighbours over whose gaps its parts are joined, and how its parts lie.
JOINT = (
    *("joints", "joint_height", "joint_share", "joint_range", "joint_rise", "least_gap", "mean_gap"),
    *("ends", "parts", "apart", "beside"),
)
FEATURE_NAMES = (*(f"{whose}_{name}" for whose in ("whole", "first", "second") for name in SHAPE), *JOINT)
#: Metres that are added where a length divides.
SMALL = 0.1


class Tree(NamedTuple):
    """M nodes over S points. The first P are superpoints; each other one joins at least two, which come before it."""

    which: Tensor  #: [S] int64, numbers of the points, those that stand on the ground
    superpoint: Tensor  #: [S] int64, superpoint of each
    parent: Tensor  #: [M] int64, -1 = none
    level: Tensor  #: [M] int64, at which level of LEVELS it forms
    inner: Tensor  #: [I] int64, ascending, the nodes that are no superpoints
    features: Tensor  #: [I, F] float32, FEATURE_NAMES of these


def grow_tree(gaps: Gaps, standing: Tensor, points: Tensor, height: Tensor, min_size: int) -> Tree:
    """The tree of the points `standing` [N] bool.

    Args:
        gaps: which points are connected over which gaps.
        standing: [N] bool.
        points: [N, 3] metres, the sensor at the origin.
        height: [N] float64 metres over the ground.
        min_size: superpoints with fewer points join another one within JOINING_GAP.
    """
    labels = gaps.components(standing, min_size, LEVELS[0])
    which = torch.nonzero(labels).squeeze(1)
    superpoint = labels[which] - 1
    ends, distance = gaps.crossing(labels, LEVELS[-1])
    parent, level, of_joint = _joined(labels[ends] - 1, distance, int(labels.max()))
    inner = torch.arange(int(labels.max()), len(parent))
    shape = _shapes(points[which].double(), height[which], superpoint, parent, level)
    joint = _joints(points[ends].double(), height[ends], distance, of_joint, len(parent))
    return Tree(which, superpoint, parent, level, inner, _features(parent, level, inner, shape, joint))


def _joined(superpoints: Tensor, distance: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Parents [M] and levels [M] of the nodes, and for each joint [E] the node that it makes, -1 = none.

    Args:
        superpoints: [2, E] int64, the two superpoints of each joint.
        distance: [E] float64, in gaps.
        count: P, the number of superpoints.
    """
    parent, level = torch.full((2 * count,), -1), torch.zeros(2 * count, dtype=torch.int64)
    top, of_joint = torch.arange(count), torch.full_like(superpoints[0], -1)
    # What is nearer than the first level crosses no border.
    at = torch.searchsorted(torch.tensor(LEVELS, dtype=torch.float64), distance).clamp(min=1)
    for number in range(1, len(LEVELS)):
        near = torch.nonzero(at == number).squeeze(1)
        near = near[top[superpoints[0, near]] != top[superpoints[1, near]]]
        members, place = torch.unique(top[superpoints[:, near]], return_inverse=True)
        group = ops.connected_components(place, len(members))
        new = torch.arange(count, count + len(torch.unique(group)))
        parent[members], of_joint[near], level[new] = count + group, count + group[place[0]], number
        up = torch.arange(count + len(new))
        up[members] = count + group
        top, count = up[top], count + len(new)
    return parent[:count], level[:count], of_joint


def summed_up(values: Tensor, parent: Tensor, level: Tensor, reduce: str = "sum") -> Tensor:
    """The values [M, C] of superpoints, and of each other node the sum (or "amin") of its parts' values."""
    for number in range(1, len(LEVELS)):
        parts = torch.nonzero(parent >= 0).squeeze(1)
        parts = parts[level[parent[parts]] == number]
        values.scatter_reduce_(0, parent[parts, None].expand(-1, values.shape[1]), values[parts], reduce)
    return values


def _shapes(points: Tensor, height: Tensor, superpoint: Tensor, parent: Tensor, level: Tensor) -> dict[str, Tensor]:
    """SHAPE of all nodes, each [M], and where their middles are."""
    x, y, _ = points.unbind(1)
    distance = points.norm(dim=1)
    row = superpoint[:, None]
    columns = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y, height, height * height, distance], dim=1)
    sums = torch.zeros(len(parent), columns.shape[1], dtype=torch.float64)
    sums = summed_up(sums.scatter_add_(0, row.expand_as(columns), columns), parent, level)
    ends = torch.stack([height, -height, x], dim=1)
    least = torch.full((len(parent), 3), torch.inf, dtype=torch.float64)
    least = summed_up(least.scatter_reduce_(0, row.expand_as(ends), ends, "amin"), parent, level, "amin")
    count = sums[:, 0]
    x, y, xx, xy, yy, mean, square, far = (sums[:, 1:] / count[:, None]).unbind(1)
    xx, xy, yy = xx - x * x, xy - x * y, yy - y * y
    half, spread = (xx + yy) / 2, torch.hypot((xx - yy) / 2, xy)
    flat = torch.hypot(x, y).clamp(min=SMALL)
    cos, sin = x / flat, y / flat
    size = least[:, 1].neg() - least[:, 0]
    # Sides of a box with these variances, and deviations along and across the line of sight.
    length, width = (12 * half.add(side * spread).clamp(min=0) for side in (1, -1))
    shape = {
        "points": count.log(),
        "lowest": least[:, 0],
        "highest": -least[:, 1],
        "mean_height": mean,
        "height_deviation": (square - mean * mean).clamp(min=0).sqrt(),
        "range": far,
        "length": length.sqrt(),
        "width": width.sqrt(),
        "depth": (xx * cos * cos + 2 * xy * cos * sin + yy * sin * sin).clamp(min=0).sqrt(),
        "breadth": (xx * sin * sin - 2 * xy * cos * sin + yy * cos * cos).clamp(min=0).sqrt(),
        # Points of a sphere around the sensor, over the area that the node shows at most.
        "density": (count * far * far / ((length.sqrt() + SMALL) * (size + SMALL))).clamp(min=1e-9).log(),
        "level": level.double(),
    }
    return shape | {"x": x, "y": y, "first_x": least[:, 2]}


def _joints(points: Tensor, height: Tensor, distance: Tensor, of_joint: Tensor, count: int) -> dict[str, Tensor]:
    """What joins the parts of nodes, each [M]; of superpoints it has no meaning.

    Args:
        points: [2, E, 3] metres, the two ends of each joint.
        height: [2, E] metres over the ground.
        distance: [E] in gaps.
        of_joint: [E] int64, the node that each makes, -1 = none.
        count: M.
    """
    used = of_joint >= 0
    points, height, distance, of_joint = points[:, used], height[:, used], distance[used], of_joint[used]
    apart = (points[0] - points[1]).norm(dim=1).clamp(min=1e-9)
    across = points.norm(dim=2).diff(dim=0)[0].abs() / apart
    columns = torch.stack([torch.ones_like(apart), height.mean(0), across, height.diff(dim=0)[0].abs() / apart,
                           distance], dim=1)  # fmt: skip
    sums = torch.zeros(count, 5, dtype=torch.float64).index_add_(0, of_joint, columns)
    number = sums[:, 0].clamp(min=1)
    _, at, along, rise, mean = (sums / number[:, None]).unbind(1)
    least = torch.full((count,), torch.inf, dtype=torch.float64).scatter_reduce_(0, of_joint, distance, "amin")
    return {"joints": number.log(), "joint_height": at, "joint_range": along, "joint_rise": rise, "least_gap": least,
            "mean_gap": mean}  # fmt: skip


def _features(
    parent: Tensor, level: Tensor, inner: Tensor, shape: dict[str, Tensor], joint: dict[str, Tensor]
) -> Tensor:
    """FEATURE_NAMES of the inner nodes, [I, F] float32."""
    keys = (shape["first_x"], shape["lowest"], -shape["points"], parent)
    order = torch.from_numpy(np.lexsort([key.numpy() for key in keys]))
    order = order[parent[order] >= 0]
    begin = torch.searchsorted(parent[order], inner)
    first, second = order[begin], order[begin + 1]
    size = shape["highest"] - shape["lowest"] + SMALL
    above = parent[inner]
    joint = {name: values[inner] for name, values in joint.items()} | {
        "joint_share": (joint["joint_height"] - shape["lowest"])[inner] / size[inner],
        "ends": torch.where(above >= 0, level[above], len(LEVELS)).double(),
        "parts": torch.bincount(parent[order], minlength=len(parent))[inner].double(),
        "apart": torch.hypot(shape["x"][first] - shape["x"][second], shape["y"][first] - shape["y"][second]),
        "beside": (torch.minimum(shape["highest"][first], shape["highest"][second])
                   - torch.maximum(shape["lowest"][first], shape["lowest"][second])) / size[inner],
    }  # fmt: skip
    columns = [shape[name][nodes] for nodes in (inner, first, second) for name in SHAPE]
    return torch.stack([*columns, *(joint[name] for name in JOINT)], dim=1).float()
