"""Training scenes as another recording would have them: other light, fewer points, noise, no images, lumpy surfaces."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import torch
from torch import Generator, Tensor

from torchjoint.cloud.neighbors import SPACING_NEIGHBORS, Neighbors, nearest_neighbors
from torchjoint.scene import Scene, Truth
from torchjoint.scene.scene import voxel_subsample
from torchjoint_lab.benchmark.disturbances import DISTURBANCES

#: What may happen to the points of a scene, and to its colours.
OF_POINTS = ("moved", "half-points", "outliers-1", "twice")
OF_COLORS = (
    "light-0.1", "light-0.25", "light-0.5", "light-2", "gamma-0.5", "gamma-2", "warm", "cold", "exposure", "grey",
    "color-noise", "black",
)  # fmt: skip
#: Of a cloud alone: the largest side of its voxels and height of its lumps, in units of the spacing.
#: With 1.5 and 1.5 the roughness, bends and thickness of generated rooms are as those of real ones (3RScan).
LARGEST_VOXEL = 2.0
LARGEST_LUMP = 2.0
#: A lump is as wide as this many neighbours, so many times blurred.
LUMP_NEIGHBORS, BLURS = 16, 2


def varied(scene: Scene, key: str, share: float) -> Scene:
    """The scene with one disturbance of its points, one of its colours, both, or none; perhaps without its frames.

    A cloud alone has normals whose sides nobody knows, so that what is convex cannot be told from what is hollow. Its
    points are fewer and its surfaces lumpy, as those of clothes, bags and heaps.

    Args:
        scene: with ``truth.points``.
        key: decides what happens: equal keys, equal scenes.
        share: the probability of each of the two disturbances, and that of having no frames.
    """
    generator = torch.Generator().manual_seed(int.from_bytes(hashlib.sha256(key.encode()).digest()[:7]))
    for names in (OF_POINTS, OF_COLORS):
        happens, which = torch.rand(2, generator=generator).tolist()
        disturbance = DISTURBANCES[names[int(which * len(names))]]
        if happens < share and disturbance.applies(scene):
            assert scene.truth is not None
            assert scene.truth.points is not None
            disturbed = disturbance(scene, generator)
            instance = scene.truth.points[disturbed.original.clamp(min=0)].masked_fill(disturbed.original < 0, -1)
            scene = replace(disturbed.scene, truth=Truth(instance))
    is_alone = float(torch.rand(1, generator=generator)) < share
    return lumpy(replace(scene, frames=()), generator) if is_alone else scene


def lumpy(scene: Scene, generator: Generator) -> Scene:
    """A cloud with one point in each voxel, whose surfaces rise and fall; sizes are random."""
    side, height = torch.rand(2, generator=generator).tolist()
    spacing = float(_neighbors(scene.points, SPACING_NEIGHBORS).spacing.median())
    scene = scene.select_points(voxel_subsample(scene.points, LARGEST_VOXEL * side * spacing))
    near = _neighbors(scene.points, LUMP_NEIGHBORS)
    lumps = torch.randn(scene.points.shape, generator=generator)
    for _ in range(BLURS):
        lumps = (lumps + lumps[near.indices].sum(1)) / (LUMP_NEIGHBORS + 1)
    lumps *= LARGEST_LUMP * height / lumps.std() * near.spacing[:, None]
    return replace(scene, points=scene.points + lumps.to(scene.points.dtype))


def _neighbors(points: Tensor, count: int) -> Neighbors:
    return nearest_neighbors((points - points.mean(0)).float(), count)  # float32 rounds points far from the origin
