"""Step 4: pinhole projection of points into an image."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array, check_number


def project(
    points: Tensor,
    camera_from_world: Tensor,
    intrinsics: Tensor,
    near: float,
    far: float,
    height: int,
    width: int,
    margin: float = 0.0,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Project points into an image and keep the points inside the image frame.

    Computed in double precision and rounded to float32 at the end, so that every machine gives the same bits.

    Args:
        points: ``[N, 3]`` float32, metres, world frame.
        camera_from_world: ``[4, 4]`` float64, rigid; OpenCV axes (x right, y down, z forward).
        intrinsics: ``[3, 3]`` float64, pixels, without skew; pixel centres have integer coordinates.
        near, far: points with ``near < z < far`` are kept, metres; ``near > 0``.
        height, width: size of the image, pixels.
        margin: width added to the image frame on each side, pixels.

    Returns:
        The points that are kept, in their order: ``point`` ``[M]`` int64, the point's number; ``u`` and ``v`` ``[M]``
        float32, column and row in pixels; ``z`` ``[M]`` float32, metres along the optical axis. No gradient flows
        through them.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, ``near`` not above 0, a negative size or margin.

    Example:
        >>> import torch
        >>> intrinsics = torch.tensor([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]], dtype=torch.float64)
        >>> points = torch.tensor([[0.0, 0, 2], [0, 0, -2], [0.5, -0.25, 2]])
        >>> project(points, torch.eye(4, dtype=torch.float64), intrinsics, 0.1, 10.0, 48, 64)
        (tensor([0, 2]), tensor([32., 47.]), tensor([24.0000, 16.5000]), tensor([2., 2.]))
    """
    check_array("points", points, torch.float32, (None, 3), "[N, 3]")
    check_array("camera_from_world", camera_from_world, torch.float64, (4, 4), "[4, 4]")
    check_array("intrinsics", intrinsics, torch.float64, (3, 3), "[3, 3]")
    for name, value in (("near", near), ("far", far), ("margin", margin)):
        check_number(name, value, (int, float))
    check_number("height", height, (int,))
    check_number("width", width, (int,))
    result = call(
        torch.ops.torchjoint.project.default,
        points,
        camera_from_world,
        intrinsics,
        float(near),
        float(far),
        height,
        width,
        float(margin),
    )
    return cast(tuple[Tensor, Tensor, Tensor, Tensor], result)


@torch.library.register_fake("torchjoint::project")
def _fake(points: Tensor, *_: object) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    count = torch.library.get_ctx().new_dynamic_size()
    u, v, z = (points.new_empty(count) for _ in range(3))
    return points.new_empty(count, dtype=torch.int64), u, v, z
