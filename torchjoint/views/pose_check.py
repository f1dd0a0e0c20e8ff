"""Check before step 4: are the poses and intrinsics plausible? Wrong ones are the most common error with new data."""

import math
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import adaptive_max_pool2d, max_pool2d

from torchjoint.cloud.local import LocalFrame
from torchjoint.config import VisibilityConfig
from torchjoint.images.boundary import GradientBoundary
from torchjoint.images.contours import smooth
from torchjoint.runtime.threads import one_thread_per_operation, parallel_map
from torchjoint.scene import Cloud, Frame, Scene
from torchjoint.scene.frame import CONVENTIONS, PoseDoubt, PoseWarning
from torchjoint.scene.masks import Masks
from torchjoint.scene.scene import evenly_spaced_indices
from torchjoint.views.visibility import Projection, nearest_pixel, project, visible_points

#: Shifts in twelve directions, as shares of the image's longer side.
COLOR_SHIFTS = [
    (radius * math.sin(math.pi * step / 6), radius * math.cos(math.pi * step / 6))
    for step, radius in enumerate((0.05, 0.07, 0.09, 0.11) * 3)
]

#: Smallest number of points to compare.
LEAST_POINTS = 30
#: If there are more points, every k-th is compared. The mean of 10,000 colours errs by a hundredth of their spread.
MOST_POINTS = 10_000


class ColorAgreement(NamedTuple):
    """Colours of points against those of an image; all NaN if too few points are in view."""

    residual: float = math.nan  #: mean |colour of a point - colour of its pixel|
    by_chance: float = math.nan  #: the same in shifted images
    correlation: float = math.nan  #: correlation of the two colours, -1 to 1
    exchanged: float = math.nan  #: the same with red and blue of the image exchanged


def color_agreement(colors: Tensor, image: Tensor, row: Tensor, column: Tensor) -> ColorAgreement:
    """Compares the colours of M visible points with the colours of their pixels.

    Args:
        colors: [M, 3] RGB in [0, 1].
        image: [3, H, W] RGB in [0, 1].
        row: [M] int64, row of each point's pixel.
        column: [M] int64, column of this pixel.
    """
    if len(colors) < LEAST_POINTS:
        return ColorAgreement()
    step = math.ceil(len(colors) / MOST_POINTS)
    colors, row, column = colors[::step], row[::step], column[::step]
    height, width = image.shape[1:]
    seen = image[:, row, column].T
    shifted = []
    for down, right in COLOR_SHIFTS:
        there = row + round(down * max(height, width)), column + round(right * max(height, width))
        inside = (there[0] >= 0) & (there[0] < height) & (there[1] >= 0) & (there[1] < width)
        if int(inside.sum()) >= LEAST_POINTS:
            shifted.append(float((colors[inside] - image[:, there[0][inside], there[1][inside]].T).abs().mean()))
    by_chance = sum(shifted) / len(shifted) if shifted else math.nan
    same, exchanged = (float(correlation(colors.double(), one.double())) for one in (seen, seen.flip(1)))
    return ColorAgreement(float((colors - seen).abs().mean()), by_chance, same, exchanged)


def correlation(first: Tensor, second: Tensor) -> Tensor:
    """The correlation of two tensors of one shape, each without the mean of its columns; 0 if one is constant."""
    first, second = first - first.mean(0), second - second.mean(0)
    size = (first.square().sum() * second.square().sum()).sqrt()
    return (first * second).sum() / size if float(size) > torch.finfo(torch.float32).tiny else size.new_zeros(())


#: Longer side of the resized image, pixels; the other lengths in this file are pixels of the resized image.
SIDE = 640

#: Standard deviations of the Gaussian that blurs the edges (about the error of a calibration), and of their local mean.
BLUR, SURROUNDINGS = 2.5, 10.0

#: Number of neighbours of a point, and their largest distance: the gap between two beams of a coarse LiDAR.
NEIGHBORS, REACH = 6, 16.0

#: Change of log depth from which a jump counts, and the further change until it counts fully.
SMALLEST_JUMP, JUMP_RANGE = 0.05, 0.2

#: Smallest sum of jumps in view for a verdict, and largest number of points whose neighbours are searched.
MIN_JUMPS, MAX_QUERIES = 800.0, 20_000

