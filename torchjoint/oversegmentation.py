"""Superpoints: an over-segmentation of a point cloud into small pieces that do not cross object boundaries.

They use the graph of step 3, and need no images.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar, Unpack

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from torchjoint import ops
from torchjoint.cloud.batch import Batch, split_batch, without_invalid
from torchjoint.cloud.edge_weights import EdgeWeights, discounted_angle, geometric_weights, segmentator_turn
from torchjoint.cloud.graph import undirected_edges
from torchjoint.cloud.local import LocalFrame, composed, warn_of_rounding, without_copies
from torchjoint.cloud.mesh import face_edges, vertex_normals
from torchjoint.cloud.neighbors import neighbor_tables, order_along_space
from torchjoint.cloud.normals import estimate_normals
from torchjoint.config import SuperpointsConfig
from torchjoint.runtime.groups import check_dense, first_places
from torchjoint.runtime.threads import one_thread_per_operation, parallel_map
from torchjoint.scene import Cloud
from torchjoint.scene.checks import as_tensor

#: A tensor, or a numpy array.
Values = TypeVar("Values", Tensor, npt.NDArray[Any])


class SuperpointsParameters(TypedDict, total=False):
    """The parameters of :class:`SuperpointsConfig` by name, so that type checkers know them."""

    neighbors: int
    normal_neighbors: int
    reach: float
    weight: str
    angle_weight: float
    convex_factor: float
    distance_weight: float
    color_weight: float
    scale: float
    min_size: int
    joining: float


def superpoints(
    points: Values,
    colors: Values | None = None,
    normals: Values | None = None,
    *,
    edges: Values | None = None,
    faces: Values | None = None,
    ptr: Values | None = None,
    viewpoint: Values | None = None,
    drop_invalid: bool = False,
    preset: str | SuperpointsConfig = "default",
    **parameters: Unpack[SuperpointsParameters],
) -> Values:
    """Cut one or several clouds into superpoints.

    Builds a graph of nearest neighbours (or takes the edges of a mesh, or your own edges), weights each edge by how
    much the surface turns along it, and segments the graph with the algorithm of Felzenszwalb and Huttenlocher
    (:func:`torchjoint.ops.felzenszwalb`). With `joining`, its pieces then join
    (:func:`torchjoint.ops.merge_regions`). Only `points` is required; all other inputs are optional.

    Fitted normals have an arbitrary sign. So the angle between two of them is at most 90 degrees, and convex edges have
    the same weight as concave ones. `normals`, `faces` or a `viewpoint` give oriented normals; then the weights differ.

    All arrays may be numpy arrays instead of tensors; then the labels are a numpy array, too.

    Args:
        points: [N, 3] metres, finite, N >= 1.
        colors: optional [N, 3] RGB in [0, 1], or uint8; required if you pass a `color_weight` > 0. The `color_weight`
            of a preset is ignored for clouds without colours.
        normals: optional [N, 3], oriented, any length except 0; fitted to the points if absent or all equal.
        edges: optional [2, E] integers, a graph that replaces the graph of nearest neighbours.
        faces: optional [F, 3] integers, triangles of a mesh whose vertices are the points. Their edges are the graph;
            if `normals` is absent, the triangles also give the normals. With preset "segmentator" and no normals the
            result equals that of ScanNet's segmentator. A vertex without a triangle is its own superpoint.
        ptr: optional [B + 1] integers, the start of each of B clouds, then N: 0 = ptr[0] < ptr[1] < ... < ptr[B] = N.
        viewpoint: optional [3] metres, the position of the sensor; or one per cloud [B, 3], or per point [N, 3].
        drop_invalid: leave out the points that are NaN or infinite, with a warning; their label is -1, as is always
            that of beams without return (many points at (0, 0, 0), in a cloud without a graph of its own). Edges and
            triangles to them are left out, too. Else such points are an error.
        preset: "default", "scan" or "segmentator", a YAML file, or a config.
        parameters: replace parameters of the preset by name, such as ``scale=2.0``. :class:`SuperpointsConfig` declares
            them; ``torchjoint parameters --superpoints`` gives their units and ranges:

            * ``neighbors``, ``reach``: the neighbours of a point in the graph, and how far they must reach.
            * ``normal_neighbors``: the neighbours to which a normal is fitted.
            * ``weight``, ``angle_weight``, ``convex_factor``: how much a turn of the surface weighs.
            * ``distance_weight``, ``color_weight``: how much the distance and the colours of two points weigh.
            * ``scale``, ``min_size``, ``joining``: how large superpoints become.

    Returns:
        [N] int64 labels 0, 1, 2, ... in the order of their first points; -1 = left out. The labels of a cloud continue
        after those of the cloud before it. Apart from this offset a cloud gets the same labels as if it were segmented
        alone. The labels do not depend on the number of threads.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.

    Example:
        >>> import torch, torchjoint as tj
        >>> floor = torch.cartesian_prod(torch.arange(20.0), torch.arange(20.0), torch.zeros(1)) / 10
        >>> wall = floor[:, [2, 1, 0]] + torch.tensor([-0.2, 0.0, 0.1])
        >>> labels = tj.superpoints(torch.cat([floor, wall]), min_size=50)
        >>> labels.unique(return_counts=True)
        (tensor([0, 1]), tensor([400, 400]))
    """
    given: list[Any] = [points, colors, normals, edges, faces, ptr, viewpoint]
    batch = Batch(*(as_tensor(value, "superpoints") if isinstance(value, np.ndarray) else value for value in given))
    for name, value in batch._asdict().items():
        if value is not None or name == "points":
            check_dense(value, name)
    valid, batch = without_invalid(batch, "drop" if drop_invalid else "keep")
    labels = torch.full_like(valid, -1, dtype=torch.int64)
    labels[valid] = _segment_batch(batch, preset, parameters)
    return labels.numpy() if isinstance(points, np.ndarray) else labels


def _segment_batch(batch: Batch, preset: str | SuperpointsConfig, parameters: SuperpointsParameters) -> Tensor:
    """:func:`superpoints` of tensors."""
    config = preset if isinstance(preset, SuperpointsConfig) else SuperpointsConfig.from_preset(preset)
    config = config.replace(parameters)
    batch.tell_unread(config, parameters.keys())
    if batch.colors is None:
        if parameters.get("color_weight"):  # an explicit argument, not a part of a preset
            raise ValueError("colors: color_weight > 0 needs the colours of the points, got None")
        config = config.replace({"color_weight": 0.0})
    if batch.edges is not None and batch.faces is not None:
        raise ValueError("edges: expected edges or faces, got both")
    with torch.no_grad(), one_thread_per_operation():
        labels = parallel_map(lambda cloud: _segment(cloud, config), split_batch(batch))
        offset = 0
        for part in labels:
            part += offset
            offset = int(part.max()) + 1
        return torch.cat(labels)


class Superpoints(nn.Module):
    """:func:`superpoints` as a module that stores its parameters.

    Args:
        preset: as in :func:`superpoints`.
        parameters: replace parameters of the preset by name: ``Superpoints("scan", scale=2.0)``.

    Raises:
        ValueError, TypeError: an unknown parameter or a bad value; the message names it.

    Example:
        >>> import torch, torchjoint as tj
        >>> tj.Superpoints(min_size=2)(torch.rand(100, 3)).shape
        torch.Size([100])
    """

    #: The parameters, which cannot be changed.
    config: SuperpointsConfig = property(lambda self: self._config)  # type: ignore[assignment]

    def __init__(
        self, preset: str | SuperpointsConfig = "default", **parameters: Unpack[SuperpointsParameters]
    ) -> None:
        super().__init__()
        self.preset = preset if isinstance(preset, SuperpointsConfig) else SuperpointsConfig.from_preset(preset)
        self._config = self.preset.replace(parameters)
        self.given = parameters

    def forward(
        self,
        points: Tensor,
        colors: Tensor | None = None,
        normals: Tensor | None = None,
        ptr: Tensor | None = None,
        drop_invalid: bool = False,
    ) -> Tensor:
        """Labels [N] int64 of points [N, 3]; arguments and errors as in :func:`superpoints`."""
        return superpoints(
            points, colors, normals, ptr=ptr, drop_invalid=drop_invalid, preset=self.preset, **self.given
        )

    if TYPE_CHECKING:  # the one of nn.Module is untyped
        __call__ = forward

    def extra_repr(self) -> str:
        """The parameters, for the module's repr."""
        return repr(self.config)


