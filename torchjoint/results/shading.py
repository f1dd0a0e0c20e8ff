"""How bright each point is drawn: lit by its normal, and dark at the edges of its segment (output after step 8)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.cloud.normals import estimate_normals
from torchjoint.results.edits import Table
from torchjoint.results.objects import level_axes

#: Numbers of neighbours: of a normal, and of those whose label may differ at an edge.
NORMAL, EDGE = 20, 6
#: Direction of the light, along two level axes and up: walls and floors of a room get three different shades.
LIGHT = (0.35, 0.55, 0.76)
#: Brightness of a point that the light only grazes, and of an edge.
GRAZED, DARK = 0.55, 0.55


class Shading:
    """The shades of a cloud; its surfaces are two-sided, because the signs of the normals are arbitrary.

    Args:
        points: [N, 3] metres.
        up: [3] upward direction, unit length.

    Attributes:
        light: [N] brightness of each point without edges, 0 to 1.
    """

    def __init__(self, points: Tensor, up: npt.NDArray[np.float64]) -> None:
        indices = nearest_neighbors(points, NORMAL).indices
        light = torch.from_numpy(np.array(LIGHT) @ np.concatenate([level_axes(up), up[None]])).float()
        lit = (estimate_normals(points, indices) @ light).abs().numpy()
        near = indices.numpy()
        lit = sum((lit[column] for column in near.T), lit) / (1 + near.shape[1])  # else noise would be speckles
        self.light = (GRAZED + (1 - GRAZED) * lit).astype(np.float32)
        self._near, self._labels = near[:, :EDGE], np.empty(0, dtype=np.int64)

    def of(self, labels: Table) -> npt.NDArray[np.float32]:
        """[N] the brightness of each point, 0 to 1; `labels`: [N], edges are where they change."""
        if not np.array_equal(labels, self._labels):  # a click does not change them
            self._labels, is_edge = labels, (labels[self._near] != labels[:, None]).any(1)
            self._shades = np.where(is_edge, DARK * self.light, self.light)
        return self._shades
