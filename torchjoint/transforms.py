"""Transforms for data pipelines: add superpoints to samples, and transfer labels to resampled clouds.

This is no step of the joint method. A transform takes a sample and returns a new one. It keeps no state, so it can run
in the workers of a :class:`torch.utils.data.DataLoader`, forked or spawned. There it uses the one thread that torch
gives each worker.
"""

import copy
import math
import warnings
from collections.abc import Mapping
from typing import Any, TypeVar, Unpack

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from torchjoint.cloud.local import distinct_points, warn_of_rounding
from torchjoint.config import SuperpointsConfig
from torchjoint.oversegmentation import SuperpointsParameters, superpoints
from torchjoint.runtime.groups import check_dense, first_places
from torchjoint.runtime.threads import num_threads
from torchjoint.scene.checks import as_points

__all__ = ["AddSuperpoints", "transfer_labels"]

Sample = TypeVar("Sample")


class AddSuperpoints:
    """Adds the superpoint labels of a sample's cloud to the sample, as [N] int64.

    A sample is a mapping of names to tensors, or an object with attributes, such as torch_geometric's ``Data``:
    ``AddSuperpoints(points="pos", colors="rgb", normals="normal")``. The sample must have the points. The other
    entries are used if the sample has them and they are not None.

    Args:
        points, colors, normals, faces, edges, ptr, viewpoint: names under which the sample stores the arguments of
            :func:`torchjoint.superpoints`; None = never use this argument. The faces of an object (not of a mapping)
            may be [3, F], as in torch_geometric; three of three points are so only under its name, "face".
        to: name under which the labels are stored. None: ``superpoints``; but in torch_geometric's ``Data``
            ``superpoints_batch``. To an attribute with "batch" in its name torch_geometric adds the number of ids
            in the clouds before, so the clouds of a batch have different ids.
        preset: as in :func:`torchjoint.superpoints`.
        parameters: replace parameters of the preset by name.

    Raises:
        KeyError: (at a call) the sample has no points, or already has an entry named `to`.
        ValueError, TypeError: as in :func:`torchjoint.superpoints`.

    Example:
        >>> import torch, torchjoint as tj
        >>> add = tj.transforms.AddSuperpoints(min_size=5)
        >>> sample = add({"points": torch.rand(50, 3), "name": "cube"})
        >>> sorted(sample), sample["superpoints"].shape
        (['name', 'points', 'superpoints'], torch.Size([50]))
    """

    #: The parameters, which cannot be changed.
    config: SuperpointsConfig = property(lambda self: self._config)  # type: ignore[assignment]

    def __init__(
        self,
        points: str = "points",
        colors: str | None = "colors",
        normals: str | None = "normals",
        *,
        faces: str | None = None,
        edges: str | None = None,
        ptr: str | None = "ptr",
        viewpoint: str | None = "viewpoint",
        to: str | None = None,
        preset: str | SuperpointsConfig = "default",
        **parameters: Unpack[SuperpointsParameters],
    ) -> None:
        self.points, self.to, self.parameters = points, to, parameters
        self.names = {
            "colors": colors, "normals": normals, "faces": faces, "edges": edges, "ptr": ptr, "viewpoint": viewpoint
        }  # fmt: skip
        self.preset = preset if isinstance(preset, SuperpointsConfig) else SuperpointsConfig.from_preset(preset)
        self._config = self.preset.replace(parameters)

    def __call__(self, sample: Sample) -> Sample:
        """A shallow copy of the sample with the labels; the copy shares the sample's tensors."""
        if (points := _get(sample, self.points)) is None:
            raise KeyError(f"{self.points}: expected the points of the sample under this name, got {_names(sample)}")
        to = self.to or ("superpoints_batch" if hasattr(sample, "__inc__") else "superpoints")
        if _get(sample, to) is not None:
            raise KeyError(f"{to}: expected a sample without this entry, got one with it; choose another name with to=")
        given = {name: _get(sample, key) for name, key in self.names.items() if key is not None}
        faces, key = given.get("faces"), self.names["faces"]
        if faces is not None and not isinstance(sample, Mapping) and faces.ndim == 2:
            given["faces"] = faces.T if faces.shape[1] != 3 or (key == "face" and len(faces) == 3) else faces
        labels = superpoints(points, **given, preset=self.preset, **self.parameters)
        if "batch" in to and hasattr(sample, "__inc__") and bool((labels < 0).any()):
            warnings.warn(f"{to}: in a batch, label -1 becomes one of the cloud before; leave it out", stacklevel=2)
        if isinstance(sample, Mapping):
            return type(sample)({**sample, to: labels})  # type: ignore[call-arg]
        changed = copy.copy(sample)
        setattr(changed, to, labels)
        return changed

    def __repr__(self) -> str:
        return f"AddSuperpoints(points={self.points!r}, to={self.to!r}, {self.config})"


