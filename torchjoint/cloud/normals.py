"""Steps 3 and 6: normals of the points, the angle between two (eq. 4), and arithmetic on many 3-vectors.

The arithmetic has a fixed order of operations, because labels depend on the last bit.
"""

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.runtime.threads import all_threads


def by_columns(vectors: Tensor) -> Tensor:
    """The same [N, 3] with each column contiguous in memory, because calculations read whole columns."""
    return vectors.T.contiguous().T


def rows_of(vectors: Tensor, index: Tensor) -> Tensor:
    """``vectors[index]``, [E, 3]; input and output have the layout of :func:`by_columns`."""
    return torch.stack([column.index_select(0, index) for column in vectors.unbind(1)]).T


def dot(first: Tensor, second: Tensor) -> Tensor:
    """Scalar products [N] of vectors [N, 3], summed as (x + y) + z."""
    x, y, z = (first * second).unbind(1)
    return (x + y) + z


def length(vectors: Tensor) -> Tensor:
    """Lengths [N] of vectors [N, 3]."""
    return dot(vectors, vectors).sqrt()


def rounded_length(vectors: Tensor) -> Tensor:
    """Lengths [N] of vectors [N, 3], correctly rounded.

    The root is taken in float64: torch's float32 root (from MKL) is not always the nearest number, but the root in
    ScanNet's segmentator is.
    """
    return dot(vectors, vectors).double().sqrt().float()


def estimate_normals(points: Tensor, neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    """Normals of the planes fitted to each point and its neighbours; their sign is arbitrary.

    Args:
        points: [N, 3] float32 metres.
        neighbors: [N, K] int32 or int64. With K < 2 a plane is not defined and the normal is (0, 0, 1).
        order: [N] int32 of :func:`~torchjoint.cloud.neighbors.order_along_space`; only saves time.

    Returns:
        [N, 3] float32, unit length.
    """
    with all_threads():
        return ops.fit_normals(points, neighbors, order)


def angle_between(first: Tensor, second: Tensor, oriented: Tensor) -> Tensor:
    """Angle between two normals, theta = atan2(|n_i x n_j|, n_i . n_j), radians (eq. 4).

    Args:
        first, second: [E, 3] normals n_i and n_j.
        oriented: [E] bool, whether both normals are oriented; if not, theta is the angle between lines, at most pi/2.

    Returns:
        [E] float32 in [0, pi].
    """
    x1, y1, z1 = first.unbind(1)
    x2, y2, z2 = second.unbind(1)
    cosine = dot(first, second)
    cross = ((y1 * z2 - z1 * y2).square() + (z1 * x2 - x1 * z2).square()) + (x1 * y2 - y1 * x2).square()
    return torch.atan2(cross.sqrt(), torch.where(oriented, cosine, cosine.abs()))


def is_convex(step: Tensor, turn: Tensor) -> Tensor:
    """Whether the surface is convex between two points: (n_j - n_i) . (p_j - p_i) > 0.

    Args:
        step: [E, 3] p_j - p_i, metres.
        turn: [E, 3] n_j - n_i, of oriented normals (pointing outwards).

    Returns:
        [E] bool.
    """
    return dot(step, turn) > 0
