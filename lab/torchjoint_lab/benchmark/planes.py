"""RANSAC planes, then DBSCAN of the remaining points: the segmentation that most people try first."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.runtime.messages import needed_for
from torchjoint_lab.benchmark.vote import fill

#: Candidate planes per found plane, and the number of points that vote for the candidates.
TRIES, SAMPLE = 500, 10_000


def planes_and_clusters(
    points: Tensor,
    distance: float = 0.02,
    min_share: float = 0.05,
    max_planes: int = 8,
    eps: float = 0.05,
    min_points: int = 8,
    seed: int = 0,
) -> Tensor:
    """Segments a cloud into planes and clusters (M. Fischler, R. Bolles 1981; M. Ester et al. 1996).

    Repeatedly removes the largest plane. DBSCAN clusters the remaining points. DBSCAN's noise points join the nearest
    cluster or plane.

    Args:
        points: [N, 3] metres.
        distance: largest distance between a plane and its points, metres.
        min_share: smallest share of all points that a plane must have.
        max_planes: largest number of planes.
        eps: radius of DBSCAN, metres.
        min_points: of DBSCAN: points within eps of a core point.
        seed: of the random candidate planes.

    Returns:
        [N] int64.
    """
    labels = torch.full((len(points),), -1)
    random = torch.Generator().manual_seed(seed)
    count = 0
    while count < max_planes:
        rest = torch.nonzero(labels < 0).flatten()
        if len(rest) < max(3, min_share * len(points)):
            break
        inside = _largest_plane(points[rest].double(), distance, random)
        if int(inside.sum()) < min_share * len(points):
            break
        labels[rest[inside]] = count
        count += 1
    rest = torch.nonzero(labels < 0).flatten()
    if len(rest):
        labels[rest] = _clusters(points[rest], eps, min_points, count)
    return fill(labels, points)


def _largest_plane(points: Tensor, distance: float, random: torch.Generator) -> Tensor:
    """[n] bool: inliers of the best of `TRIES` planes through three points, after a least-squares fit to inliers."""
    triples = points[torch.randint(len(points), (TRIES, 3), generator=random)]
    normals = torch.linalg.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = normals.norm(dim=1, keepdim=True)
    normals = normals / length.clamp(min=1e-12)
    offsets = (normals * triples[:, 0]).sum(1)
    some = points[torch.randint(len(points), (min(SAMPLE, len(points)),), generator=random)]
    votes = ((some @ normals.T - offsets).abs() <= distance).sum(0)
    best = int(torch.where(length[:, 0] > 1e-9, votes, -1).argmax())  # three collinear points define no plane
    inside = (points @ normals[best] - offsets[best]).abs() <= distance
    if int(inside.sum()) < 3:
        return inside
    center = points[inside].mean(0)
    covariance = (points[inside] - center).T @ (points[inside] - center)
    normal = torch.linalg.eigh(covariance)[1][:, 0]
    return ((points - center) @ normal).abs() <= distance


def _clusters(points: Tensor, eps: float, min_points: int, first: int) -> Tensor:
    with needed_for("clustering by DBSCAN", "scikit-learn", "torchjoint-lab"):
        from sklearn.cluster import DBSCAN

    found = torch.from_numpy(DBSCAN(eps=eps, min_samples=min_points).fit_predict(points.numpy())).long()
    return torch.where(found >= 0, found + first, -1)
