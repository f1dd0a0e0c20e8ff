"""Operators on points: neighbours and normals (step 3), projection and a z-buffer (step 4)."""

import torch
from torch import Tensor

from torchjoint.ops._call import call, dynamic_size, of_one_size, register_fakes
from torchjoint.ops._checks import FLOATING, check_array, check_neighbors, check_number, check_order


def nearest_neighbors(
    points: Tensor, count: int, num_distances: int | None = None, limits: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Find the nearest neighbours of each point, nearest first, without the point itself.

    Exact: squared distances are computed and compared in float64, as ``(x² + y²) + z²``. Of equally far points the one
    with the smaller number comes first. Copies of a point are its neighbours, at distance 0. Coordinates in float64
    between -1e-136 and 1e-136 count as 0, because their squares vanish.

    Args:
        points: ``[N, 3]`` float32 or float64, finite, N < 2^31.
        count: K >= 0; if there are fewer other points, K is their number.
        num_distances: D >= 0, the number of nearest neighbours whose distances are returned; default and maximum: K.
        limits: ``[N]`` float64, not negative, the largest distance of each point's neighbours. Squares are compared, so
            a rounded distance as its own limit may be too small. If there are fewer than K, the point itself takes the
            place of the others, at an infinite distance. None: no limits.

    Returns:
        ``[N, K]`` int32 numbers of the neighbours, and ``[N, D]`` their distances, in the dtype of the points. Runs on
        torch's threads; the result does not depend on the number of threads. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a negative number, a coordinate that is not finite.

    Example:
        >>> import torch
        >>> points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [-1, 0, 0]])
        >>> indices, distances = nearest_neighbors(points, 2)
        >>> indices.tolist()
        [[1, 3], [0, 2], [1, 0], [0, 1]]
        >>> distances.tolist()
        [[1.0, 1.0], [1.0, 2.0], [2.0, 3.0], [1.0, 2.0]]
    """
    check_array("points", points, FLOATING, (None, 3), "[N, 3]")
    check_number("count", count, (int,))
    if num_distances is None:
        num_distances = count
    check_number("num_distances", num_distances, (int,))
    if limits is not None:
        check_array("limits", limits, torch.float64, (len(points),), "[N]")
    return call("nearest_neighbors", points, count, num_distances, limits)


def neighbor_edges(neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    """Make the edges of a table of neighbours: i < j have one edge if i is in the row of j, or j in the row of i.

    The edges have the order of their first occurrence in the table. A row that contains its own point gives no edge. A
    row that contains a neighbour twice gives this edge twice (:func:`torchjoint.ops.felzenszwalb` accepts this).

    Args:
        neighbors: ``[N, K]`` int32 or int64, N < 2^31: the neighbours of each point.
        order: ``[N]`` int32, a permutation: the order in which rows are processed; the result does not depend on it.
            For a large cloud in random order, a spatial one is much faster.
            Default: 0, 1, ...

    Returns:
        ``[2, E]`` int64. Runs on torch's threads; the result does not depend on the number of threads.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a neighbour outside [0, N), an order that is no permutation.

    Example:
        >>> import torch
        >>> neighbor_edges(torch.tensor([[1], [0], [1]]))
        tensor([[0, 1],
                [1, 2]])
    """
    check_neighbors(neighbors, None)
    check_order(order, neighbors.shape[0])
    return call("neighbor_edges", neighbors, order)


def fit_normals(points: Tensor, neighbors: Tensor, order: Tensor | None = None) -> Tensor:
    """Fit a plane to each point and its neighbours, and return its normal.

    The normal is the eigenvector for the smallest eigenvalue of the points' covariance. Covariances are computed in
    float64, relative to the point. Of a plane's two normals, the upper one is returned: z > 0, or z = 0 and y > 0, or
    z = y = 0 and x > 0. The normal is (0, 0, 1) if the points coincide, vary equally in all directions, or are fewer
    than three (K < 2). If the points lie on a line, the normal is perpendicular to the line.

    Args:
        points: ``[N, 3]`` float32 or float64, finite.
        neighbors: ``[N, K]`` int32 or int64, N < 2^31: the neighbours of each point, without the point itself.
        order: ``[N]`` int32, a permutation: the order in which rows are processed; the result does not depend on it.
            For a large cloud in random order, a spatial one is much faster.
            Default: 0, 1, ...

    Returns:
        ``[N, 3]`` float32, unit length. Runs on torch's threads; the result does not depend on the number of threads.
        No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a neighbour outside [0, N), an order that is no permutation.

    Example:
        >>> import torch
        >>> points = torch.tensor([[0.0, 0, 0], [0, 0, 1], [0, 2, 0]])  # in the plane x = 0
        >>> fit_normals(points, torch.tensor([[1, 2], [0, 2], [0, 1]])).abs()
        tensor([[1., 0., 0.],
                [1., 0., 0.],
                [1., 0., 0.]])
    """
    check_array("points", points, FLOATING, (None, 3), "[N, 3]")
    check_neighbors(neighbors, points.shape[0])
    check_order(order, points.shape[0])
    return call("fit_normals", points, neighbors, order)


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
        margin: width added to the image frame on each side, whole pixels: the column of the nearest pixel is kept in
            [-margin, width + margin), the row likewise. So a fraction adds one more pixel on the right and below.

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
    camera = (camera_from_world, intrinsics, float(near), float(far), height, width, float(margin))
    return call("project", points, *camera)


def splat_depth(row: Tensor, column: Tensor, depth: Tensor, reach: Tensor, height: int, width: int) -> Tensor:
    """Render points as squares into a z-buffer.

    Args:
        row, column: ``[M]`` int64, pixel of each point, inside the image.
        depth: ``[M]`` float32, in any unit, not NaN.
        reach: ``[M]`` int64, half width of each point's square, pixels: 0 is the pixel alone, 1 is 3 x 3 pixels.
        height, width: size of the image, pixels.

    Returns:
        ``[height, width]`` float32, the smallest depth at each pixel, in the unit of ``depth``; ``inf`` if no square
        covers the pixel. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a pixel outside the image, a NaN depth, a negative reach or size.

    Example:
        >>> import torch
        >>> splat_depth(
        ...     torch.tensor([0, 0]), torch.tensor([0, 3]), torch.tensor([2.0, 1.0]), torch.tensor([2, 1]), 2, 4
        ... )
        tensor([[2., 2., 1., 1.],
                [2., 2., 1., 1.]])
    """
    check_array("row", row, torch.int64, (None,), "[M]")
    check_array("column", column, torch.int64, (row.shape[0],), "[M]")
    check_array("depth", depth, torch.float32, (row.shape[0],), "[M]")
    check_array("reach", reach, torch.int64, (row.shape[0],), "[M]")
    check_number("height", height, (int,))
    check_number("width", width, (int,))
    return call("splat_depth", row, column, depth, reach, height, width)


def _nearest_neighbors(points: Tensor, count: int, num_distances: int, *_: object) -> tuple[Tensor, Tensor]:
    count = min(count, max(len(points) - 1, 0))
    indices = points.new_empty((len(points), count), dtype=torch.int32)
    return indices, points.new_empty((len(points), min(num_distances, count)))


register_fakes(
    nearest_neighbors=_nearest_neighbors,
    neighbor_edges=lambda neighbors, *_: neighbors.new_empty((2, dynamic_size()), dtype=torch.int64),
    fit_normals=lambda points, *_: points.new_empty((len(points), 3), dtype=torch.float32),
    project=lambda points, *_: of_one_size(points, (torch.int64,), *[(torch.float32,)] * 3),
    splat_depth=lambda _row, _column, depth, _reach, height, width: depth.new_empty(height, width),
)
