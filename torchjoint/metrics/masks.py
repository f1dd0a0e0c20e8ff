"""Predicted instances in any supported form, and the number of points they share with ground-truth instances."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.metrics.overlaps import check_integers, checked_labels, count_keys, places
from torchjoint.runtime.groups import renumber_by_value


class Intersections(NamedTuple):
    """Points that K masks share with T true instances, as a sparse table. Column 0 is void, 1 ... T are instances."""

    mask: Tensor  #: [E] int64
    column: Tensor  #: [E] int64
    shared: Tensor  #: [E] int64, number of points, > 0
    mask_area: Tensor  #: [K] int64, including void points
    column_area: Tensor  #: [T + 1] int64


def intersect(pred: Tensor | Sequence[Tensor], target: Tensor) -> tuple[Intersections, Tensor | None]:
    """Intersects predicted instances with true instances, both in the order of their labels.

    Args:
        pred: labels, integers of the target's shape, -1 = none; or masks, bool [K, ...] with the target's shape after
            the first axis; or K tensors of point indices, integers in 0 ... N - 1, where N is the target's size.
        target: int64, any shape, -1 = void.

    Returns:
        the table, and the labels [K] of the K instances, ascending; None if `pred` is not labels.
    """
    column = renumber_by_value(target.flatten())[1] + 1
    column_area = torch.bincount(column, minlength=1)
    if isinstance(pred, Tensor) and pred.dtype != torch.bool:
        flat = checked_labels(pred, "pred")
        if pred.shape != target.shape:
            expected, got = tuple(target.shape), tuple(pred.shape)
            raise ValueError(f"pred: expected labels of the target's shape, {expected}, got {got}")
        labels, mask = renumber_by_value(flat)
        inside, width = mask >= 0, len(column_area)
        key, count = count_keys(mask[inside] * width + column[inside], len(labels) * width)
        area = torch.bincount(mask[inside], minlength=len(labels))
        return Intersections(key // width, key % width, count, area, column_area), labels
    rows = [torch.bincount(column[points]) for points in _points(pred, target)]
    columns = [row.nonzero().flatten() for row in rows]
    mask = torch.arange(len(rows)).repeat_interleave(torch.tensor([len(one) for one in columns], dtype=torch.int64))
    count = torch.cat([mask[:0], *(row[one] for row, one in zip(rows, columns, strict=True))])
    area = torch.tensor([int(row.sum()) for row in rows], dtype=torch.int64)
    return Intersections(mask, torch.cat([mask[:0], *columns]), count, area, column_area), None


def _points(pred: Tensor | Sequence[Tensor], target: Tensor) -> Iterator[Tensor]:
    """Yields the point indices of each mask, [M] int64."""
    if isinstance(pred, Tensor):
        if pred.dim() == 0 or pred.shape[1:] != target.shape:
            expected = ", ".join(["K", *map(str, target.shape)])
            raise ValueError(f"pred: expected masks of shape ({expected}), got {tuple(pred.shape)}")
        for mask in pred.cpu():
            yield places(mask.flatten())
    elif isinstance(pred, Sequence):
        for i, points in enumerate(pred):
            yield _checked_points(points, f"pred[{i}]", target.numel())
    else:
        raise TypeError(f"pred: expected labels, masks or a sequence of tensors of points, got {type(pred).__name__}")


def _checked_points(points: Tensor, name: str, size: int) -> Tensor:
    check_integers(points, f"{name}: expected an integer tensor of points")
    if points.dim() != 1:
        raise ValueError(f"{name}: expected points of shape [M], got {tuple(points.shape)}")
    points = points.to("cpu", torch.int64).unique()
    if len(points) and not 0 <= int(points[0]) <= int(points[-1]) < size:
        raise ValueError(f"{name}: expected points in 0 ... {size - 1}, got {int(points[0])} ... {int(points[-1])}")
    return points
