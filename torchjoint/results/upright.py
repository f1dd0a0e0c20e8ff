"""The upward direction of a scene, from the poses and the large planes of the cloud, and views of it (after step 8)."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.cloud.normals import estimate_normals
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Scene

Array = npt.NDArray[np.float64]
#: Number of points that are used, evenly selected: enough to find a floor.
SAMPLED = 20_000
#: A plane is searched within so many degrees of the poses' upward direction if the cameras turned: the poses determine
#: it well. If all cameras look one way, it is wrong by their downward tilt, and the limit is wide.
SEARCH_ANGLE, WIDE_SEARCH_ANGLE = 20.0, 55.0
#: The normals of a plane's points differ from the plane's normal by at most this angle, degrees.
FLAT = 8.0
#: A plane counts if it has at least this share of the points.
SMALLEST_SHARE = 0.03
#: Share of the points that may lie beyond each edge of a view, and its distance in that from which the others just fit.
LEFT_OUT, MARGIN = 0.0005, 1.08
#: Far from a scanner is little: an edge is at most so many times as far from the median as this share of the points.
THIN, TIMES = 0.05, 2.0


@one_thread_per_operation()
def up_direction(scene: Scene) -> Tensor:
    """Estimates the direction against gravity, in the world frame of the scene.

    It is the scene's own, if it has one, and +z without frames: the ground of a survey may slope. Most cameras are held
    upright, so their x axes are level. This gives a first direction; the normal of the largest plane near it, such as a
    floor or a table, makes it exact.

    Returns:
        [3] float64, unit length; the same for the same scene.
    """
    if scene.up is not None:
        return scene.up
    if not len(scene.frames):
        return torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    up, angle = _of_poses(scene)
    sample = scene.points[:: -(-len(scene.points) // SAMPLED)]
    found = _largest_plane(estimate_normals(sample, nearest_neighbors(sample, 12).indices).double(), up, angle)
    return up if found is None else found


def _of_poses(scene: Scene) -> tuple[Tensor, float]:
    """The upward direction according to the poses, and its largest error in degrees."""
    rotations = _rotations(scene, 32)
    sideways, mean = rotations[:, 0], -rotations[:, 1].mean(0)
    # One direction is across all x axes if the cameras turned, else several are: the mean of the -y axes decides.
    values, vectors = torch.linalg.eigh(sideways.T @ sideways / len(rotations) - 0.05 * torch.outer(mean, mean))
    up = vectors[:, 0]
    side = float(up @ mean)
    if abs(side) < 1e-6:  # cameras that were rolled in all directions
        side = float(up[up.abs().argmax()])
    return (up if side > 0 else -up), SEARCH_ANGLE if float(values[1]) > 0.05 else WIDE_SEARCH_ANGLE


def _rotations(scene: Scene, most: int) -> Tensor:
    """The rotations [F, 3, 3] of at most so many frames, evenly selected, F >= 1."""
    chosen = torch.linspace(0, len(scene.frames) - 1, min(most, len(scene.frames)), dtype=torch.float32).long().tolist()
    return torch.stack([scene.frames[i].world_to_camera[:3, :3] for i in chosen])


def _largest_plane(normals: Tensor, up: Tensor, angle: float) -> Tensor | None:
    """The most common of normals, of any sign, within an angle of `up`; None if too few points share it.

    Level planes count more.
    """
    steep = normals @ up
    normals = torch.where(steep[:, None] < 0, -normals, normals)
    near = normals[steep.abs() > math.cos(math.radians(angle))]
    if not len(near):
        return None
    candidates = near[:: -(-len(near) // 500)]
    flat = math.cos(math.radians(FLAT))
    best = candidates[int(((candidates @ near.T > flat).sum(1) * (candidates @ up).square()).argmax())]
    for _ in range(3):
        best = torch.nn.functional.normalize(near[near @ best > flat].mean(0), dim=0)
    return best if int((near @ best > flat).sum()) >= SMALLEST_SHARE * len(normals) else None


class View(NamedTuple):
    """A place from which a cloud is seen."""

    position: Array  #: [3] metres
    target: Array  #: [3] metres, in the middle of what is seen
    axes: Array  #: [3, 3], one a row: to the right, down, forward


def fitted(scene: Scene, up: Array, fov: float, aspect: float) -> View:
    """A view of the whole cloud, from above, looking where the cameras look; in portrait along its longer side.

    Args:
        scene: the cloud and its cameras.
        up: [3] upward direction, unit length.
        fov: vertical field of view, radians.
        aspect: width / height of the picture.
    """
    points = scene.points[:: -(-len(scene.points) // SAMPLED)].double().numpy()
    center, forward = np.median(points, axis=0), _forward(scene, up, points, aspect)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    axes = np.stack([right, np.cross(forward, right), forward])
    at = (points - center) @ axes.T
    slope = np.tan(fov / 2) * np.array([aspect, 1])
    sides = np.array([1, -1]) * at[:, :2, None] + (slope * at[:, 2:])[:, :, None]
    least, low, middle = np.quantile(sides, [LEFT_OUT, THIN, 0.5], axis=0)
    # The left, the right, the upper and the lower edge of the picture pass by these places.
    low, high = (np.maximum(least, middle - TIMES * (middle - low)) * [1, -1]).T
    distance = max(float(((high - low) / slope).max()) / 2, 1e-6)
    target = center + (low + high) / 2 @ axes[:2]
    return View(target - MARGIN * distance * forward, target, axes)


def _forward(scene: Scene, up: Array, points: Array, aspect: float) -> Array:
    """The direction [3] of a view from above, in the mean viewing direction of the cameras; unit length.

    If there is none, or in portrait, a long cloud lies as the picture does, and is seen from higher, past its walls.
    """
    forward = _rotations(scene, 16)[:, 2].mean(0).numpy() if len(scene.frames) else np.zeros(3)
    forward = forward - up * (forward @ up)
    is_free, is_tall = np.linalg.norm(forward) < 0.3, aspect < 0.8
    if is_free:  # cameras that look down, or around, as in a room with four walls
        forward = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    forward, right = (one / np.linalg.norm(one) for one in (forward, np.cross(forward, up)))
    low, high = np.quantile(points @ np.stack([right, forward]).T, [0.01, 0.99], axis=0)
    if (is_free or is_tall) and np.diff(high - low)[0] * (1 - 2 * is_tall) > 0.2 * (high - low).min():
        forward = right
    forward = forward - (2.0 if is_tall else 1.4 if is_free else 0.7) * up
    return np.asarray(forward / np.linalg.norm(forward))
