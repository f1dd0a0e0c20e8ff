"""Fuses a point cloud from posed depth images, for recordings without a cloud.

Before, it checks whether the depth images agree with one another at the given poses.
"""

import hashlib
import math
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from torchjoint.datasets.cameras import FLIP_YZ
from torchjoint.datasets.files.readers import fingerprint
from torchjoint.datasets.volume import Volume
from torchjoint.runtime.files import cache_folder
from torchjoint.runtime.store import read_values, write_values
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Frame
from torchjoint.scene.frame import CONVENTIONS, PoseDoubt, PoseWarning, camera_center
from torchjoint.scene.scene import evenly_spaced_indices

#: Depth beyond this, metres, is ignored: a depth camera's error grows with the square of the distance.
MAX_DEPTH = 5.0

#: Depth below this, metres, is no picture of a scene.
MIN_DEPTH = 0.05

#: Number of depth images whose unit is checked.
CHECKED = 6

#: The volume's origin is at a multiple of this many voxels.
GRID = 1 << 14

#: Number of pairs of frames that are compared, and the farthest partner of a frame, as a share of the sequence.
PAIRS, REACH = 6, 0.1
#: Cameras of a pair turned at least by this angle, degrees, or moved by this length, metres: else any pose fits.
LEAST_TURN, LEAST_STEP = 5.0, 0.1
#: The poses fit if the depths differ by less than the first number (median, relative; right poses of the kitchen and of
#: generated rooms have .006, wrong ones .066 and more). Another convention fits if it has less than the given poses'
#: difference times the second.
AGREEING, BETTER = 0.04, 0.3
#: If so many pairs, each by itself, fit in another convention only, the recording has both.
LEAST_MIXED = 2
#: What may be wrong, in words; the last two are depth of another unit, which is as if positions were.
KINDS = [f"the poses look {text}" for text in CONVENTIONS.values()] + [
    "some poses look turned in y and z: OpenGL axes and OpenCV axes in one recording?",
    "depth looks 5 times too small: millimetres where the format has 5000 per metre?",
    "depth looks 5 times too large: 5000 per metre where the format has millimetres?",
]
#: If all poses are equal, so many last depth images are compared with the first: what hides a view for a moment is no
#: motion of the camera. In the kitchen, a second of walking changes the median depth by .08 to .27.
LAST = 3
#: Fewest pixels that two images must share.
LEAST_SHARED = 100
#: Colours of two frames at the same places: of right ones, the median of the pairs' correlations is .7 and more, in the
#: kitchen and in generated rooms, of wrong ones .61 and less. With a smaller deviation there is nothing to compare.
LEAST_LIKENESS, LEAST_CONTRAST = 0.5, 0.05
#: About this number of pixels of an image are compared.
SAMPLED = 5000


@one_thread_per_operation()
def fuse_cloud(
    frames: Sequence[Frame], voxel_size: float = 0.02, progress: bool | None = False, name: str = "frames"
) -> tuple[Tensor, Tensor, int]:
    """Fuses depth images into a truncated signed distance volume (Curless and Levoy 1996) and extracts its surface.

    Args:
        frames: with depth; frames without depth are skipped.
        voxel_size: metres.
        progress: show a progress bar; None: if there is a terminal.
        name: of the recording, for messages.

    Returns:
        points [N, 3] metres, float32 (float64 far from the origin), and colours [N, 3] in [0, 1], sorted by
        coordinates: the order is deterministic. Colours have 8 bits, so that the cloud is the same after it was written
        to a file and read back. And the number of frames without depth.

    Warns:
        PoseWarning: the poses do not fit, and another convention does.
    """
    fused = _fuse(frames, voxel_size, progress, name)
    return fused["points"], fused["colors"], fused["without"]


def _fuse(frames: Sequence[Frame], voxel_size: float, progress: bool | None, name: str) -> dict[str, Any]:
    """What :func:`fuse_cloud` returns, and what it has told of the poses, by the name of the warning's class."""
    volume = Volume(voxel_size, MAX_DEPTH)
    try:
        check_unit(frames)
        doubts = _doubts(frames)
        _tell(doubts, name)
        origin = volume_origin(frames, voxel_size)
        fused = 0
        is_hidden = None if progress is None else not progress
        for index in tqdm(range(len(frames)), desc="fuse", unit="frame", disable=is_hidden):
            if (frame := frames[index]).depth is not None:
                fused += 1
                add_frame(volume, frame, origin)
        if fused == 0:
            raise ValueError("frames: none has a depth image, and there is no cloud.ply: there is no cloud to segment")
        points, colors = surface_cloud(volume, origin)
        if len(points) == 0:
            raise ValueError(f"depth: the {fused} depth images give no surface; wrong poses?")
        return {"points": points, "colors": colors, "without": len(frames) - fused, **doubts}
    except KeyboardInterrupt as stop:  # the volume is only in memory
        raise KeyboardInterrupt("the cloud was being fused from depth; the next run fuses it from the start") from stop


