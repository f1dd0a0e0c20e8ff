"""Training scenes as another recording would have them: in other light, with fewer points, with noise."""

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
    """The scene with one disturbance of its points, one of its colours, both, or none.

    Args:
        scene: with ``truth.points``.
        key: decides what happens: equal keys, equal scenes.
        share: the probability of each of the two disturbances.
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
    return scene