def transfer_labels(
    labels: Tensor, from_points: Tensor, to_points: Tensor, max_distance: float | None = None
) -> Tensor:
    """Transfers labels to other points of the same scene: each point takes the label of the nearest labelled point.

    Of equally near points the one with the lowest index counts. Use it for clouds that were subsampled, voxelised or
    cropped, in either direction.

    Args:
        labels: [N] or [N, ...], any dtype, labels of `from_points`.
        from_points: [N, 3] metres, the labelled points, N >= 1.
        to_points: [M, 3] metres.
        max_distance: metres; a point farther than this from all labelled points gets -1. None: no limit.

    Returns:
        [M] or [M, ...], of the dtype of `labels`.

    Raises:
        ValueError, TypeError: naming the argument, what was expected and what came.

    Example:
        >>> import torch
        >>> here, there = torch.tensor([[0.0, 0, 0], [1, 0, 0]]), torch.tensor([[0.2, 0, 0], [0.9, 0, 0], [7, 0, 0]])
        >>> transfer_labels(torch.tensor([3, 4]), here, there, max_distance=0.5)
        tensor([ 3,  4, -1])
    """
    given = as_points(from_points, "from_points"), as_points(to_points, "to_points")
    source, target = (points.double() for points in given)
    check_dense(labels, "labels")
    if labels.ndim == 0 or len(labels) != len(source):
        raise ValueError(f"labels: expected one for each of {len(source)} from_points, got {list(labels.shape)}")
    if max_distance is not None and not (math.isfinite(max_distance) and max_distance >= 0):
        raise ValueError(f"max_distance: expected a number >= 0 or None, got {max_distance}")
    if max_distance is not None and not labels.dtype.is_signed:
        raise TypeError(f"labels: expected a dtype that has -1 (max_distance is given), got {labels.dtype}")
    if (same := distinct_points(source)) is not None:  # thousands of equal points would all be equally near
        labels, source = labels[first := first_places(same)], source[first]
    index, distance, spacing = _nearest(source.numpy(), target.numpy())
    for points in given:  # their largest coordinates tell to what they were rounded
        warn_of_rounding(points.abs().amax(0, keepdim=True), torch.from_numpy(spacing))
    result = labels[torch.from_numpy(index)]
    if max_distance is not None:
        result[torch.from_numpy(distance > max_distance)] = -1
    return result


def _nearest(source: Any, target: Any) -> tuple[Any, Any, Any]:
    """Index of the nearest source of each target, and the distance to it; of equally near ones the lowest index.

    And about the spacing of the sources: the distance to the second nearest, of at most a thousand targets.
    """
    tree = cKDTree(source, balanced_tree=False, compact_nodes=False)
    spacing = tree.query(target[:: 1 + len(target) // 1000], k=[2])[0][:, 0]
    nearest, distance = np.empty(len(target), dtype=np.int64), np.empty(len(target))
    open_, count = np.arange(len(target)), min(2, len(source))
    while len(open_):
        # If the last neighbour found is as near as the first, there may be more ties: query again for more neighbours.
        found, index = tree.query(target[open_], k=np.arange(1, count + 1), workers=num_threads())
        tied = found == found[:, :1]
        nearest[open_] = np.where(tied, index, len(source)).min(axis=1)
        distance[open_] = found[:, 0]
        open_, count = open_[tied[:, -1] & (count < len(source))], min(4 * count, len(source))
    return nearest, distance, spacing


def _get(sample: Any, name: str) -> Any:
    return sample.get(name) if isinstance(sample, Mapping) else getattr(sample, name, None)


def _names(sample: Any) -> str:
    own = getattr(sample, "__dict__", {})
    names = sample if isinstance(sample, Mapping) else getattr(sample, "to_dict", lambda: own)()  # torch_geometric's
    return f"{type(sample).__name__} with {', '.join(map(str, names))}"
