"""Makes seeded indoor scenes with the exact instance of every point and every pixel."""

from __future__ import annotations

from dataclasses import replace
from numbers import Integral
from typing import NamedTuple

import numpy as np
import torch

from torchjoint.scene import Frame, Scene, Truth
from torchjoint.synthetic import SyntheticScene
from torchjoint_lab.synthetic.furnished import cloud, sensor, trajectory
from torchjoint_lab.synthetic.furnished.render import Renderer
from torchjoint_lab.synthetic.furnished.room import FurnishMore, make_world


class _Size(NamedTuple):
    num_views: int
    height: int
    width: int
    num_points: int
    clutter: float


#: Numbers of views, pixels and points, and the amount of small things.
SIZES = {
    "small": _Size(6, 120, 160, 6_000, 0.25),
    "medium": _Size(20, 240, 320, 40_000, 0.5),
    "large": _Size(60, 480, 640, 150_000, 1.0),
}

#: The largest value of an argument, and its unit; the least one is 0.
_MOST = {
    "pose_error": (0.05, "metres"),
    "depth_noise": (0.05, "metres at 1 m"),
    "depth_ripple": (0.05, "metres at 1 m"),
    "depth_holes": (1.0, "a probability scale"),
    "image_noise": (0.5, "of [0, 1]"),
    "motion_blur": (20.0, "pixels"),
    "exposure": (1.0, "of the logarithm"),
}


def make_scene(
    seed: int = 0,
    size: str = "small",
    *,
    num_views: int | None = None,
    height: int | None = None,
    width: int | None = None,
    num_points: int | None = None,
    pose_error: float = 0.003,
    depth_noise: float = 0.0015,
    depth_holes: float = 1.0,
    image_noise: float = 0.015,
    motion_blur: float = 1.5,
    exposure: float = 0.15,
    shadows: bool = True,
    textures: bool = True,
    depth_ripple: float = 0.0,
    furnish_more: FurnishMore | None = None,
) -> SyntheticScene:
    """Makes a furnished room, recorded with a hand-held RGB-D camera.

    Equal arguments give equal scenes, whatever the number of threads.

    ======== ===== ========= ======== ================================
    size     views pixels    points   instances (5 to 95 % of seeds)
    ======== ===== ========= ======== ================================
    small    6     160 x 120 6,000    50 to 160
    medium   20    320 x 240 40,000   60 to 155
    large    60    640 x 480 150,000  80 to 165
    ======== ===== ========= ======== ================================

    Args:
        seed: determines room, furniture, materials, lights, trajectory and noise. Each has its own random stream: the
            difficulties below can be turned off without changing the rest.
        size: "small" (tests), "medium" (benchmarks) or "large" (as large as a real recording).
        num_views: overrides the number of ``size``; at least 1.
        height: of the images, pixels; overrides ``size``; at least 16.
        width: of the images, pixels; overrides ``size``; at least 16.
        num_points: overrides the number of ``size``; at least 1, at most the number of valid depth pixels.
        pose_error: standard deviation of the reported camera positions, metres; the orientations' standard deviation is
            ``pose_error`` / 2 m, in radians. 0 to 0.05; a good tracker has 0.002 to 0.01.
        depth_noise: standard deviation of the depth at 1 m, metres; it grows with the square of the depth. 0 to 0.05;
            a Kinect has 0.0015.
        depth_holes: scale of the probability of holes in the depth, 0 (none) to 1 (as a Kinect).
        image_noise: standard deviation of the pixel values in [0, 1]. 0 to 0.5.
        motion_blur: typical length of the blur, pixels in an image 480 high, 0 to 20.
        exposure: standard deviation of the logarithm of the exposure over the views; the white balance varies by a
            fifth of it. 0 to 1.
        shadows: False: lamps cast no shadows.
        textures: False: each material has one colour.
        depth_ripple: standard deviation at 1 m, metres, of a depth error that is correlated between neighbouring pixels
            and independent between views: fused walls become wavy and double. It grows with the square of the depth. 0
            (none) to 0.05; a Kinect has 0.002 to 0.003.
        furnish_more: adds more to the room when it is furnished; the rest of the room does not change.

    Returns:
        The scene with its ground truth.

    Raises:
        ValueError: an argument out of its range (named), or more points than the depth images have.
        ModuleNotFoundError: embreex, which casts the rays, is not installed.
    """
    resolved = _resolve(size, num_views, height, width, num_points)
    _check_ranges(
        seed, pose_error=pose_error, depth_noise=depth_noise, depth_ripple=depth_ripple, depth_holes=depth_holes,
        image_noise=image_noise, motion_blur=motion_blur, exposure=exposure,
    )  # fmt: skip
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4)]
    world = make_world(streams[0], resolved.clutter, textures, furnish_more)
    true_poses = trajectory.walk(streams[1], world, resolved.num_views)
    poses = trajectory.erroneous(streams[2], true_poses, pose_error)
    intrinsics = trajectory.intrinsics(resolved.height, resolved.width)
    renderer = Renderer(world, shadows)
    shots = []
    noise_seeds = np.random.SeedSequence(seed, spawn_key=(4,)).spawn(2 * resolved.num_views)
    ripple_seeds = np.random.SeedSequence(seed, spawn_key=(6,)).spawn(resolved.num_views)
    for i, true_pose in enumerate(true_poses):
        view = renderer.view(true_pose, intrinsics, resolved.height, resolved.width)
        of_image, of_depth = (np.random.default_rng(s) for s in noise_seeds[2 * i : 2 * i + 2])
        image = sensor.photograph(of_image, view, exposure, motion_blur, image_noise)
        if depth_ripple > 0:
            view = replace(view, depth=sensor.rippled(np.random.default_rng(ripple_seeds[i]), view.depth, depth_ripple))
        depth = sensor.measure_depth(of_depth, view, float(intrinsics[0, 0]), depth_noise, depth_holes)
        shots.append(cloud.Shot(image, depth, view.labels, poses[i]))
    points, colors, labels = cloud.fuse(streams[3], shots, intrinsics, resolved.num_points)
    frames = tuple(_as_frame(shot, intrinsics, i) for i, shot in enumerate(shots))
    kinds = {instance: kind for instance, kind in enumerate(world.kinds) if kind != "other"}
    truth = Truth(torch.from_numpy(labels), tuple(torch.from_numpy(shot.labels) for shot in shots), kinds)
    name = f"synthetic-{size}-{seed}"
    return SyntheticScene(
        scene=Scene(torch.from_numpy(points), frames, torch.from_numpy(colors), name=name, truth=truth),
        point_labels=torch.from_numpy(labels),
        image_labels=tuple(truth.images),
        instance_names=world.names,
        instance_kinds=world.kinds,
        true_world_to_camera=tuple(torch.from_numpy(pose) for pose in true_poses),
        triangles=torch.from_numpy(world.triangles),
        triangle_labels=torch.from_numpy(world.labels),
    )