def _segment(given: Cloud, config: SuperpointsConfig) -> Tensor:
    """The labels [N] int64 of one cloud."""
    cloud, of_point = _local(replace(given, normals=given.without_constants().normals), config.weight == "segmentator")
    edges, normals, oriented, spacing = _graph(cloud, config)
    warn_of_rounding(given.points, spacing)
    factor = config.convex_factor if oriented else 1.0  # otherwise convex and concave edges look the same
    turn = segmentator_turn if config.weight == "segmentator" else discounted_angle(factor)
    terms = EdgeWeights(turn, config.angle_weight, config.distance_weight, config.color_weight)
    all_oriented = torch.full((len(cloud.points),), oriented)
    weights = geometric_weights(cloud.points, edges, normals, all_oriented, terms, cloud.colors)
    labels = ops.felzenszwalb(edges, weights, len(cloud.points), config.scale, config.min_size)
    if config.joining:
        size, costs = labels.bincount(), weights.clamp_(max=1024)  # the operator's largest
        labels = ops.merge_regions(labels[edges], costs, size, config.joining, by_size=True)[labels]
    return labels if of_point is None else labels[of_point]


def _local(cloud: Cloud, is_segmentator: bool) -> tuple[Cloud, Tensor | None]:
    """The cloud that is segmented, in local coordinates; and its point for each given point, None: the same points.

    Copies are merged only if the graph is computed here. Given edges and faces define which points are connected.
    """
    ours, viewpoint, of_given = cloud.edges is None and cloud.faces is None, cloud.viewpoint, None
    if ours:
        cloud, of_given = without_copies(cloud)
    # ScanNet's segmentator computes normals from float32 coordinates, as which it reads those of a file. So does this,
    # unless it would round those of a survey.
    is_single = cloud.points.dtype != torch.float64 or (is_segmentator and float(cloud.points.abs().max()) < 1000)
    as_given = cloud.faces is not None and is_single
    frame = LocalFrame.of_world() if as_given else LocalFrame.of(cloud.points)
    cloud = frame.cloud(cloud)
    if ours:
        cloud, of_point = without_copies(cloud)
        of_given = composed(of_given, of_point)
    if viewpoint is not None:
        viewpoint = (viewpoint.double() - frame.origin).float()
        if of_given is not None and viewpoint.ndim == 2:
            viewpoint = viewpoint[first_places(of_given)]
    return replace(cloud, viewpoint=viewpoint), of_given


def _graph(cloud: Cloud, config: SuperpointsConfig) -> tuple[Tensor, Tensor, bool, Tensor]:
    """Edges [2, E], normals [N, 3], whether the normals are oriented, and the spacing [N] (empty if not measured)."""
    points, normals, edges, oriented = cloud.points, cloud.normals, cloud.edges, True
    if cloud.faces is not None:
        edges = face_edges(cloud.faces)
        normals = vertex_normals(points, cloud.faces) if normals is None else normals
    for_edges = config.neighbors if edges is None else 0
    for_normals = config.normal_neighbors if normals is None else 0
    table, spacing = neighbor_tables(points, (for_edges, for_normals), config.reach)
    order = order_along_space(points) if table else None
    if normals is None:
        normals, oriented = estimate_normals(points, table[for_normals], order), False
        if cloud.viewpoint is not None:  # turned towards the sensor: a surface is seen from outside
            x, y, z = (normals * (cloud.viewpoint - points)).unbind(1)
            normals, oriented = torch.where(((x + y) + z < 0)[:, None], -normals, normals), True
    if edges is None:
        edges = undirected_edges(table[for_edges], order)
    return edges, normals, oriented, spacing