def add_frame(volume: Volume, frame: Frame, origin: Tensor, *, only_look: bool = False) -> Tensor:
    """Adds a frame with depth to a volume; returns the keys of the blocks that it sees.

    Args:
        volume: the volume.
        frame: with depth.
        origin: [3] float64 metres, where the volume's origin is.
        only_look: adds nothing, so that a caller may decide about the frame first.
    """
    assert frame.depth is not None
    pose = frame.world_to_camera.double().clone()
    pose[:3, 3] += pose[:3, :3] @ origin
    if only_look:
        return volume.blocks_near(frame.depth, frame.intrinsics.double(), pose)
    color = (frame.image * 255).round_().to(torch.uint8).permute(1, 2, 0)
    return volume.integrate(frame.depth, color, frame.intrinsics.double(), pose)


def surface_cloud(volume: Volume, origin: Tensor) -> tuple[Tensor, Tensor]:
    """The points and colours of the surface as :func:`fuse_cloud` returns them; there may be none."""
    points, colors = volume.surface()
    points = points.float()
    order = torch.from_numpy(np.lexsort(points.T.numpy()))
    # A cloud's file has 8 bits per colour: a cloud that is read back must be the same.
    return points[order].double() + origin if origin.any() else points[order], (colors[order].round() / 255).float()


def check_unit(frames: Sequence[Frame]) -> None:
    """Checks some depth images before all are fused, which takes long."""
    chosen = (frames[index] for index in evenly_spaced_indices(len(frames), CHECKED))
    images = [frame.depth for frame in chosen if frame.depth is not None]
    if not images or any(((image > MIN_DEPTH) & (image < MAX_DEPTH)).any() for image in images):
        return
    measured = torch.cat([image[image > 0] for image in images])
    if not len(measured):
        raise ValueError(f"depth: expected metres, got {len(images)} images without a measured pixel")
    median = float(measured.median())
    unit = "millimetres where metres are expected" if median >= MAX_DEPTH else "metres where the format has millimetres"
    told = f"depth: expected metres, mostly {MIN_DEPTH:g} to {MAX_DEPTH:g}"
    raise ValueError(f"{told}, got a median of {median:.4g} in {len(images)} images; these are probably {unit}")


def volume_origin(frames: Sequence[Frame], voxel_size: float) -> Tensor:
    """The origin of the volume in the world, [3] float64 metres: less than GRID voxels from a camera.

    So float32 is enough for coordinates in the volume, also far from the world's origin; near it, both coincide.
    """
    step = GRID * voxel_size
    center = camera_center(frames[0].world_to_camera) if len(frames) else torch.zeros(3, dtype=torch.float64)
    return (center / step).round() * step


def fuse_or_recall(
    path: Path, frames: Sequence[Frame], voxel_size: float, progress: bool | None, how: str = ""
) -> tuple[Tensor, Tensor | None]:
    """Returns the cloud that is fused from the frames of a recording; from the cache, if it was fused before.

    Args:
        path: the recording. A cached cloud is not used if a file of the recording or the package's version changed.
        frames, voxel_size, progress: as of :func:`~torchjoint.datasets.fusion.fuse_cloud`.
        how: the options by which the frames were read; read in another way they give another cloud.

    Returns:
        points [N, 3] metres and colours [N, 3] in [0, 1]; the same with and without the cache.
    """
    folder, file, kept, known = cache_folder(), None, {}, ""
    if folder is not None:
        known = fingerprint(path, changed=True)
        key = repr((known, float(voxel_size), version("torchjoint"), how)).encode()
        file = folder / "clouds" / hashlib.sha256(key).hexdigest()
        with suppress(OSError, ValueError):  # it is not there, or damaged: it is written anew
            kept = read_values(file)
    if kept:
        _tell(kept, str(path))
    else:
        kept = _fuse(frames, voxel_size, progress, str(path))
        with suppress(OSError):  # the disk is full, or there is no permission: the cloud is fused again next time
            if file is not None and known == fingerprint(path, changed=True):  # else it is the cloud of other frames
                file.parent.mkdir(parents=True, exist_ok=True)
                write_values(file, kept)
    if kept["without"]:
        told = f"depth: {kept['without']} of {len(frames)} frames have no depth image"
        warnings.warn(f"{told}; the cloud is fused from the others", stacklevel=2)
    return kept["points"], kept["colors"]


