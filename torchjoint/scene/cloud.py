"""One point cloud without frames, on which steps 3 and 6 work."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchjoint.runtime.groups import check_dense
from torchjoint.scene.checks import as_float, as_points, as_unit_range, check_shape

#: Normals whose length differs from 1 by less than this are kept as they are.
UNIT = 1e-6


@dataclass(frozen=True)
class Cloud:
    """One point cloud. :meth:`checked` checks data from outside once; the steps do not check it again.

    Attributes:
        points: [N, 3] float32 or float64 metres.
        colors: [N, 3] float32 RGB in [0, 1].
        normals: [N, 3] float32, unit length.
        edges: [2, E] int64, a graph that replaces that of the nearest neighbours; superpoints only.
        faces: [F, 3] int64, triangles of a mesh; superpoints only.
        viewpoint: [3] or [N, 3] float64 metres, position of the sensor; superpoints only.
    """

    points: Tensor
    colors: Tensor | None = None
    normals: Tensor | None = None
    edges: Tensor | None = None
    faces: Tensor | None = None
    viewpoint: Tensor | None = None

    @classmethod
    def checked(cls, points: Tensor, colors: Tensor | None = None, normals: Tensor | None = None) -> Cloud:
        """Checks data from outside, and makes a cloud of it.

        Raises:
            ValueError, TypeError: naming the argument, what was expected and what came.
        """
        points = as_points(points)
        if colors is not None:
            colors = as_unit_range(_in_unit_range(colors), "colors")
            check_shape(colors, tuple(points.shape), "colors")
        return cls(points, colors, None if normals is None else _unit_normals(normals, points))

    def selected(self, chosen: Tensor) -> Cloud:
        """The points numbered [M] int64, in this order, with their colours and normals."""
        colors, normals = (None if of is None else of.index_select(0, chosen) for of in (self.colors, self.normals))
        return Cloud(self.points.index_select(0, chosen), colors, normals)

    def without_constants(self) -> Cloud:
        """The cloud without colours or normals that are all equal, as many programs write them for a cloud without.

        Equal colours would tell the model that no boundary has a colour step, and the check of poses that no pose fits.
        Equal normals would tell that there is no crease.
        """
        both = (self.colors, self.normals)
        colors, normals = (None if of is None or (of == of[0]).all() else of for of in both)
        return replace(self, colors=colors, normals=normals)


def full_brightness(largest: float, most: int | None = None) -> float:
    """The number of full brightness among colours of one file, or of one tensor: 1, 255, 65535.

    Many programs write 8 bits into wider integers.

    Args:
        largest: of the colours.
        most: the largest integer of their type; None: they are floating.

    >>> full_brightness(200, 65535), full_brightness(40000, 65535), full_brightness(200.0), full_brightness(0.9)
    (255, 65535, 255, 1)
    >>> full_brightness(40000.0)
    65535
    """
    if most is None and largest < 2:
        return 1
    most = most or 65535
    wide = min(65535, most)
    if 255 < largest < 4096 and wide == 65535:
        told = f"colours are at most {largest:g} of 65535, and are read as dark: are they of 12 bits?"
        warnings.warn(told, stacklevel=5)
    return 255 if largest <= 255 else wide if largest <= wide else most


def _in_unit_range(colors: Tensor) -> Tensor:
    """Colours of 0 to 255, or of wider integers, divided by full brightness; others, and uint8, as they are."""
    check_dense(colors, "colors")
    if colors.dtype in (torch.uint8, torch.bool) or not colors.numel():
        return colors
    if colors.is_floating_point():
        low, high = map(float, colors.aminmax())
        if low >= 0 and high <= 255 == full_brightness(high):
            warnings.warn(f"colors: got values up to {high:g}; taken as 0 to 255, and divided by 255", stacklevel=4)
            return colors / 255
    elif not colors.is_complex():
        values = colors.double()
        return values / full_brightness(float(values.max()), torch.iinfo(colors.dtype).max)
    return colors


def _unit_normals(normals: Tensor, points: Tensor) -> Tensor:
    normals = as_float(normals, "normals", torch.float32)
    check_shape(normals, tuple(points.shape), "normals")
    length = normals.norm(dim=1, keepdim=True)
    if float(length.min()) < 1e-3:
        raise ValueError(f"normals: expected unit vectors, got {int((length < 1e-3).sum())} of length 0")
    is_unit = (length - 1).abs() < UNIT  # so that checking twice changes nothing
    return torch.where(is_unit, normals, normals / length)
