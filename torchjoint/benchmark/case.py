"""A scene that several methods, or one method in many settings, are run on: what they share is made once."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from torchjoint.benchmark.paint import paint
from torchjoint.config import Config
from torchjoint.points.neighbors import nearest_neighbors
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Frame, Scene
from torchjoint.scene.camera import camera_center
from torchjoint.views.visibility import Visible, visible_points


class Case:
    """A scene with its frames read, and what follows from it.

    Args:
        scene: with truth.
        config: of the data set: says how visibility is found out; a method's own settings come on top.
        preset: the package's parameters for such data.
    """

    def __init__(self, scene: Scene, config: Config, preset: Config | None = None) -> None:
        self.scene = scene
        self.config = config
        self.preset = preset or config
        self.frames: list[Frame] = parallel_map(scene.frames.__getitem__, range(len(scene.frames)))
        self._kept: dict[str, tuple[Hashable, Any]] = {}

    def digest(self) -> str:
        """Tells scenes apart: a hash of the points and of what is known to be right."""
        truth = self.scene.truth
        tensors = [self.scene.points, *(() if truth is None or truth.points is None else (truth.points,))]
        return hashlib.sha256(b"".join(tensor.numpy().tobytes() for tensor in tensors)).hexdigest()

    def keep(self, what: str, key: Hashable, make: Callable[[], Any]) -> Any:
        """What `make` makes; it is made again only for another key than the last."""
        if what not in self._kept or self._kept[what][0] != key:
            self._kept.pop(what, None)  # before the next is made: they are large
            self._kept[what] = (key, make())
        return self._kept[what][1]

    def forget(self) -> None:
        """Lets go of what was kept."""
        self._kept.clear()

    @cached_property
    def visible(self) -> list[Visible]:
        """The points that each frame sees."""
        spacing = nearest_neighbors(self.scene.points, 4).spacing

        def see(frame: Frame) -> Visible:
            camera = (frame.intrinsics, frame.world_to_camera, frame.size)
            return visible_points(self.scene.points, spacing, *camera, self.config.visibility)

        return parallel_map(see, self.frames)

    @cached_property
    def viewpoints(self) -> Tensor:
        """[N, 3] where each point was seen from: the nearest camera that sees it, else the nearest of all."""
        points = self.scene.points
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
        """Labels of the points [N] as label images: every pixel has that of the nearest visible point."""
        pairs = list(zip(self.visible, self.frames, strict=True))
        return parallel_map(lambda pair: paint(pair[0], point_labels, pair[1].size), pairs)