def _as_frame(shot: cloud.Shot, intrinsics: np.ndarray, index: int) -> Frame:
    return Frame(
        image=torch.from_numpy(np.ascontiguousarray(shot.image.transpose(2, 0, 1))),
        intrinsics=torch.from_numpy(intrinsics.copy()),
        world_to_camera=torch.from_numpy(shot.camera_from_world),
        depth=torch.from_numpy(shot.depth),
        name=f"frame-{index:06d}",
    )


def _resolve(size: str, num_views: int | None, height: int | None, width: int | None, num_points: int | None) -> _Size:
    if size not in SIZES:
        raise ValueError(f"size: expected one of {', '.join(map(repr, SIZES))}, got {size!r}")
    given = {"num_views": num_views, "height": height, "width": width, "num_points": num_points}
    least = {"num_views": 1, "height": 16, "width": 16, "num_points": 1}
    for name, value in given.items():
        if value is None:
            continue
        if not _is_integer(value) or value < least[name]:
            raise ValueError(f"{name}: expected an integer of at least {least[name]}, got {value!r}")
    return SIZES[size]._replace(**{name: value for name, value in given.items() if value is not None})


def _is_integer(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _check_ranges(seed: int, **given: float) -> None:
    if not _is_integer(seed) or seed < 0:
        raise ValueError(f"seed: expected an integer of at least 0, got {seed!r}")
    for name, value in given.items():
        most, unit = _MOST[name]
        if not 0 <= value <= most:  # also rejects NaN
            raise ValueError(f"{name}: expected 0 to {most} ({unit}), got {value!r}")
