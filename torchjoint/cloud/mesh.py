"""Superpoints of meshes: edges and vertex normals as in ScanNet's mesh segmentator (step 3's graph).

A. Dai et al., "ScanNet: Richly-annotated 3D Reconstructions of Indoor Scenes", CVPR 2017. The float32 operations have
the same order as in the segmentator. So the partition is the same, unless edges have equal weights.
"""

import torch
from torch import Tensor

from torchjoint.cloud.normals import rounded_length


def face_edges(faces: Tensor) -> Tensor:
    """Three edges per triangle (a, b, c): a to b, a to c, c to b. An edge of several triangles is listed for each.

    Args:
        faces: [F, 3] int64.

    Returns:
        [2, 3 F] int64.
    """
    a, b, c = faces.unbind(1)
    return torch.stack([torch.stack([a, a, c], 1).flatten(), torch.stack([b, c, b], 1).flatten()])


def vertex_normals(points: Tensor, faces: Tensor) -> Tensor:
    """The mean of the unit normals of each vertex's triangles, not normalised to unit length.

    The triangles are blended into their vertices one after the other: normal <- lerp(normal, triangle normal,
    1 / (count + 1)). Triangles without area have no normal and are skipped. A vertex without triangles has normal 0.

    Args:
        points: [N, 3] float32 metres.
        faces: [F, 3] int64.

    Returns:
        [N, 3] float32, length at most 1.
    """
    p1, p2, p3 = points[faces].unbind(1)
    (x1, y1, z1), (x2, y2, z2) = (p2 - p1).unbind(1), (p3 - p1).unbind(1)
    cross = torch.stack([y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2], dim=1)
    length = rounded_length(cross)
    has_area = length > 0
    blend = (cross / length[:, None])[has_area].repeat_interleave(3, dim=0)
    vertex = faces[has_area].flatten()
    # The blends of one vertex must follow one another; each round does one blend of every vertex.
    order = torch.argsort(vertex, stable=True)
    counts = torch.bincount(vertex, minlength=len(points))
    first = counts.cumsum(0) - counts
    normals = torch.zeros_like(points)
    busy = torch.arange(len(points))
    for done in range(int(counts.max()) if len(points) else 0):
        busy = busy[counts[busy] > done]
        share = torch.tensor(1.0, dtype=torch.float32) / (done + 1.0)  # in float32, like the rest
        normals[busy] = share * blend[order[first[busy] + done]] + (1 - share) * normals[busy]
    return normals