def warn_of_poses(frames: Sequence[Frame], name: str = "frames") -> bool:
    """Compares the depth images of some pairs of frames, at the given poses and at the poses read otherwise.

    Returns:
        whether it warned.

    Warns:
        PoseWarning: the poses do not fit, and another convention does; or positions have another unit than depth.
        PoseDoubt: the poses do not fit, and nothing else does; or they do, and the colours do not.
    """
    _tell(doubts := _doubts(frames), name)
    return bool(doubts)


def _tell(doubts: Mapping[str, Any], name: str) -> None:
    for kind in (PoseWarning, PoseDoubt):
        if kind.__name__ in doubts:
            warnings.warn(f"{name}: {doubts[kind.__name__]}", kind, stacklevel=5)


@one_thread_per_operation()
def _doubts(frames: Sequence[Frame]) -> dict[str, str]:
    """What :func:`warn_of_poses` tells, by the name of the warning's class."""
    pairs = _pairs(frames)
    residuals = [_residuals(one, other) for one, other in pairs]
    if not residuals:
        return _doubts_at_rest([frames[index] for index in evenly_spaced_indices(len(frames), PAIRS)])
    table = torch.tensor(residuals, dtype=torch.float64).nan_to_num(math.inf)
    given, *others = table.median(dim=0).values.tolist()
    best, kind = min(zip(others, KINDS, strict=True))
    said = f"differ by {given:.1%}" if math.isfinite(given) else "have nothing in common"
    if given > AGREEING and best < min(AGREEING, BETTER * given):
        told = f"depth images of neighbouring frames {said} as given, by {best:.1%} read like this"
        return {PoseWarning.__name__: f"{kind} ({told})"}
    fits = (table[:, :1] > AGREEING) & (table[:, 1:] < (BETTER * table[:, :1]).clamp(max=AGREEING))
    count, place = (int(one) for one in fits.sum(0).max(dim=0))
    if count >= LEAST_MIXED:
        told = f"depth images of {count} of {len(pairs)} pairs of neighbouring frames fit only if read like this"
        return {PoseWarning.__name__: f"{KINDS[place]} ({told})"}
    if math.isinf(given) and all(_are_apart(one, other) for one, other in pairs):
        told = "the cameras of neighbouring frames are farther apart than their depth images reach"
        return {PoseWarning.__name__: f"{told}: are positions in metres, as depth is, not in millimetres?"}
    if AGREEING < given < math.inf:  # frames that are far apart may differ, too
        told = f"depth images of neighbouring frames {said} (median)"
        return {PoseDoubt.__name__: f"{told}: wrong poses, order of quaternions, intrinsics or units?"}
    likeness = [one for one in map(_likeness, pairs) if not math.isnan(one)] if given <= AGREEING else []
    if len(likeness) > 1 and (median := float(np.median(likeness))) < LEAST_LIKENESS:
        told = f"depth of neighbouring frames agrees, colours of the same places do not (correlation {median:.2f})"
        return {PoseDoubt.__name__: f"{told}: are the colour images those of other frames, or turned?"}
    return {}


def _doubts_at_rest(frames: Sequence[Frame]) -> dict[str, str]:
    """Of frames with equal poses: the last ones must see what the first one saw, or poses are missing."""
    measured = [frame for frame in frames if frame.depth is not None]
    first = measured[0] if len(measured) > LAST else None
    if first is None or any((one.world_to_camera != first.world_to_camera).any() for one in measured):
        return {}
    least = min(_residual(first, one, torch.eye(4, dtype=torch.float64)) for one in measured[-LAST:])
    if not least > AGREEING:  # or it is not known
        return {}
    told = f"all poses are equal, but depth images differ by {least:.1%} and more (median)"
    return {PoseDoubt.__name__: f"{told}: are the poses missing?"}


def _are_apart(one: Frame, other: Frame) -> bool:
    """Whether two frames with depth see nothing in common because of their distance: each fits its own surface."""
    step = camera_center(one.world_to_camera) - camera_center(other.world_to_camera)
    return float(step.norm()) > sum(float(frame.depth.max()) for frame in (one, other) if frame.depth is not None)


