"""Superpoints: an over-segmentation of a point cloud into small pieces that do not cross the borders of objects."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from torchjoint import ops
from torchjoint.point_graph import estimate_normals, geometric_weights, nearest_neighbors, undirected_edges
from torchjoint.scene import Scene
from torchjoint.segmentator import face_edges, segmentator_turn, vertex_normals
from torchjoint.superpoints_config import SuperpointsConfig
from torchjoint.threads import map_frames, one_thread_per_operation


def superpoints(
    points: Tensor,
    colors: Tensor | None = None,
    normals: Tensor | None = None,
    *,
    edges: Tensor | None = None,
    faces: Tensor | None = None,
    ptr: Tensor | None = None,
    viewpoint: Tensor | None = None,
    preset: str | SuperpointsConfig = "room",
    neighbors: int | None = None,
    normal_neighbors: int | None = None,
    weight: str | None = None,
    angle_weight: float | None = None,
    convex_factor: float | None = None,
    distance_weight: float | None = None,
    color_weight: float | None = None,
    scale: float | None = None,
    min_size: int | None = None,
) -> Tensor:
    """Cut a cloud, or several, into superpoints.

    A graph of nearest neighbours (or the edges of a mesh, or your own) is weighted by how much the surface turns along
    each edge, and segmented as Felzenszwalb and Huttenlocher do (:func:`torchjoint.ops.felzenszwalb`). Points are all
    that is needed; what else is given is used.

    The signs of fitted normals are arbitrary, so angles count without sign, and convex edges like concave ones, unless
    `normals`, `faces` or a `viewpoint` tell inside from outside.

    Args:
        points: [N, 3] metres, finite, N >= 1.
        colors: optional [N, 3] RGB in [0, 1], or uint8; needed if a `color_weight` is given. That of a preset counts
            where there are colours.
        normals: optional [N, 3], of meaningful sign, any length but 0; fitted to the points where absent.
        edges: optional [2, E] integers, a graph to use instead of that of nearest neighbours.
        faces: optional [F, 3] integers, triangles of a mesh whose vertices are the points: their edges are the graph,
            and their normals, where none are given, the normals. With preset "segmentator" and no normals the result
            is that of ScanNet's segmentator. A vertex of no triangle is a superpoint of its own.
        ptr: optional [B + 1] integers, where each of B clouds starts, and N: 0 = ptr[0] < ptr[1] < ... < ptr[B] = N.
        viewpoint: optional [3] metres, where the sensor stood; or one for each cloud [B, 3], or each point [N, 3].
        preset: "room", "outdoor" or "segmentator", a YAML file, or a config; the other arguments, where not None,
            replace what it says. :class:`SuperpointsConfig` and the README tell what they do, their units and ranges.

    Returns:
        [N] int64 labels 0, 1, 2, ... in the order of their first points. Those of a cloud follow those of the cloud
        before it, and are, but for that offset, the same as if it had come alone. The same input has the same labels,
        whatever the number of threads.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.

    Example:
        >>> import torch, torchjoint as tj
        >>> floor = torch.cartesian_prod(torch.arange(20.0), torch.arange(20.0), torch.zeros(1)) / 10
        >>> wall = floor[:, [2, 1, 0]] + torch.tensor([-0.1, 0.0, 0.1])
        >>> labels = tj.superpoints(torch.cat([floor, wall]), min_size=50)
        >>> labels.unique(return_counts=True)
        (tensor([0, 1]), tensor([400, 400]))
    """
    given = {
        "neighbors": neighbors, "normal_neighbors": normal_neighbors, "weight": weight, "angle_weight": angle_weight,
        "convex_factor": convex_factor, "distance_weight": distance_weight, "color_weight": color_weight,
        "scale": scale, "min_size": min_size,
    }  # fmt: skip
    config = (preset if isinstance(preset, SuperpointsConfig) else SuperpointsConfig.from_preset(preset)).replace(
        {name: value for name, value in given.items() if value is not None}
    )
    scene = Scene(points, colors=colors, normals=normals)
    if colors is None:
        if color_weight:  # asked for, and not just part of a preset
            raise ValueError("colors: color_weight > 0 needs the colours of the points, got None")
        config = config.replace({"color_weight": 0.0})
    if edges is not None and faces is not None:
        raise ValueError("edges: expected edges or faces, got both")
    with torch.no_grad(), one_thread_per_operation():
        clouds = list(_clouds(scene, edges, faces, ptr, viewpoint))
        labels = map_frames(lambda cloud: _segment(cloud, config), clouds)
        offset = 0
        for part in labels:
            part += offset
            offset = int(part.max()) + 1
        return torch.cat(labels)


class Superpoints(nn.Module):
    """:func:`superpoints` as a module, for a chain of modules and to keep parameters together.

    Args:
        preset: as of :func:`superpoints`.
        parameters: replace what the preset says, by name: ``Superpoints("outdoor", scale=2.0)``.

    Raises:
        ValueError, TypeError: an unknown parameter, or a bad value, by name.

    Example:
        >>> import torch, torchjoint as tj
        >>> tj.Superpoints(min_size=2)(torch.rand(100, 3)).shape
        torch.Size([100])
    """

    def __init__(self, preset: str | SuperpointsConfig = "room", **parameters: float | str) -> None:
        super().__init__()
        self.preset = preset if isinstance(preset, SuperpointsConfig) else SuperpointsConfig.from_preset(preset)
        self.config = self.preset.replace(parameters)
        self.parameters_given = parameters

    def forward(
        self,
        points: Tensor,
        colors: Tensor | None = None,
        normals: Tensor | None = None,
        ptr: Tensor | None = None,
    ) -> Tensor:
        """Labels [N] int64 of points [N, 3]; see :func:`superpoints`."""
        return superpoints(points, colors, normals, ptr=ptr, preset=self.preset, **self.parameters_given)  # type: ignore[arg-type]

    def extra_repr(self) -> str:
        """The parameters, shown when the module is printed."""
        return repr(self.config)


class _Cloud(NamedTuple):
    """One cloud, checked; node numbers are its own."""

    points: Tensor
    colors: Tensor | None
    normals: Tensor | None
    edges: Tensor | None
    faces: Tensor | None
    viewpoint: Tensor | None


def _clouds(
    scene: Scene, edges: Tensor | None, faces: Tensor | None, ptr: Tensor | None, viewpoint: Tensor | None
) -> Iterator[_Cloud]:
    """Checks what is given beside the points, and takes clouds apart."""
    num_points = len(scene.points)
    starts = _checked_ptr(ptr, num_points)
    num_clouds = len(starts) - 1
    all_edges = _split(_checked_nodes("edges", edges, num_points), starts, "edges")
    triangles = None if faces is None else _checked_nodes("faces", faces, num_points)
    all_faces = _split(triangles, starts, "faces")
    viewpoint = _checked_viewpoint(viewpoint, num_points, num_clouds)
    for b, (start, end) in enumerate(zip(starts[:-1], starts[1:], strict=True)):
        views = None
        if viewpoint is not None:
            views = viewpoint[start:end] if len(viewpoint) == num_points else viewpoint[b % len(viewpoint)]
        yield _Cloud(
            scene.points[start:end],
            None if scene.colors is None else scene.colors[start:end],
            None if scene.normals is None else scene.normals[start:end],
            all_edges[b],
            None if all_faces[b] is None else all_faces[b].T,  # type: ignore[union-attr]
            views,
        )


def _segment(cloud: _Cloud, config: SuperpointsConfig) -> Tensor:
    """One cloud -> [N] int64 labels."""
    edges, normals, known = _graph(cloud, config)
    turn = segmentator_turn if config.weight == "segmentator" else None
    signs = torch.full((len(cloud.points),), known)
    weights = geometric_weights(cloud.points, edges, normals, signs, config.point_graph, cloud.colors, turn)
    return ops.felzenszwalb(edges, weights, len(cloud.points), config.scale, config.min_size)


def _graph(cloud: _Cloud, config: SuperpointsConfig) -> tuple[Tensor, Tensor, bool]:
    """Edges [2, E], normals [N, 3], and whether their signs are known."""
    points, normals, edges, known = cloud.points, cloud.normals, cloud.edges, True
    if cloud.faces is not None:
        edges = face_edges(cloud.faces)
        normals = vertex_normals(points, cloud.faces) if normals is None else normals
    count = max(config.neighbors if edges is None else 0, config.normal_neighbors if normals is None else 0)
    nearest = nearest_neighbors(points, count).indices if count else torch.empty(0)
    if normals is None:
        normals, known = estimate_normals(points, nearest[:, : config.normal_neighbors]), False
        if cloud.viewpoint is not None:
            normals, known = _turned_to(cloud.viewpoint, points, normals), True
    if edges is None:
        edges = undirected_edges(nearest[:, : config.neighbors])
    return edges, normals, known


def _turned_to(viewpoint: Tensor, points: Tensor, normals: Tensor) -> Tensor:
    """A surface is seen from outside: its normals show towards the sensor."""
    x, y, z = (normals * (viewpoint - points)).unbind(1)
    return torch.where(((x + y) + z < 0)[:, None], -normals, normals)


def _checked_ptr(ptr: Tensor | None, num_points: int) -> list[int]:
    if ptr is None:
        return [0, num_points]
    _check_integers("ptr", ptr)
    if ptr.ndim != 1 or len(ptr) < 2:
        raise ValueError(f"ptr: expected shape [B + 1], B >= 1, got {list(ptr.shape)}")
    starts: list[int] = ptr.tolist()
    if starts[0] != 0 or starts[-1] != num_points:
        raise ValueError(f"ptr: expected to go from 0 to N = {num_points}, got {starts[0]} to {starts[-1]}")
    for b, (start, end) in enumerate(zip(starts[:-1], starts[1:], strict=True)):
        if end <= start:
            raise ValueError(f"ptr: expected ascending numbers (no cloud is empty), got {start}, {end} for cloud {b}")
    return starts


def _checked_nodes(name: str, nodes: Tensor | None, num_points: int) -> Tensor | None:
    """Edges [2, E] as they are, faces [F, 3] as [3, F]; int64, all in [0, N)."""
    if nodes is None:
        return None
    _check_integers(name, nodes)
    if name == "edges" and (nodes.ndim != 2 or nodes.shape[0] != 2):
        raise ValueError(f"edges: expected shape [2, E], got {list(nodes.shape)}")
    if name == "faces" and (nodes.ndim != 2 or nodes.shape[1] != 3):
        raise ValueError(f"faces: expected shape [F, 3], got {list(nodes.shape)}")
    nodes = (nodes if name == "edges" else nodes.T).to(torch.int64)
    if nodes.numel() and not 0 <= int(nodes.min()) <= int(nodes.max()) < num_points:
        raise ValueError(
            f"{name}: expected point numbers in [0, {num_points}), got {int(nodes.min())} to {int(nodes.max())}"
        )
    return nodes


def _checked_viewpoint(viewpoint: Tensor | None, num_points: int, num_clouds: int) -> Tensor | None:
    """[1, 3], [B, 3] or [N, 3]."""
    if viewpoint is None:
        return None
    if not isinstance(viewpoint, Tensor) or not viewpoint.is_floating_point():
        came = viewpoint.dtype if isinstance(viewpoint, Tensor) else type(viewpoint).__name__
        raise TypeError(f"viewpoint: expected a floating torch.Tensor, got {came}")
    shape = list(viewpoint.shape)
    if shape not in ([3], [num_clouds, 3], [num_points, 3]):
        raise ValueError(f"viewpoint: expected shape [3], [{num_clouds}, 3] or [{num_points}, 3], got {shape}")
    if not torch.isfinite(viewpoint).all():
        raise ValueError("viewpoint: expected finite values, got NaN or infinite ones")
    return viewpoint.detach().float().view(-1, 3)


def _check_integers(name: str, value: Any) -> None:
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a torch.Tensor, got {type(value).__name__}")
    if value.dtype not in (torch.int32, torch.int64):
        raise TypeError(f"{name}: expected dtype torch.int32 or torch.int64, got {value.dtype}")


def _split(nodes: Tensor | None, starts: list[int], name: str) -> list[Tensor | None]:
    """Edges [2, E] or triangles [3, F] of all clouds -> of each cloud, in its own numbers and the order they came."""
    num_clouds = len(starts) - 1
    if nodes is None or num_clouds == 1:
        return [nodes] * num_clouds
    cloud = torch.bucketize(nodes.contiguous(), torch.tensor(starts[1:]), right=True)
    across = (cloud != cloud[0]).any(dim=0)
    if across.any():
        raise ValueError(f"{name}: expected points of one cloud, got {nodes[:, across][:, 0].tolist()} across clouds")
    order = torch.argsort(cloud[0], stable=True)
    counts = torch.bincount(cloud[0], minlength=num_clouds).tolist()
    parts = nodes[:, order].split(counts, dim=1)
    return [part - start for part, start in zip(parts, starts[:-1], strict=True)]