#: Smallest standard deviation of the edge strength (0 to 1) in an image that is not blank.
MIN_CONTRAST = 0.01

#: Smallest share of the points in view that is visible if the cloud is one scan.
MIN_VISIBLE = 0.95

#: Shifts (down, right) of the image for comparison: in all directions, and so far that shifted edges do not overlap.
EDGE_SHIFTS = [
    (round(radius * math.sin(angle)), round(radius * math.cos(angle)))
    for ring, radius in enumerate((30, 45, 60, 75))
    for angle in (math.pi / 6 * (step + ring / 4) for step in range(12))
]


class EdgeAlignment(NamedTuple):
    """Agreement of depth edges and image edges, mean over the frames.

    Attributes:
        correlation: correlation of depth jumps and image edges at the given pose, -1 to 1; of masks: mean strength.
        significance: (correlation - its mean with shifted images) / standard deviation of the latter.
        deviation: this standard deviation.
    """

    correlation: float
    significance: float
    deviation: float


def combined(correlations: Sequence[Tensor]) -> EdgeAlignment | None:
    """The alignment of several frames, from the :func:`edge_correlations` of each; None: no frame has a verdict."""
    if not correlations:
        return None
    given, *shifted = torch.stack(list(correlations)).mean(dim=0)
    deviation, mean = torch.std_mean(torch.stack(shifted))
    return EdgeAlignment(float(given), float((given - mean) / deviation.clamp(min=1e-9)), float(deviation))


def edge_correlations(cloud: Cloud, frame: Frame, spacing: Tensor, config: VisibilityConfig) -> Tensor | None:
    """Correlations of depth edges and image edges, for a cloud from about one position, such as a LiDAR scan.

    Args:
        cloud: the points.
        frame: a frame, with the pose to check.
        spacing: [N] metres, spacing of the points.
        config: parameters of the visibility.

    Returns:
        [1 + number of EDGE_SHIFTS] float64, the first without shift. None if no verdict is possible: the cloud is not a
        scan, too few depth jumps are in view, or the image is blank.
    """
    projection = project(cloud.points, frame.intrinsics, frame.world_to_camera, frame.size)
    if len(projection.point) <= NEIGHBORS or not _is_scan(cloud, frame, spacing, config, projection):
        return None
    edges, scale = _image_edges(frame.image)
    return None if edges is None else _under_shifts(edges, *_depth_jumps(projection, scale))


