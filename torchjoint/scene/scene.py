"""One point cloud and its frames: the input of the method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.scene.checks import as_labels
from torchjoint.scene.cloud import Cloud
from torchjoint.scene.frame import Frame
from torchjoint.scene.subset import evenly_spaced_indices, subset
from torchjoint.scene.truth import Truth


@dataclass(frozen=True)
class Scene:
    """One point cloud and its frames.

    Args:
        points: [N, 3] metres, world frame; N >= 1, finite. They are stored as float32, or as float64 if float32 would
            round them. For clouds far from the origin pass float64.
        frames: a sequence of :class:`Frame`. It may be lazy (read at access) or empty (plain 3D segmentation).
        colors: optional [N, 3] RGB in [0, 1].
        normals: optional [N, 3], pointing out of the surface; estimated if absent.
        name: used in messages.
        truth: optional, the ground truth; the method never reads it.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """

    points: Tensor
    frames: Sequence[Frame] = field(default_factory=tuple)
    colors: Tensor | None = None
    normals: Tensor | None = None
    name: str = ""
    truth: Truth | None = None

    def __post_init__(self) -> None:
        cloud = Cloud.checked(self.points, self.colors, self.normals)
        for name in ("points", "colors", "normals"):
            object.__setattr__(self, name, getattr(cloud, name))
        if not (hasattr(self.frames, "__len__") and hasattr(self.frames, "__getitem__")):
            raise TypeError(f"frames: expected a sequence of Frame, got {type(self.frames).__name__}")
        if type(self.frames) in (list, tuple):  # other sequences may be lazy, so do not read them here
            for index, frame in enumerate(self.frames):
                if not isinstance(frame, Frame):
                    raise TypeError(f"frames[{index}]: expected a Frame, got {type(frame).__name__}")
        if self.truth is not None and self.truth.points is not None:
            as_labels(self.truth.points, (len(cloud.points),), "truth.points")

    @classmethod
    def from_open3d(cls, cloud: Any, frames: Sequence[Frame] = ()) -> Scene:
        """The scene of a point cloud of Open3D, or of the vertices of a mesh, with their colours and normals.

        Args:
            cloud: ``open3d.geometry.PointCloud`` or ``TriangleMesh``, or one of ``open3d.t.geometry``; in metres.
            frames: as above.

        Raises:
            TypeError: it is neither.
            ValueError: as above.
        """
        legacy = cloud.to_legacy() if hasattr(cloud, "to_legacy") else cloud
        for names in (("points", "colors", "normals"), ("vertices", "vertex_colors", "vertex_normals")):
            if all(hasattr(legacy, name) for name in names):
                points, *others = (torch.from_numpy(np.array(getattr(legacy, name))) for name in names)
                colors, normals = (other.float() if len(other) else None for other in others)
                return cls(points, frames, colors, normals)
        raise TypeError(f"cloud: expected a PointCloud or TriangleMesh of Open3D, got {type(cloud).__name__}")

    @property
    def cloud(self) -> Cloud:
        """The cloud without the frames."""
        return Cloud(self.points, self.colors, self.normals)

    def __repr__(self) -> str:
        parts = [f"{len(self.points)} points", f"{len(self.frames)} frames"]
        parts += [name for name in ("colors", "normals", "truth") if getattr(self, name) is not None]
        return f"Scene({self.name!r}: {', '.join(parts)})"

    def select_points(self, keep: Tensor) -> Scene:
        """The scene with some of its points, in the order of `keep` ([N] bool, or [M] int64 indices)."""
        return replace(
            self,
            points=self.points[keep],
            colors=None if self.colors is None else self.colors[keep],
            normals=None if self.normals is None else self.normals[keep],
            truth=None if self.truth is None else self.truth.select_points(keep),
        )

    def sample_frames(self, most: int) -> Scene:
        """The scene with at most `most` frames, evenly spread from the first to the last; lazy frames stay lazy."""
        if most >= len(self.frames):
            return self
        return self.select_frames(evenly_spaced_indices(len(self.frames), most))

    def select_frames(self, indices: Sequence[int]) -> Scene:
        """The scene with some of its frames, in the order of `indices`; lazy frames stay lazy."""
        return replace(
            self,
            frames=subset(self.frames, indices),
            truth=None if self.truth is None else self.truth.select_frames(indices),
        )
