"""Poses of a trajectory at other times: interpolated between the pose before and the pose after."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.cameras import rotations_from_quaternions


def interpolate_poses(
    rows: npt.NDArray[np.float64], wanted: npt.NDArray[np.float64], tolerance: float, name: str
) -> list[Tensor | None]:
    """Interpolates poses at the wanted times: rotations spherically, positions linearly.

    Args:
        rows: [P, 8] time tx ty tz qx qy qz qw: seconds, ascending, each time once; metres; a unit quaternion.
        wanted: [T] seconds.
        tolerance: a pose is used if it is at most this many seconds from the wanted time.
        name: used in messages.

    Returns:
        T poses [4, 4] float64, with the direction of the rows (such as camera-to-world); None where no pose is near
            enough in time.

    Raises:
        ValueError: a quaternion's length is not 1.
    """
    from scipy.spatial.transform import Slerp

    rotations = rotations_from_quaternions(rows[:, 4:], name)
    if len(rows) == 1:  # duplicates a single pose, so that Slerp has two
        rows, rotations = np.concatenate([rows, rows + np.eye(8)[:1]]), rotations[[0, 0]]
    times = rows[:, 0]
    within = wanted.clip(times[0], times[-1])
    after = np.searchsorted(times, within).clip(1, len(times) - 1)
    nearest = np.minimum(abs(wanted - times[after - 1]), abs(wanted - times[after]))
    poses = np.tile(np.eye(4), (len(wanted), 1, 1))
    poses[:, :3, :3] = Slerp(times, rotations)(within).as_matrix()
    poses[:, :3, 3] = np.stack([np.interp(within, times, rows[:, axis]) for axis in (1, 2, 3)], axis=1)
    return [torch.from_numpy(pose) if gap <= tolerance else None for pose, gap in zip(poses, nearest, strict=True)]