def border_strengths(segments: Tensor, image: Tensor) -> Tensor | None:
    """Mean strength of image edges at the borders of segments [H, W], without shift and under EDGE_SHIFTS.

    Returns:
        [1 + number of EDGE_SHIFTS] float64; None: too few borders, or the image is blank.
    """
    edges, _ = _image_edges(image)
    if edges is None:
        return None
    around = segments.float()[None]
    differs = max_pool2d(around, 3, 1, 1) != -max_pool2d(-around, 3, 1, 1)
    border = adaptive_max_pool2d(differs.float(), [side // 2 for side in edges.shape])[0]  # of every second pixel
    row, column = 2 * torch.nonzero(border).T + 1
    return _under_shifts(edges, row, column, torch.ones_like(row), lambda strength, _: strength.mean())


def _under_shifts(
    edges: Tensor, row: Tensor, column: Tensor, jump: Tensor, measure: Callable[[Tensor, Tensor], Tensor] = correlation
) -> Tensor | None:
    """The measure of edges and jumps, without shift and under EDGE_SHIFTS; None: too few jumps."""
    rows = []
    for down, right in [(0, 0), *EDGE_SHIFTS]:
        at, across = row + down, column + right
        inside = torch.nonzero((at >= 0) & (at < edges.shape[0]) & (across >= 0) & (across < edges.shape[1]))[:, 0]
        if float((jumps := jump[inside]).sum()) < MIN_JUMPS:
            return None
        rows.append(measure(edges[at[inside], across[inside]], jumps))
    return torch.stack(rows)


def _is_scan(cloud: Cloud, frame: Frame, spacing: Tensor, config: VisibilityConfig, projection: Projection) -> bool:
    """Whether hardly any point hides another point. A cloud of many views also has the points behind the surface."""
    thin = replace(config, method="zbuffer", footprint=0.1)
    visible = visible_points(cloud.points, spacing, frame.intrinsics, frame.world_to_camera, frame.size, thin)
    return len(visible.point) >= MIN_VISIBLE * len(projection.point)


def _image_edges(image: Tensor) -> tuple[Tensor | None, float]:
    """Edge strength [h, w] relative to its surroundings (None for a blank image), and the scale of the resizing."""
    scale = SIDE / max(image.shape[1:])
    size = [max(1, round(side * scale)) for side in image.shape[1:]]
    small = torch.nn.functional.interpolate(image[None], size, mode="bilinear", antialias=True)
    edges = smooth(GradientBoundary(smoothing=1.0, contrast=8.0)(small)[None], BLUR)
    if float(edges.std()) < MIN_CONTRAST:
        return None, scale
    away = edges - smooth(edges, SURROUNDINGS)
    return (away / (smooth(away**2, SURROUNDINGS) + 1e-4).sqrt())[0, 0].double(), scale


def _depth_jumps(projection: Projection, scale: float) -> tuple[Tensor, Tensor, Tensor]:
    """Row and column halfway between points that are neighbours in the image, and the depth jump there, 0 to 1."""
    place = (np.stack([projection.v.numpy(), projection.u.numpy()], axis=1).astype(np.float64) + 0.5) * scale - 0.5
    first = np.arange(0, len(place), -(-len(place) // MAX_QUERIES))
    # The nearest neighbour of a point is the point itself, or a duplicate.
    distance, second = cKDTree(place).query(place[first], k=NEIGHBORS + 1, distance_upper_bound=REACH)
    near = np.isfinite(distance[:, 1:])
    first, second = np.repeat(first[:, None], NEIGHBORS, axis=1)[near], second[:, 1:][near]
    depth = np.log(projection.z.double().numpy())
    jump = np.clip((np.abs(depth[first] - depth[second]) - SMALLEST_JUMP) / JUMP_RANGE, 0, 1)
    row, column = np.floor((place[first] + place[second]) / 2 + 0.5).astype(np.int64).T
    return torch.from_numpy(row), torch.from_numpy(column), torch.from_numpy(jump)


#: Number of frames that are checked, evenly spread over the sequence.
NUM_FRAMES = 6

#: Numbers of the frames that are checked if frames come one by one, because their total number is unknown.
CHECKED = (0, 1, 3, 7, 15, 31)

#: An edge alignment with a lower significance counts as chance. Correct poses of LiDARs have 2.6 or more.
CHANCE = 0.5

#: Masks are wrong if the significance of their borders is lower than the first number, and the strength of the edges
#: there, in local standard deviations, than the second. On 61 generated and 8 real scenes that is so for no right ones,
#: and for 334 of 406 of other frames, mirrored, turned, or shifted by a twelfth of the width. A few borders say too
#: little, such as those of one white thing before white: 66 of 1,337 choices of real masks were taken for wrong, and
#: are 2, if the strength, were it MASK_CHANCE deviations higher, must be below that of right masks, the third number.
MASK_CHANCE, MASK_STRENGTH, MASK_RIGHT = 2.0, 0.03, 0.15

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

#: Red and blue are exchanged if the correlation is larger then by this, and larger than by chance. In 43 generated and
#: 27 real scenes it is smaller by .04 or more, and with BGR larger by as much.
EXCHANGED = 0.03

#: What else depth images may fit: focal lengths so many times as large, and a cloud moved along an axis, metres.
SCALES, STEPS = (1 / 1.1, 1 / 1.05, 1.05, 1.1), (-0.1, 0.1)
NEARBY = [(scale, (0.0, 0.0, 0.0), f"focal lengths {scale:.2f} times as large") for scale in SCALES] + [
    (1.0, tuple(step * (one == axis) for one in range(3)), f"a cloud moved by {step:+.1f} m along {'xyz'[axis]}")
    for axis in range(3)
    for step in STEPS
]
#: They fit one of these if they differ less from it than the first number times the difference from what is given, and
#: this is above the second. It is the mean over the points, each of which counts at most the third number. In 35
#: generated and 25 real scenes, right data have at least 1.19 times the given one's for all of these; focal lengths
#: that are 10 % off, and clouds that are moved by 10 cm, have at most .59 for one of these, but in two noisy rooms.
NEARER, LEAST, LARGEST = 0.65, 0.005, 0.1


#: If so many frames, each by itself, fit in another convention only, the recording has both.
LEAST_MIXED = 2


class PoseAgreement(NamedTuple):
    """Agreement of poses and cloud for one frame, or for several: their mean, for depth the AGREEING_SHARE quantile.

    Attributes:
        in_view: share of the cloud's points inside the frame, before the visibility test.
        depth_residual: median |z of visible points - depth image| / depth; NaN without depth.
        color_residual: mean |colour of visible points - image|, RGB in [0, 1]; NaN if the points have no colours.
        color_by_chance: the same in shifted images.
        color_correlation: correlation of the two colours, -1 to 1.
        color_exchanged: the same with red and blue of the image exchanged.
    """

    in_view: float
    depth_residual: float = math.nan
    color_residual: float = math.nan
    color_by_chance: float = math.nan
    color_correlation: float = math.nan
    color_exchanged: float = math.nan

    def __str__(self) -> str:
        residuals = f"depth residual {self.depth_residual:.1%}, colour residual {self.color_residual:.2f}"
        return f"points in view {self.in_view:.1%}, {residuals}"


class _Look(NamedTuple):
    """The result of the comparison of one frame."""

    given: PoseAgreement
    others: dict[str, PoseAgreement]  #: with the poses read as in CONVENTIONS
    nearby: Tensor  #: [1 + number of NEARBY] the mean difference of the depths: as given, and for each of NEARBY
    off_center: float
    edges: Tensor | None  #: see edge_correlations
    borders: Tensor | None  #: of its masks or labels, see border_strengths


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
        self._name, self._seen = name or "scene", 0
        self._looks: list[_Look] = []
        self._said: set[str] = set()

    def check_all(self, frames: Iterable[Frame]) -> None:
        """Compares these frames."""
        with one_thread_per_operation():
            self._looks += parallel_map(self._look, frames)

    def check_incrementally(self, frames: Sequence[Frame]) -> None:
        """Compares some of the frames of a stream, and warns as soon as there are NUM_FRAMES of them."""
        chosen = [frame for number, frame in enumerate(frames, self._seen) if number in CHECKED]
        self._seen += len(frames)
        if chosen:
            self.check_all(chosen)
            if len(self._looks) >= NUM_FRAMES:
                self.warn()

    def warn(self) -> PoseAgreement | None:
        """Warns of each problem once; returns the agreement at the given poses, None if no frame was compared.

        Warns:
            PoseWarning: one for each problem found.
        """
        if not self._looks:
            return None
        given = _combined([look.given for look in self._looks])
        others = {kind: _combined([look.others[kind] for look in self._looks]) for kind in CONVENTIONS}
        found = _mixed(self._looks) | _complaints(given, others, max(look.off_center for look in self._looks))
        found = found or _nearby_complaints(torch.stack([look.nearby for look in self._looks]))
        with one_thread_per_operation():
            found |= _edge_complaints(combined([look.edges for look in self._looks if look.edges is not None]))
            found |= _mask_complaints(combined([look.borders for look in self._looks if look.borders is not None]))
        for kind, message in found.items():
            if kind not in self._said:
                self._said.add(kind)
                is_doubt = kind in ("edges", "masks", "nearby", "channels", "off center")
                warnings.warn(f"{self._name}: {message}", PoseDoubt if is_doubt else PoseWarning, stacklevel=4)
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
        segments = frame.masks.atom if isinstance(frame.masks, Masks) else frame.labels
        borders = None if segments is None else border_strengths(segments, frame.image)
        nearby = _nearby(self._cloud, self._spacing, frame, self._local.pose(pose), self._config)
        return _Look(given, dict(zip(CONVENTIONS, others, strict=True)), nearby, _off_center(frame), edges, borders)


def frames_to_check(scene: Scene) -> dict[int, Frame]:
    """At most NUM_FRAMES frames of a scene, evenly spread, by index."""
    return {index: scene.frames[index] for index in evenly_spaced_indices(len(scene.frames), NUM_FRAMES)}


def _agreement(cloud: Cloud, spacing: Tensor, frame: Frame, pose: Tensor, config: VisibilityConfig) -> PoseAgreement:
    in_view = project(cloud.points, frame.intrinsics, pose, frame.size).point.shape[0] / len(cloud.points)
    visible = visible_points(cloud.points, spacing, frame.intrinsics, pose, frame.size, config)
    depth_residual, colors = torch.nan, ColorAgreement()
    if frame.depth is not None:
        depth = frame.depth[visible.row, visible.column]
        depth_residual = ((visible.z - depth).abs() / depth)[depth > 0].median().item()
    if cloud.colors is not None:
        colors = color_agreement(cloud.colors[visible.point], frame.image, visible.row, visible.column)
    return PoseAgreement(in_view, depth_residual, *colors)


def _nearby(cloud: Cloud, spacing: Tensor, frame: Frame, pose: Tensor, config: VisibilityConfig) -> Tensor:
    """How much the depth of visible points differs from the depth image: as given, and for each of NEARBY."""
    differences = torch.full((1 + len(NEARBY),), torch.nan, dtype=torch.float64)
    if frame.depth is None:
        return differences
    point = visible_points(cloud.points, spacing, frame.intrinsics, pose, frame.size, config).point
    points = cloud.points[point[:: math.ceil(len(point) / MOST_POINTS) or 1]]
    for index, (scale, move, _) in enumerate([(1.0, (0.0, 0.0, 0.0), ""), *NEARBY]):
        intrinsics = frame.intrinsics * torch.tensor([[scale, 1, 1], [1, scale, 1], [1, 1, 1]], dtype=torch.float64)
        seen = project(points + torch.tensor(move, dtype=points.dtype), intrinsics, pose, frame.size)
        depth = frame.depth[nearest_pixel(seen.v), nearest_pixel(seen.u)]
        known = depth > 0
        if int(known.sum()) >= LEAST_POINTS:
            differences[index] = ((seen.z - depth).abs() / depth)[known].clamp(max=LARGEST).mean()
    return differences


def _combined(rows: list[PoseAgreement]) -> PoseAgreement:
    numbers = torch.tensor(rows, dtype=torch.float64)
    depth = torch.tensor([row.depth_residual for row in rows], dtype=torch.float64).nanquantile(AGREEING_SHARE)
    return PoseAgreement(*numbers.nanmean(dim=0).tolist())._replace(depth_residual=float(depth))


def _off_center(frame: Frame) -> float:
    """Distance of the principal point from the image's centre, as a share of the image's size."""
    height, width = frame.size
    x, y = float(frame.intrinsics[0, 2]), float(frame.intrinsics[1, 2])
    return max(abs(x - (width - 1) / 2) / width, abs(y - (height - 1) / 2) / height)


def _nearby_complaints(differences: Tensor) -> dict[str, str]:
    are_known = ~differences.isnan().any(dim=1)  # the same frames for all
    given, *others = differences[are_known].mean(dim=0).nan_to_num(math.inf).tolist()
    least, (_, _, what) = min(zip(others, NEARBY, strict=True))
    if not (LEAST < given < math.inf and least < NEARER * given):
        return {}
    told = f"they differ by {least:.1%} from it, and by {given:.1%} from what is given"
    return {"nearby": f"the depth images fit {what} better ({told}): wrong intrinsics, or another place of the cloud?"}


def _edge_complaints(alignment: EdgeAlignment | None) -> dict[str, str]:
    if alignment is None or alignment.significance >= CHANCE:
        return {}
    told = f"{alignment.significance:+.1f} standard deviations from shifted images, right poses have +2.6 and more"
    what = "image edges coincide with depth jumps of the points no more than by chance"
    return {"edges": f"{what} ({told}): wrong extrinsics or intrinsics?"}


def _mask_complaints(alignment: EdgeAlignment | None) -> dict[str, str]:
    if alignment is None or alignment.significance >= MASK_CHANCE or alignment.correlation >= MASK_STRENGTH:
        return {}
    if (alignment.significance + MASK_CHANCE) * alignment.deviation >= MASK_RIGHT:
        return {}
    what = "edges of the images are no stronger at the borders of masks or labels than elsewhere"
    return {"masks": f"{what}: are they of other images, mirrored or turned?"}


def _fits_better(given: PoseAgreement, other: PoseAgreement, kind: str) -> bool:
    # Comparisons with NaN are False, so a missing residual has no effect.
    depth_says = other.depth_residual < 0.05 and not given.depth_residual < 0.05
    color_says = other.color_residual < 0.7 * given.color_residual and not given.depth_residual < 0.05
    # More points in view alone say nothing of the axes, because a scene may lie behind a camera, too.
    is_likely = kind == "inverted" or other.color_correlation > CHANCE_CORRELATION
    view_says = is_likely and given.in_view * 5 < other.in_view and not other.depth_residual > 0.1
    return depth_says or color_says or view_says


def _mixed(looks: Sequence[_Look]) -> dict[str, str]:
    """Whether some of the frames, each by itself, fit only if they are read in another convention: LEAST_MIXED or more.

    The mean of all hides it: wrong frames may see no point, which has no residual.
    """
    fits = Counter(kind for look in looks for kind, other in look.others.items() if _fits_alone(look.given, other))
    kind, count = max(fits.items(), key=lambda one: one[1], default=("", 0))
    if count < LEAST_MIXED:
        return {}
    return {"convention": f"the poses of {count} of {len(looks)} checked frames look {CONVENTIONS[kind]}"}


def _fits_alone(given: PoseAgreement, other: PoseAgreement) -> bool:
    """Whether one frame fits at the other pose, and not at the given one; stricter than for the mean of several."""
    if not math.isnan(other.depth_residual):
        return other.depth_residual < LARGEST_DEPTH_RESIDUAL and not given.depth_residual < 2 * LARGEST_DEPTH_RESIDUAL
    is_like = other.color_residual < CHANCE_SHARE * other.color_by_chance
    return is_like and other.color_correlation > CHANCE_CORRELATION and not given.color_correlation > CHANCE_CORRELATION


def _residuals(agreement: PoseAgreement) -> list[float]:
    """Of depth and colour; what is not known comes last."""
    return np.nan_to_num((agreement.depth_residual, agreement.color_residual), nan=math.inf).tolist()


def _complaints(given: PoseAgreement, others: dict[str, PoseAgreement], off_center: float) -> dict[str, str]:
    """The problems that were found: kind -> message."""
    complaints = {}
    if better := [kind for kind, other in others.items() if _fits_better(given, other, kind)]:
        found = min(better, key=lambda kind: _residuals(others[kind]))
        told = f"the poses look {CONVENTIONS[found]} (as given: {given}; "
        complaints["convention"] = f"{told}read like this: {others[found]})"
    elif given.in_view == 0:
        complaints["view"] = "no point of the cloud is in view of the checked frames: wrong poses, units or axes?"
    elif given.depth_residual > LARGEST_DEPTH_RESIDUAL:
        told = f"the depth images and the cloud disagree by {given.depth_residual:.1%} (median)"
        complaints["depth"] = f"{told}: wrong poses, intrinsics or units?"
    elif given.color_exchanged > max(CHANCE_CORRELATION, given.color_correlation + EXCHANGED):
        told = "the colours of the points agree better with those of the images if red and blue are exchanged"
        complaints["channels"] = f"{told}: is one of them BGR?"
    elif (
        given.color_by_chance > LEAST_CONTRAST
        and given.color_residual > CHANCE_SHARE * given.color_by_chance
        and given.color_correlation < CHANCE_CORRELATION
    ):
        told = f"they differ by {given.color_residual:.2f}, and by {given.color_by_chance:.2f} in shifted images"
        what = "the colours of the points and of the images agree no more than by chance"
        complaints["color"] = f"{what} ({told}): wrong poses, or poses of other images?"
    if off_center > 0.2:
        told = f"the principal point is {off_center:.0%} of the image's size off its centre: are the intrinsics those "
        told += "of another image size? (Scale them with the image.)"
        # A problem that ends a run would hide what comes after it.
        complaints[next(iter(complaints), "off center")] = "; ".join((*complaints.values(), told))
    return complaints
