"""Checks and splits a batch of clouds for superpoints: one tensor, in which `ptr` gives the start of each cloud."""

import warnings
from collections.abc import Collection
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.config import SuperpointsConfig
from torchjoint.ops._checks import check_array, check_tensor
from torchjoint.scene import Cloud
from torchjoint.scene.checks import Beams, Invalid, as_float, as_points, kept_points


class Batch(NamedTuple):
    """The tensors that :func:`torchjoint.superpoints` was given: dense, and not checked further yet."""

    points: Tensor  #: [N, 3] metres
    colors: Tensor | None
    normals: Tensor | None
    edges: Tensor | None  #: [2, E] integers, edges of all clouds in any order, in point numbers of the batch
    faces: Tensor | None  #: [F, 3] integers, triangles of all clouds in any order, in point numbers of the batch
    ptr: Tensor | None  #: [B + 1] integers, the start of each cloud, and N; None = one cloud
    viewpoint: Tensor | None  #: [3], [B, 3] or [N, 3] metres, of the sensor for all clouds, per cloud, or per point

    def tell_unread(self, config: SuperpointsConfig, given: Collection[str]) -> None:
        """Warns of given parameters that change nothing; `config` has all of them."""
        is_mesh = self.faces is not None
        graph, normals = is_mesh or self.edges is not None, is_mesh or self.normals is not None
        signs = config.weight == "segmentator" or not (normals or self.viewpoint is not None)
        unread = {"neighbors": graph, "normal_neighbors": normals, "reach": graph and normals, "convex_factor": signs}
        if names := [name for name in given if unread.get(name)]:
            told = "without effect here; `torchjoint parameters --superpoints` tells what counts where"
            warnings.warn(f"{', '.join(names)}: {told}", stacklevel=4)


def split_batch(given: Batch) -> list[Cloud]:
    """Splits a batch into its clouds, each with its own point numbers, in order."""
    batch, num_points = Cloud.checked(given.points, given.colors, given.normals), len(given.points)
    starts = _checked_ptr(given.ptr, num_points)
    all_edges = _split(_checked_nodes("edges", given.edges, num_points), starts, "edges")
    all_faces = _split(_checked_nodes("faces", given.faces, num_points), starts, "faces")
    views = _views(given.viewpoint, starts)
    return [
        Cloud(
            batch.points[start:end],
            None if batch.colors is None else batch.colors[start:end],
            None if batch.normals is None else batch.normals[start:end],
            own_edges,
            None if own_faces is None else own_faces.T,
            view,
        )
        for (start, end), own_edges, own_faces, view in zip(pairwise(starts), all_edges, all_faces, views, strict=True)
    ]


def without_invalid(batch: Batch, invalid: Invalid) -> tuple[Tensor, Batch]:
    """A batch without the points that are NaN or infinite, beams without return, and edges and triangles to them.

    Args:
        batch: as it was given.
        invalid: what becomes of points that are NaN or infinite.

    Returns:
        which points are kept, [N] bool; and the batch without the others.
    """
    points, colors, normals, edges, faces, ptr, viewpoint = batch
    if points.ndim != 2 or not points.is_floating_point():
        as_points(points)  # raises the error
    beams: Beams = "drop many" if edges is None and faces is None else "keep"
    num_points, starts = len(points), _checked_ptr(ptr, len(points))
    valid = kept_points(points, "points", invalid, beams, starts[1:-1])
    if bool(valid.all()):
        return valid, batch
    first = torch.nn.functional.pad(valid.cumsum(0), (1, 0))  # kept points before each point
    edges, faces = (
        None if nodes is None else first[nodes[:, valid[nodes].all(0)]]
        for nodes in (_checked_nodes("edges", edges, num_points), _checked_nodes("faces", faces, num_points))
    )
    colors, normals, viewpoint = (
        of[valid] if isinstance(of, Tensor) and of.shape == points.shape else of for of in (colors, normals, viewpoint)
    )
    faces = None if faces is None else faces.T
    return valid, Batch(points[valid], colors, normals, edges, faces, first[starts], viewpoint)


def _checked_ptr(ptr: Tensor | None, num_points: int) -> list[int]:
    if ptr is None:
        return [0, num_points]
    check_tensor("ptr", ptr, (torch.int32, torch.int64))
    if ptr.ndim != 1 or len(ptr) < 2:
        raise ValueError(f"ptr: expected shape [B + 1], B >= 1, got {list(ptr.shape)}")
    starts: list[int] = ptr.tolist()
    if starts[0] != 0 or starts[-1] != num_points:
        raise ValueError(f"ptr: expected to go from 0 to N = {num_points}, got {starts[0]} to {starts[-1]}")
    for b, (start, end) in enumerate(pairwise(starts)):
        if end <= start:
            raise ValueError(f"ptr: expected ascending numbers (no cloud is empty), got {start}, {end} for cloud {b}")
    return starts


def _checked_nodes(name: str, nodes: Tensor | None, num_points: int) -> Tensor | None:
    """Edges [2, E] unchanged, faces [F, 3] transposed to [3, F]; int64, all in [0, N)."""
    if nodes is None:
        return None
    shape, form = ((2, None), "[2, E]") if name == "edges" else ((None, 3), "[F, 3]")
    check_array(name, nodes, (torch.int32, torch.int64), shape, form)
    nodes = (nodes if name == "edges" else nodes.T).to(torch.int64)
    if nodes.numel() and not 0 <= int(nodes.min()) <= int(nodes.max()) < num_points:
        got = f"{int(nodes.min())} to {int(nodes.max())}"
        raise ValueError(f"{name}: expected point numbers in [0, {num_points}), got {got}")
    return nodes


def _views(viewpoint: Tensor | None, starts: list[int]) -> list[Tensor | None]:
    """For each cloud the position of its sensor [3], or one position per point [n, 3]."""
    num_clouds, num_points = len(starts) - 1, starts[-1]
    if viewpoint is None:
        return [None] * num_clouds
    viewpoint = as_float(viewpoint, "viewpoint", torch.float64)
    shape = list(viewpoint.shape)
    if shape not in ([3], [num_clouds, 3], [num_points, 3]):
        raise ValueError(f"viewpoint: expected shape [3], [{num_clouds}, 3] or [{num_points}, 3], got {shape}")
    if shape == [3]:
        return [viewpoint] * num_clouds
    if shape == [num_clouds, 3]:
        return list(viewpoint)
    return [viewpoint[start:end] for start, end in pairwise(starts)]


def _split(nodes: Tensor | None, starts: list[int], name: str) -> list[Tensor | None]:
    """Splits edges [2, E] or triangles [3, F] by cloud; keeps their order, and counts points within each cloud."""
    num_clouds = len(starts) - 1
    if nodes is None or num_clouds == 1:
        return [nodes] * num_clouds
    cloud = torch.bucketize(nodes.contiguous(), torch.tensor(starts[1:]), right=True)
    across = (cloud != cloud[0]).any(dim=0)
    if across.any():
        raise ValueError(f"{name}: expected points of one cloud, got {nodes[:, across][:, 0].tolist()} across clouds")
    order = torch.argsort(cloud[0], stable=True)
    parts = nodes[:, order].split(torch.bincount(cloud[0], minlength=num_clouds).tolist(), dim=1)
    return [part - start for part, start in zip(parts, starts[:-1], strict=True)]
