"""A cloud with its frames, its truth, and chosen parts of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar, cast

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset, Subset

from torchjoint.runtime.groups import best_of_groups
from torchjoint.runtime.messages import counted
from torchjoint.scene.checks import as_direction, as_labels
from torchjoint.scene.cloud import Cloud
from torchjoint.scene.frame import Frame

T = TypeVar("T")


def subset(items: Sequence[T], indices: Sequence[int]) -> Sequence[T]:
    """The items at `indices`, in this order; lazy items stay lazy."""
    return cast(Sequence[T], Subset(cast(Dataset[T], items), indices))


def evenly_spaced_indices(count: int, most: int) -> list[int]:
    """At most `most` of the numbers 0 ... count - 1, evenly spread from the first to the last.

    >>> evenly_spaced_indices(10, 4)
    [0, 3, 6, 9]
    """
    places = torch.linspace(0, max(count - 1, 0), min(most, count), dtype=torch.float32, device="cpu")
    return [int(place) for place in places.round().tolist()]


@dataclass(frozen=True)
class Truth:
    """The ground truth of a scene. It is only compared with results.

    Args:
        points: optional [N] integers, the instance of each point, -1 = unknown (void).
        images: label images [H, W], -1 = void, one per frame (may be lazy); empty if there are none. Their number is
            checked where they are used.
        kinds: instance -> kind, such as "flat", for instances that are also scored per kind.
    """

    points: Tensor | None = None
    images: Sequence[Tensor] = ()
    kinds: Mapping[int, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        points = "none" if self.points is None else f"{len(self.points)}"
        return f"Truth({points} points, {len(self.images)} images)"

    def select_points(self, keep: Tensor) -> Truth:
        """The truth of some of the points, in the order of `keep` ([N] bool, or [M] int64 indices)."""
        return self if self.points is None else replace(self, points=self.points[keep])

    def select_frames(self, indices: Sequence[int]) -> Truth:
        """The truth of some of the frames, in the order of `indices`."""
        return replace(self, images=subset(self.images, indices)) if len(self.images) else self


def voxel_subsample(points: Tensor, size: float) -> Tensor:
    """Keeps one point per cubic voxel: the point nearest to the voxel's centre (ties: the first point).

    Args:
        points: [N, 3] metres.
        size: side of a voxel, metres; about the spacing of the points that are kept.

    Returns:
        [M] int64 indices of the points that are kept, ascending.

    >>> voxel_subsample(torch.tensor([[0.1, 0.1, 0.1], [0.5, 0.5, 0.4], [1.2, 0.0, 0.0]]), 1.0)
    tensor([1, 2])
    """
    if not size > 0:
        raise ValueError(f"size: expected more than 0 metres, got {size}")
    scaled = (points.double() - points.double().amin(0)) / size
    if float(scaled.max()) >= 1 << 20:
        raise ValueError(f"size: {size} m is too small for a cloud {float(scaled.max()) * size:.3g} m wide")
    cell = scaled.long()
    off_center = (scaled - cell - 0.5).square().sum(1)
    voxel = torch.unique((cell[:, 0] << 40) + (cell[:, 1] << 20) + cell[:, 2], return_inverse=True)[1]
    count = int(voxel.max()) + 1 if len(voxel) else 0
    return best_of_groups(voxel, torch.arange(len(points)), -off_center, count)[0].sort().values


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
        up: optional [3], the direction against gravity in the world frame, of any length: boxes and pictures stand
            upright in it. Absent, it is estimated from the poses and the floor; without frames it is +z.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.
    """

    points: Tensor
    frames: Sequence[Frame] = field(default_factory=tuple)
    colors: Tensor | None = None
    normals: Tensor | None = None
    name: str = ""
    truth: Truth | None = None
    up: Tensor | None = None

    def __post_init__(self) -> None:
        if self.up is not None:
            object.__setattr__(self, "up", as_direction(self.up, "up"))
        cloud = Cloud.checked(self.points, self.colors, self.normals)
        object.__setattr__(self, "points", cloud.points.clone())  # callers may write the next cloud into theirs
        for name in ("colors", "normals"):
            object.__setattr__(self, name, getattr(cloud, name))
        if not (hasattr(self.frames, "__len__") and hasattr(self.frames, "__getitem__")):
            raise TypeError(f"frames: expected a sequence of Frame, got {type(self.frames).__name__}")
        if type(self.frames) in (list, tuple):  # other sequences may be lazy, so do not read them here
            for index, frame in enumerate(self.frames):
                if not isinstance(frame, Frame):
                    raise TypeError(f"frames[{index}]: expected a Frame, got {type(frame).__name__}")
            object.__setattr__(self, "frames", tuple(self.frames))  # callers may gather the next scene's in their list
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
        parts = [f"{len(self.points)} points", counted(len(self.frames), "frame")]
        parts += [name for name in ("colors", "normals", "truth") if getattr(self, name) is not None]
        return f"Scene({self.name!r}: {', '.join(parts)})"

    def select_points(self, keep: Tensor) -> Scene:
        """The scene with some of its points, in the order of `keep` ([N] bool, or [M] int64 indices)."""
        colors, normals = (None if of is None else of[keep] for of in (self.colors, self.normals))
        truth = None if self.truth is None else self.truth.select_points(keep)
        return replace(self, points=self.points[keep], colors=colors, normals=normals, truth=truth)

    def sample_frames(self, most: int) -> Scene:
        """The scene with at most `most` frames, evenly spread from the first to the last; lazy frames stay lazy."""
        count = len(self.frames)
        return self if most >= count else self.select_frames(evenly_spaced_indices(count, most))

    def select_frames(self, indices: Sequence[int]) -> Scene:
        """The scene with some of its frames, in the order of `indices`, or by a mask [F] bool; lazy ones stay lazy."""
        chosen = np.arange(len(self.frames))[[*indices]].tolist()
        truth = None if self.truth is None else self.truth.select_frames(chosen)
        return replace(self, frames=subset(self.frames, chosen), truth=truth)
