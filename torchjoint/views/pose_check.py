"""Check before step 4: are the poses and intrinsics plausible? Wrong ones are the most common error with new data."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.config import VisibilityConfig
from torchjoint.scene import Frame, Scene
from torchjoint.scene.subset import evenly_spaced_indices
from torchjoint.views.edge_alignment import EdgeAlignment, edge_alignment
from torchjoint.views.projection import project
from torchjoint.views.visibility import visible_points

#: Number of frames that are checked, evenly spread over the sequence.
NUM_FRAMES = 6

#: An edge alignment of less significance counts as chance. Correct poses of LiDARs have 2.6 and more.
CHANCE = 0.5


class PoseWarning(UserWarning):
    """The poses or intrinsics look wrong."""


class Agreement(NamedTuple):
    """Agreement of poses and cloud, mean over a few frames.

    Attributes:
        in_view: share of the cloud's points inside the frame, before the visibility test.
        depth_residual: median |z of visible points - depth image| / depth; NaN without depth.
        color_residual: mean |colour of visible points - image|, RGB in [0, 1]; NaN if the points have no colours.
    """

    in_view: float
    depth_residual: float
    color_residual: float

    def __str__(self) -> str:
        return (
            f"points in view {self.in_view:.1%}, depth residual {self.depth_residual:.1%}, "
            f"colour residual {self.color_residual:.2f}"
        )


def check_poses(
    scene: Scene, spacing: Tensor, config: VisibilityConfig, frames: Sequence[Frame] | None = None
) -> Agreement | None:
    """Compares a few frames with the cloud, and warns if the poses or intrinsics cannot be right.

    Args:
        scene: points and frames.
        spacing: [N] metres, spacing of the points.
        config: parameters of the visibility.
        frames: frames of the scene to check; default: :func:`frames_to_check`.

    Returns:
        the agreement at the given poses; None for a scene without frames.

    Warns:
        PoseWarning: one for each problem found.
    """
    if not len(scene.frames):
        return None
    if frames is None:
        frames = list(frames_to_check(scene).values())
    given, inverted = (
        _mean([_agreement(scene, spacing, frame, pose(frame), config) for frame in frames])
        for pose in (lambda frame: frame.world_to_camera, lambda frame: torch.linalg.inv(frame.world_to_camera))
    )
    off_center = max(_off_center(frame) for frame in frames)
    complaints = _complaints(given, inverted, off_center)
    if math.isnan(given.depth_residual) and math.isnan(given.color_residual):  # no other check finds small errors
        complaints += _edge_complaints(edge_alignment(scene, frames, spacing, config))
    for message in complaints:
        warnings.warn(f"{scene.name or 'scene'}: {message}", PoseWarning, stacklevel=3)
    return given


def frames_to_check(scene: Scene) -> dict[int, Frame]:
    """At most NUM_FRAMES frames of a scene, evenly spread: index -> frame."""
    return {index: scene.frames[index] for index in evenly_spaced_indices(len(scene.frames), NUM_FRAMES)}


def _agreement(scene: Scene, spacing: Tensor, frame: Frame, pose: Tensor, config: VisibilityConfig) -> Agreement:
    in_view = project(scene.points, frame.intrinsics, pose, frame.size).point.shape[0] / len(scene.points)
    visible = visible_points(scene.points, spacing, frame.intrinsics, pose, frame.size, config)
    depth_residual = color_residual = torch.nan
    if visible.z.numel() and frame.depth is not None:
        depth = frame.depth[visible.row, visible.column]
        known = depth > 0
        if known.any():
            depth_residual = ((visible.z - depth).abs() / depth)[known].median().item()
    if visible.z.numel() and scene.colors is not None:
        seen = frame.image[:, visible.row, visible.column].T
        color_residual = (scene.colors[visible.point] - seen).abs().mean().item()
    return Agreement(in_view, depth_residual, color_residual)


def _mean(rows: list[Agreement]) -> Agreement:
    return Agreement(*torch.tensor(rows, dtype=torch.float64).nanmean(dim=0).tolist())


def _off_center(frame: Frame) -> float:
    """Distance of the principal point from the image's centre, as a share of the image's size."""
    height, width = frame.size
    x, y = float(frame.intrinsics[0, 2]), float(frame.intrinsics[1, 2])
    return max(abs(x - (width - 1) / 2) / width, abs(y - (height - 1) / 2) / height)


def _edge_complaints(alignment: EdgeAlignment | None) -> list[str]:
    if alignment is None or alignment.significance >= CHANCE:
        return []
    return [
        "where the depth of the points jumps the images have edges no more than by chance (correlation "
        f"{alignment.correlation:.2f}, {alignment.significance:+.1f} standard deviations from that of shifted images; "
        "right poses have +2.6 and more): wrong extrinsics or intrinsics?"
    ]


def _complaints(given: Agreement, inverted: Agreement, off_center: float) -> list[str]:
    complaints = []
    # Comparisons with NaN are False, so a missing residual has no effect.
    depth_says = inverted.depth_residual < 0.05 and not given.depth_residual < 0.05
    color_says = inverted.color_residual < 0.7 * given.color_residual and not given.depth_residual < 0.05
    view_says = given.in_view * 5 < inverted.in_view and not inverted.depth_residual > 0.1
    if depth_says or color_says or view_says:
        complaints.append(
            "the poses look inverted: world_to_camera is expected, and these fit better as camera-to-world "
            f"(as given: {given}; if inverted: {inverted})"
        )
    elif given.in_view == 0:
        complaints.append("no point of the cloud is in view of the frames looked at: wrong poses, units or axes?")
    elif given.depth_residual > 0.1:
        complaints.append(
            f"the depth images and the cloud disagree by {given.depth_residual:.0%} (median): wrong poses, intrinsics "
            "or units?"
        )
    if off_center > 0.2:
        complaints.append(
            f"the principal point is {off_center:.0%} of the image's size off its centre: are the intrinsics those of "
            "another image size? (Scale them with the image.)"
        )
    return complaints
