"""Pictures of clouds, the colours of labels, and how bright a point is drawn (output after step 8)."""

import math

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.cloud.normals import estimate_normals
from torchjoint.config import VisibilityConfig
from torchjoint.results.edits import Table
from torchjoint.results.objects import level_axes
from torchjoint.results.upright import fitted, up_direction
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene import Scene
from torchjoint.views.visibility import visible_points

NONE_COLOR = 0.12
#: Field of view of the pictures: focal length in image widths.
FOCAL = 1.15
#: A point is drawn as a square of at most 2 LARGEST + 1 pixels.
LARGEST = 6
#: Numbers of neighbours: of a normal, and of those whose label may differ at an edge.
NORMAL, EDGE = 20, 6
#: Direction of the light, along two level axes and up: walls and floors of a room get three different shades.
LIGHT = (0.35, 0.55, 0.76)
#: Brightness of a point that the light only grazes, and of an edge.
GRAZED, DARK = 0.55, 0.55


def label_colors(labels: Tensor, num_point_segments: int | None = None) -> Tensor:
    """A colour for each label; an id has the same colour in every picture and cloud.

    Args:
        labels: [...] int64, -1 = none (dark grey).
        num_point_segments: ids >= this number have no 3D segment and get pale colours; None: no pale colours.

    Returns:
        [..., 3] float32 RGB in [0, 1].
    """
    num_colors = max(int(labels.max()), -1) + 2 if labels.numel() else 0
    if labels.numel() > num_colors:  # an image: a table is faster
        return label_colors(torch.arange(-1, num_colors - 1), num_point_segments)[labels.clamp(min=-1) + 1]
    from matplotlib.colors import hsv_to_rgb

    ids = labels.clamp(min=0).double().numpy()
    # Hues advance by the golden ratio: consecutive ids get clearly different colours.
    hue = np.mod(0.07 + ids * 0.6180339887498949, 1.0)
    saturation = 0.45 + 0.5 * np.mod(ids * 0.7548776662466927, 1.0)
    value = 0.6 + 0.4 * np.mod(ids * 0.5698402909980532, 1.0)
    if num_point_segments is not None:
        pale = labels.numpy() >= num_point_segments
        saturation, value = np.where(pale, 0.15, saturation), np.where(pale, 0.35 + 0.3 * value, value)
    colors = torch.from_numpy(hsv_to_rgb(np.stack([hue, saturation, value], axis=-1))).float()
    return torch.where(labels[..., None] < 0, NONE_COLOR, colors)


@on_cpu()
def render_cloud(scene: Scene, colors: Tensor, size: tuple[int, int] = (480, 640)) -> Tensor:
    """Renders the whole cloud, upright, from behind and above the cameras.

    Args:
        scene: the points; the frames determine the view.
        colors: [N, 3] RGB in [0, 1]; for k pictures of one view: [N, 3 k].
        size: (H, W) of the picture, pixels.

    Returns:
        [H, W, 3] or [H, W, 3 k] RGB in [0, 1], white where there is no point.
    """
    height, width = size
    focal = FOCAL * width
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float64)
    spacing = nearest_neighbors(scene.points, 4).spacing.clamp(min=1e-6)
    view = fitted(scene, up_direction(scene).numpy(), 2 * math.atan(height / 2 / focal), width / height)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3] = torch.from_numpy(np.column_stack([view.axes, -view.axes @ view.position]))
    seen = visible_points(scene.points, spacing, intrinsics, pose, size, VisibilityConfig(footprint=1.0))
    # Draw each point as a square of its own spacing, near points over far points.
    far_first = torch.argsort(seen.z, descending=True, stable=True)
    radius = (0.9 * spacing[seen.point] * focal / seen.z).round().clamp(0, LARGEST).long()[far_first]
    row, column, paint = seen.row[far_first], seen.column[far_first], colors[seen.point[far_first]]
    picture, depth = torch.ones(height * width, colors.shape[1], dtype=torch.float32), torch.full((height * width,), -1)
    order = torch.arange(len(far_first))
    for down in range(-LARGEST, LARGEST + 1):
        for right in range(-LARGEST, LARGEST + 1):
            y, x, is_in = row + down, column + right, radius >= max(abs(down), abs(right))
            here = is_in & (y >= 0) & (y < height) & (x >= 0) & (x < width)
            depth.scatter_reduce_(0, (y * width + x)[here], order[here], "amax")
    drawn = depth >= 0
    picture[drawn] = paint[depth[drawn]]
    return picture.view(height, width, -1)


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
        self._near, self._known = near[:, :EDGE], (np.empty(0, dtype=np.int64), self.light)

    def of(self, labels: Table) -> npt.NDArray[np.float32]:
        """[N] the brightness of each point, 0 to 1; `labels`: [N], edges are where they change."""
        known, shades = self._known  # at once: threads share them
        if not np.array_equal(labels, known):  # a click does not change them
            shades = np.where((labels[self._near] != labels[:, None]).any(1), DARK * self.light, self.light)
            self._known = labels, shades
        return shades
