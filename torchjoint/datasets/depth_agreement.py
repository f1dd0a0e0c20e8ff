"""Checks before a cloud is fused from depth: do the depth images agree with one another at the given poses?"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import torch
from torch import Tensor

from torchjoint.datasets.cameras import FLIP_YZ
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Frame
from torchjoint.scene.frame import CONVENTIONS, PoseWarning
from torchjoint.scene.scene import evenly_spaced_indices

#: Number of pairs of frames that are compared, and the farthest partner of a frame, as a share of the sequence.
PAIRS, REACH = 6, 0.1
#: Cameras of a pair turned at least by this angle, degrees, or moved by this length, metres: else any pose fits.
LEAST_TURN, LEAST_STEP = 5.0, 0.1
#: The poses fit if the depths differ by less than the first number (median, relative; right poses of the kitchen and of
#: generated rooms have .006, wrong ones .066 and more). Another convention fits if it has less than the given poses'
#: difference times the second.
AGREEING, BETTER = 0.04, 0.3
#: Fewest pixels that two images must share.
LEAST_SHARED = 100
#: About this number of pixels of an image are compared.
SAMPLED = 5000


@one_thread_per_operation()
def warn_of_poses(frames: Sequence[Frame]) -> None:
    """Compares the depth images of some pairs of frames, at the given poses and at the poses read otherwise.

    Warns:
        PoseWarning: the poses do not fit, and another convention does.
    """
    residuals = [_residuals(one, other) for one, other in _pairs(frames)]
    if not residuals:
        return
    given, *others = torch.tensor(residuals, dtype=torch.float64).nan_to_num(math.inf).median(dim=0).values.tolist()
    best, kind = min(zip(others, CONVENTIONS, strict=True))
    if given > AGREEING and best < min(AGREEING, BETTER * given):
        said = f"differ by {given:.1%}" if math.isfinite(given) else "have nothing in common"
        warnings.warn(
            f"the poses look {CONVENTIONS[kind]} (depth images of neighbouring frames {said} as given, by {best:.1%} "
            "read like this)",
            PoseWarning,
            stacklevel=2,
        )


def _pairs(frames: Sequence[Frame]) -> list[tuple[Frame, Frame]]:
    """Frames with depth, each with the first of the following frames whose camera has moved enough."""
    found, count = [], len(frames)
    farthest = max(1, round(REACH * count))
    for index in evenly_spaced_indices(count - 1, PAIRS) if count > 1 else ():
        one = frames[index]
        if one.depth is None:
            continue
        for other in (frames[partner] for partner in range(index + 1, min(count, index + 1 + farthest))):
            if other.depth is not None and _has_moved(one.world_to_camera, other.world_to_camera):
                found.append((one, other))
                break
    return found


def _has_moved(one: Tensor, other: Tensor) -> bool:
    motion = other @ torch.linalg.inv(one)
    turn = math.degrees(math.acos(max(-1.0, min(1.0, (float(motion[:3, :3].trace()) - 1) / 2))))
    return turn >= LEAST_TURN or float(motion[:3, 3].norm()) >= LEAST_STEP


def _residuals(one: Frame, other: Frame) -> list[float]:
    """The median relative difference of the depths: at the given poses, and for each of CONVENTIONS; NaN: unknown."""
    motion, inverse = (
        second @ torch.linalg.inv(first)
        for first, second in (
            (one.world_to_camera, other.world_to_camera),
            (torch.linalg.inv(one.world_to_camera), torch.linalg.inv(other.world_to_camera)),
        )
    )
    tried = (motion, inverse, FLIP_YZ @ motion @ FLIP_YZ, FLIP_YZ @ inverse @ FLIP_YZ)
    return [_residual(one, other, each) for each in tried]


def _residual(one: Frame, other: Frame, motion: Tensor) -> float:
    """The same for one motion [4, 4] from the camera of the first frame to that of the second."""
    depths, there = one.depth, other.depth
    assert depths is not None  # as _pairs chooses them
    assert there is not None
    step = max(1, math.isqrt(depths.numel() // SAMPLED))
    row, column = torch.nonzero(depths[::step, ::step] > 0, as_tuple=True)
    depth = depths[row * step, column * step].double()
    rays = torch.stack([column * step, row * step, torch.ones_like(row)]).double()
    points = torch.linalg.inv(one.intrinsics) @ rays * depth
    x, y, z = other.intrinsics @ (motion[:3, :3] @ points + motion[:3, 3:])
    z = torch.where(z > 0, z, torch.nan)
    u, v = (x / z).round(), (y / z).round()
    height, width = other.size
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)  # False for NaN
    seen = there[v[inside].long(), u[inside].long()].double()
    known = seen > 0
    if int(known.sum()) < LEAST_SHARED:
        return math.nan
    return float(((z[inside] - seen).abs() / seen)[known].median())
