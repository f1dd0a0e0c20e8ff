"""Fuses a point cloud from posed depth images, for recordings without a cloud.

Before, it checks whether the depth images agree with one another at the given poses.
"""

from __future__ import annotations

import hashlib
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

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
from torchjoint.scene.frame import CONVENTIONS, PoseWarning, camera_center
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
#: Fewest pixels that two images must share.
LEAST_SHARED = 100
#: About this number of pixels of an image are compared.
SAMPLED = 5000


@contextmanager
def _lost_if_interrupted() -> Iterator[None]:
    """Adds to an interrupt the message that the volume is lost, because it is only in memory."""
    try:
        yield
    except KeyboardInterrupt as stop:
        raise KeyboardInterrupt("the cloud was being fused from depth; the next run fuses it from the start") from stop


def fuse_cloud(
    frames: Sequence[Frame], voxel_size: float = 0.02, *, progress: bool | None = False
) -> tuple[Tensor, Tensor]:
    """Fuses depth images into a truncated signed distance volume (Curless and Levoy 1996) and extracts its surface.

    Args:
        frames: with depth; frames without depth are skipped.
        voxel_size: metres.
        progress: show a progress bar; None: if there is a terminal.

    Returns:
        points [N, 3] metres, float32 (float64 far from the origin), and colours [N, 3] in [0, 1], sorted by
        coordinates: the order is deterministic. Colours have 8 bits, so that the cloud is the same after it was written
        to a file and read back.

    Warns:
        PoseWarning: the poses do not fit, and another convention does.
        UserWarning: some frames have no depth.
    """
    points, colors, without = _fused(frames, voxel_size, progress)
    _tell_without_depth(without, len(frames))
    return points, colors


def _tell_without_depth(without: int, total: int) -> None:
    if without:
        told = f"depth: {without} of {total} frames have no depth image; the cloud is fused from the others"
        warnings.warn(told, stacklevel=3)


@_lost_if_interrupted()
@one_thread_per_operation()
def _fused(frames: Sequence[Frame], voxel_size: float, progress: bool | None) -> tuple[Tensor, Tensor, int]:
    """As :func:`fuse_cloud`, without its warning of frames without depth; and their number."""
    if not 1e-4 <= voxel_size <= 10:
        raise ValueError(f"voxel_size: expected 0.0001 to 10 metres, got {voxel_size}")
    check_unit(frames)
    warn_of_poses(frames)
    origin = volume_origin(frames, voxel_size)
    volume = Volume(voxel_size, MAX_DEPTH)
    fused = 0
    is_hidden = None if progress is None else not progress
    for index in tqdm(range(len(frames)), desc="fuse", unit="frame", disable=is_hidden):
        frame = frames[index]
        if frame.depth is None:
            continue
        fused += 1
        add_frame(volume, frame, origin)
    if fused == 0:
        raise ValueError("frames: none has a depth image, and there is no cloud.ply: there is no cloud to segment")
    points, colors = surface_cloud(volume, origin)
    if len(points) == 0:
        raise ValueError(f"depth: the {fused} depth images give no surface; wrong poses?")
    return points, colors, len(frames) - fused


def add_frame(volume: Volume, frame: Frame, origin: Tensor) -> Tensor:
    """Adds a frame with depth to a volume whose origin is at `origin` [3] float64; returns the keys of its blocks."""
    assert frame.depth is not None
    color = (frame.image * 255).round_().to(torch.uint8).permute(1, 2, 0)
    pose = frame.world_to_camera.double().clone()
    pose[:3, 3] += pose[:3, :3] @ origin
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
    raise ValueError(
        f"depth: expected metres, mostly {MIN_DEPTH:g} to {MAX_DEPTH:g}, got a median of {median:.4g} "
        f"in {len(images)} images; "
        f"these are probably {unit}"
    )


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
    file = _file(path, voxel_size, how)
    try:
        kept = {} if file is None else read_values(file)
    except (OSError, ValueError):  # it is not there, or damaged: it is written anew
        kept = {}
    if not kept:
        kept = dict(zip(("points", "colors", "without"), _fused(frames, voxel_size, progress), strict=True))
        with suppress(OSError):  # the disk is full, or there is no permission: the cloud is fused again next time
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                write_values(file, kept)
    _tell_without_depth(kept["without"], len(frames))
    return kept["points"], kept["colors"]


def _file(path: Path, voxel_size: float, how: str) -> Path | None:
    """Where the cloud is in the cache, with a checksum."""
    folder = cache_folder()
    if folder is None:
        return None
    key = repr((fingerprint(path), float(voxel_size), version("torchjoint"), how))
    return folder / "clouds" / f"{hashlib.sha256(key.encode()).hexdigest()}"


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
