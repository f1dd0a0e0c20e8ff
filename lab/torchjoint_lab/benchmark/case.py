"""A benchmark scene that many methods and settings are run on; shared intermediate results are computed once."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.config import Config
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Frame, Scene
from torchjoint.scene.frame import camera_center
from torchjoint.views.visibility import Visible, visible_points
from torchjoint_lab.benchmark.paint import paint


class Case:
    """A scene with all its frames loaded, and a cache of the results that methods share.

    Args:
        scene: with ground truth.
        config: common to all methods on this data set, for example how visibility is computed; each method's own
            setting is applied on top.
        preset: the parameters of the joint method for this kind of data; default: `config`.
    """

    def __init__(self, scene: Scene, config: Config, preset: Config | None = None) -> None:
        self.scene = scene
        self.config = config
        self.preset = preset or config
        self.frames: list[Frame] = parallel_map(scene.frames.__getitem__, range(len(scene.frames)))
        self._kept: dict[str, tuple[Hashable, Any]] = {}

    def digest(self) -> str:
        """Returns a SHA-256 hash, hex, of the points and their ground truth; identifies the scene."""
        truth = self.scene.truth
        tensors = [self.scene.points, *(() if truth is None or truth.points is None else (truth.points,))]
        return hashlib.sha256(b"".join(tensor.numpy().tobytes() for tensor in tensors)).hexdigest()

    def keep(self, what: str, key: Hashable, make: Callable[[], Any]) -> Any:
        """Returns the cached result of `make`; calls `make` again only if `key` differs from the last key."""
        if what not in self._kept or self._kept[what][0] != key:
            self._kept.pop(what, None)  # freed before the next result is made: both are large
            self._kept[what] = (key, make())
        return self._kept[what][1]

    def forget(self) -> None:
        """Empties the cache."""
        self._kept.clear()

    @cached_property
    def visible(self) -> list[Visible]:
        """The visible points of each frame."""
        spacing = nearest_neighbors(self.scene.points, 4).spacing

        def see(frame: Frame) -> Visible:
            camera = (frame.intrinsics, frame.world_to_camera, frame.size)
            return visible_points(self.scene.points, spacing, *camera, self.config.visibility)

        return parallel_map(see, self.frames)

    @cached_property
    def viewpoints(self) -> Tensor | None:
        """[N, 3] per point the center of the nearest camera that sees the point, else of the nearest camera."""
        if not self.frames:
            return None
        points = self.scene.points.float()
        centers = torch.stack([camera_center(frame.world_to_camera).float() for frame in self.frames])
        nearest = torch.full((len(points),), torch.inf)
        chosen = torch.cdist(points, centers).argmin(1)
        for index, visible in enumerate(self.visible):
            distance = (points[visible.point] - centers[index]).norm(dim=1)
            closer = distance < nearest[visible.point]
            nearest[visible.point[closer]] = distance[closer]
            chosen[visible.point[closer]] = index
        return centers[chosen]

    def paint(self, point_labels: Tensor) -> list[Tensor]:
        """Turns point labels [N] into a label image per frame; a pixel gets the nearest visible point's label."""
        pairs = list(zip(self.visible, self.frames, strict=True))
        return parallel_map(lambda pair: paint(pair[0], point_labels, pair[1].size), pairs)
