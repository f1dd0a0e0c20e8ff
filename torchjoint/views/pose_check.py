"""Check before step 4: are the poses and intrinsics plausible? Wrong ones are the most common error with new data."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.cloud.local import LocalFrame
from torchjoint.config import VisibilityConfig
from torchjoint.runtime.threads import one_thread_per_operation, parallel_map
from torchjoint.scene import Cloud, Frame, Scene
from torchjoint.scene.pose_warning import CONVENTIONS, PoseDoubt, PoseWarning
from torchjoint.scene.subset import evenly_spaced_indices
from torchjoint.views.color_agreement import color_agreement
from torchjoint.views.edge_alignment import EdgeAlignment, combined, edge_correlations
from torchjoint.views.projection import project
from torchjoint.views.visibility import visible_points

#: Number of frames that are checked, evenly spread over the sequence.
NUM_FRAMES = 6

#: Numbers of the frames that are checked if frames come one by one, because their total number is unknown.
CHECKED = (0, 1, 3, 7, 15, 31)

#: An edge alignment with a lower significance counts as chance. Correct poses of LiDARs have 2.6 or more.
CHANCE = 0.5

#: Poses are wrong if depth images and cloud differ by more than this. On 34 generated scenes with depth, right poses
#: have at most .027; poses in reversed order have .1 or more.
LARGEST_DEPTH_RESIDUAL = 0.04

#: This share of the frames must agree, because an object without points may hide the cloud from one camera.
AGREEING_SHARE = 0.75

#: Colours fit no better than chance if their residual is more than the first number times the residual in shifted
#: images, and their correlation is below the second. On the same scenes right poses have at most .62 and at least .80;
#: poses in reversed order, or half a metre off, have at least .84 and at most .59. If even the residual in shifted
#: images is below the third number, the scene has too little contrast to judge.
CHANCE_SHARE, CHANCE_CORRELATION, LEAST_CONTRAST = 0.8, 0.6, 0.03


class Agreement(NamedTuple):
    """Agreement of poses and cloud for one frame, or for several: their mean, for depth the AGREEING_SHARE quantile.

    Attributes:
        in_view: share of the cloud's points inside the frame, before the visibility test.
        depth_residual: median |z of visible points - depth image| / depth; NaN without depth.
        color_residual: mean |colour of visible points - image|, RGB in [0, 1]; NaN if the points have no colours.
        color_by_chance: the same in shifted images.
        color_correlation: correlation of the two colours, -1 to 1.
    """

    in_view: float
    depth_residual: float = math.nan
    color_residual: float = math.nan
    color_by_chance: float = math.nan
    color_correlation: float = math.nan

    def __str__(self) -> str:
        return (
            f"points in view {self.in_view:.1%}, depth residual {self.depth_residual:.1%}, "
            f"colour residual {self.color_residual:.2f}"
        )


class _Look(NamedTuple):
    """The result of the comparison of one frame."""

    given: Agreement
    others: dict[str, Agreement]  #: with the poses read as in CONVENTIONS
    off_center: float
    edges: Tensor | None


class PoseCheck:
    """Compares frames with the cloud, and warns if the poses or intrinsics look wrong.

    Args:
        cloud: points and colours, in the coordinates of `local`.
        spacing: [N] metres, spacing of the points.
        config: parameters of the visibility.
        local: the coordinates of the cloud; the poses of frames are world to camera.
        name: name of the scene, for messages.
    """

    def __init__(
        self, cloud: Cloud, spacing: Tensor, config: VisibilityConfig, local: LocalFrame, name: str = ""
    ) -> None:
        self._cloud, self._spacing, self._config, self._local = cloud, spacing, config, local
        self._name = name or "scene"
        self._looks: list[_Look] = []
        self._said: set[str] = set()
        self._seen = 0

    def look_at(self, frames: Iterable[Frame]) -> None:
        """Compares these frames."""
        with one_thread_per_operation():
            self._looks += parallel_map(self._look, frames)

    def look_as_they_come(self, frames: Sequence[Frame]) -> None:
        """Compares some of the frames of a stream, and warns as soon as there are NUM_FRAMES of them."""
        chosen = [frame for number, frame in enumerate(frames, self._seen) if number in CHECKED]
        self._seen += len(frames)
        if chosen:
            self.look_at(chosen)
            if len(self._looks) >= NUM_FRAMES:
                self.warn()

    def warn(self) -> Agreement | None:
        """Warns of each problem once; returns the agreement at the given poses, None if no frame was compared.

        Warns:
            PoseWarning: one for each problem found.
        """
        if not self._looks:
            return None
        given = _combined([look.given for look in self._looks])
        others = {kind: _combined([look.others[kind] for look in self._looks]) for kind in CONVENTIONS}
        found = _complaints(given, others, max(look.off_center for look in self._looks))
        with one_thread_per_operation():
            found |= _edge_complaints(combined([look.edges for look in self._looks if look.edges is not None]))
        for kind, message in found.items():
            if kind not in self._said:
                self._said.add(kind)
                category = PoseDoubt if kind in ("edges", "off center") else PoseWarning
                warnings.warn(f"{self._name}: {message}", category, stacklevel=4)
        return given

    def _look(self, frame: Frame) -> _Look:
        pose, inverse = frame.world_to_camera, torch.linalg.inv(frame.world_to_camera)
        turn = torch.tensor([1.0, -1, -1, 1], dtype=pose.dtype)[:, None]  # from OpenGL's axes to OpenCV's
        given, *others = (
            _agreement(self._cloud, self._spacing, frame, self._local.pose(one), self._config)
            for one in (pose, inverse, turn * pose, turn * inverse)
        )
        edges = None
        if math.isnan(given.depth_residual) and math.isnan(given.color_residual):  # no other check finds small errors
            local = replace(frame, world_to_camera=self._local.pose(frame.world_to_camera))
            edges = edge_correlations(self._cloud, local, self._spacing, self._config)
        return _Look(given, dict(zip(CONVENTIONS, others, strict=True)), _off_center(frame), edges)


def frames_to_check(scene: Scene) -> dict[int, Frame]:
    """At most NUM_FRAMES frames of a scene, evenly spread, by index."""
    return {index: scene.frames[index] for index in evenly_spaced_indices(len(scene.frames), NUM_FRAMES)}


def _agreement(cloud: Cloud, spacing: Tensor, frame: Frame, pose: Tensor, config: VisibilityConfig) -> Agreement:
    in_view = project(cloud.points, frame.intrinsics, pose, frame.size).point.shape[0] / len(cloud.points)
    visible = visible_points(cloud.points, spacing, frame.intrinsics, pose, frame.size, config)
    if not visible.z.numel():
        return Agreement(in_view)
    depth_residual = torch.nan
    if frame.depth is not None:
        depth = frame.depth[visible.row, visible.column]
        known = depth > 0
        if known.any():
            depth_residual = ((visible.z - depth).abs() / depth)[known].median().item()
    if cloud.colors is None:
        return Agreement(in_view, depth_residual)
    return Agreement(
        in_view, depth_residual, *color_agreement(cloud.colors[visible.point], frame.image, visible.row, visible.column)
    )


def _combined(rows: list[Agreement]) -> Agreement:
    numbers = torch.tensor(rows, dtype=torch.float64)
    depth = torch.tensor([row.depth_residual for row in rows], dtype=torch.float64).nanquantile(AGREEING_SHARE)
    return Agreement(*numbers.nanmean(dim=0).tolist())._replace(depth_residual=float(depth))


def _off_center(frame: Frame) -> float:
    """Distance of the principal point from the image's centre, as a share of the image's size."""
    height, width = frame.size
    x, y = float(frame.intrinsics[0, 2]), float(frame.intrinsics[1, 2])
    return max(abs(x - (width - 1) / 2) / width, abs(y - (height - 1) / 2) / height)


def _edge_complaints(alignment: EdgeAlignment | None) -> dict[str, str]:
    if alignment is None or alignment.significance >= CHANCE:
        return {}
    return {
        "edges": "image edges coincide with depth jumps of the points no more than by chance (correlation "
        f"{alignment.correlation:.2f}, {alignment.significance:+.1f} standard deviations from that of shifted images; "
        "right poses have +2.6 and more): wrong extrinsics or intrinsics?"
    }


def _fits_better(given: Agreement, other: Agreement, kind: str) -> bool:
    # Comparisons with NaN are False, so a missing residual has no effect.
    depth_says = other.depth_residual < 0.05 and not given.depth_residual < 0.05
    color_says = other.color_residual < 0.7 * given.color_residual and not given.depth_residual < 0.05
    # More points in view alone say nothing of the axes, because a scene may lie behind a camera, too.
    is_likely = kind == "inverted" or other.color_correlation > CHANCE_CORRELATION
    view_says = is_likely and given.in_view * 5 < other.in_view and not other.depth_residual > 0.1
    return depth_says or color_says or view_says


def _residuals(agreement: Agreement) -> tuple[float, float]:
    """Of depth and colour; what is not known comes last."""
    depth, color = (
        math.inf if math.isnan(value) else value for value in (agreement.depth_residual, agreement.color_residual)
    )
    return depth, color


def _complaints(given: Agreement, others: dict[str, Agreement], off_center: float) -> dict[str, str]:
    """The problems that were found: kind -> message."""
    complaints = {}
    better = [kind for kind, other in others.items() if _fits_better(given, other, kind)]
    if better:
        found = min(better, key=lambda kind: _residuals(others[kind]))
        complaints["convention"] = (
            f"the poses look {CONVENTIONS[found]} (as given: {given}; read like this: {others[found]})"
        )
    elif given.in_view == 0:
        complaints["view"] = "no point of the cloud is in view of the checked frames: wrong poses, units or axes?"
    elif given.depth_residual > LARGEST_DEPTH_RESIDUAL:
        complaints["depth"] = (
            f"the depth images and the cloud disagree by {given.depth_residual:.1%} (median): wrong poses, intrinsics "
            "or units?"
        )
    elif (
        given.color_by_chance > LEAST_CONTRAST
        and given.color_residual > CHANCE_SHARE * given.color_by_chance
        and given.color_correlation < CHANCE_CORRELATION
    ):
        complaints["color"] = (
            "the colours of the points and of the images agree no more than by chance (they differ by "
            f"{given.color_residual:.2f}, and by {given.color_by_chance:.2f} in shifted images): wrong poses, or poses "
            "of other images?"
        )
    if off_center > 0.2:
        complaints["off center"] = (
            f"the principal point is {off_center:.0%} of the image's size off its centre: are the intrinsics those of "
            "another image size? (Scale them with the image.)"
        )
    return complaints
