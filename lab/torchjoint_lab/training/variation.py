"""Training scenes as another recording would have them: other light, fewer points, noise, no images."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import torch

from torchjoint.scene import Scene, Truth
from torchjoint_lab.benchmark.disturbances import DISTURBANCES

#: What may happen to the points of a scene, and to its colours.
OF_POINTS = ("moved", "half-points", "outliers-1", "twice")
OF_COLORS = (
    "light-0.1", "light-0.25", "light-0.5", "light-2", "gamma-0.5", "gamma-2", "warm", "cold", "exposure", "grey",
    "color-noise", "black",
)  # fmt: skip


def varied(scene: Scene, key: str, share: float) -> Scene:
    """The scene with one disturbance of its points, one of its colours, both, or none; perhaps without its frames.

    A cloud alone has normals whose sides nobody knows, so that what is convex cannot be told from what is hollow.

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
    return replace(scene, frames=()) if is_alone else scene