def _pairs(frames: Sequence[Frame]) -> list[tuple[Frame, Frame]]:
    """Frames with depth, each with the first of the following frames whose camera has moved enough."""
    found, count = [], len(frames)
    farthest = max(1, round(REACH * count))
    for index in evenly_spaced_indices(count - 1, PAIRS) if count > 1 else ():
        if (one := frames[index]).depth is not None:
            others = (frames[partner] for partner in range(index + 1, min(count, index + 1 + farthest)))
            found += [(one, other) for other in islice(filter(partial(_has_moved, one), others), 1)]
    return found


def _has_moved(one: Frame, other: Frame) -> bool:
    """Whether a frame has depth, and another place or direction than one before it."""
    if other.depth is None:
        return False
    motion = other.world_to_camera @ torch.linalg.inv(one.world_to_camera)
    turn = math.degrees(math.acos(max(-1.0, min(1.0, (float(motion[:3, :3].trace()) - 1) / 2))))
    return turn >= LEAST_TURN or float(motion[:3, 3].norm()) >= LEAST_STEP


def _residuals(one: Frame, other: Frame) -> list[float]:
    """The median relative difference of the depths: at the given poses, and for each of KINDS; NaN: unknown."""
    motion = other.world_to_camera @ torch.linalg.inv(one.world_to_camera)
    inverse = torch.linalg.inv(other.world_to_camera) @ one.world_to_camera  # between the inverted poses
    fifth, fivefold = (torch.cat([motion[:, :3], motion[:, 3:] * step], dim=1) for step in (0.2, 5.0))
    both = (motion, inverse, FLIP_YZ @ motion @ FLIP_YZ, FLIP_YZ @ inverse @ FLIP_YZ)
    tried = (*both, motion @ FLIP_YZ, FLIP_YZ @ motion, fifth, fivefold)
    *found, first, second, smaller, larger = (_residual(one, other, each) for each in tried)
    return [*found, float(np.fmin(first, second)), smaller, larger]


def _residual(one: Frame, other: Frame, motion: Tensor) -> float:
    """The same for one motion [4, 4] from the camera of the first frame to that of the second."""
    met = _meeting(one, other, motion)
    return math.nan if met is None else float(met.difference.median())


def _likeness(pair: tuple[Frame, Frame]) -> float:
    """The correlation of the colours of two frames where they see the same places; NaN: too few, or no contrast."""
    one, other = pair
    met = _meeting(one, other, other.world_to_camera @ torch.linalg.inv(one.world_to_camera))
    if met is None or int((same := met.difference < AGREEING).sum()) < LEAST_SHARED:
        return math.nan
    images = ((one.image, met.row, met.column), (other.image, met.v, met.u))
    first, second = (image[:, row[same], column[same]].double() for image, row, column in images)
    first, second = (colors - colors.mean(1, keepdim=True) for colors in (first, second))
    if min(float(first.std()), float(second.std())) < LEAST_CONTRAST:
        return math.nan
    return float((first * second).sum() / (first.norm() * second.norm()))


class _Meeting(NamedTuple):
    """Where two frames see the same places, if their depth is right: K pixels of each."""

    row: Tensor  #: [K] int64, of the first
    column: Tensor
    v: Tensor  #: [K] int64, rows of the second
    u: Tensor
    difference: Tensor  #: [K] relative, of the depths


def _meeting(one: Frame, other: Frame, motion: Tensor) -> _Meeting | None:
    """None: they share too few pixels."""
    depths, there = one.depth, other.depth
    assert depths is not None  # as _pairs chooses them
    assert there is not None
    step = max(1, math.isqrt(depths.numel() // SAMPLED))
    row, column = torch.nonzero(depths[::step, ::step] > 0).T * step
    depth = depths[row, column].double()
    points = torch.linalg.inv(one.intrinsics) @ torch.stack([column, row, torch.ones_like(row)]).double() * depth
    x, y, z = other.intrinsics @ (motion[:3, :3] @ points + motion[:3, 3:])
    z = torch.where(z > 0, z, torch.nan)
    u, v = (x / z).round(), (y / z).round()
    height, width = other.size
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)  # False for NaN
    row, column, v, u, z = row[inside], column[inside], v[inside].long(), u[inside].long(), z[inside]
    seen = there[v, u].double()
    known = seen > 0
    if int(known.sum()) < LEAST_SHARED:
        return None
    return _Meeting(*(each[known] for each in (row, column, v, u, (z - seen).abs() / seen)))
