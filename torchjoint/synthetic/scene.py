"""Records a room with a camera that walks around its table: images, depth, poses and a cloud, with their truth."""

from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.scene import Frame, Scene, Truth
from torchjoint.synthetic.room import Array, Rng, View, dot, furnish, look


@dataclass(frozen=True)
class SyntheticScene:
    """A scene and its ground truth.

    Attributes:
        scene: points [N, 3] in metres, world frame, z up, floor at 0; colours [N, 3]; no normals; frames with image,
            intrinsics, (erroneous) pose, (noisy) depth, named ``frame-000000`` and so on; and the ground truth below.
        point_labels: [N] int64, the instance on whose surface the point was measured.
        image_labels: per frame [H, W] int64, the instance at each pixel's centre, -1 where there is no surface.
        instance_names: instance id -> name; several may share a name, and some instances are never seen.
        instance_kinds: instance id -> "flat" (up to 1.5 cm thick, lying or hanging flush on a surface), "concave"
            (hollow: the camera sees its inside) or "other".
        true_world_to_camera: [4, 4] float64 per frame, the true poses of the camera.
        triangles: [T, 3, 3] float32, the surfaces, metres, world frame.
        triangle_labels: [T] int64, the instances of the triangles.
    """

    scene: Scene
    point_labels: Tensor
    image_labels: tuple[Tensor, ...]
    instance_names: tuple[str, ...]
    instance_kinds: tuple[str, ...]
    true_world_to_camera: tuple[Tensor, ...]
    triangles: Tensor
    triangle_labels: Tensor

    def __repr__(self) -> str:
        return f"SyntheticScene({self.scene!r}, {len(self.instance_names)} instances)"


#: Numbers of views, rows, columns and points, and the amount of small things.
SIZES = {
    "small": (6, 120, 160, 6_000, 0.25),
    "medium": (20, 240, 320, 40_000, 0.5),
    "large": (60, 480, 640, 150_000, 1.0),
}
#: Horizontal field of view of a Kinect-like camera, and angle between views until the walk is a full circle, radians.
_FIELD_OF_VIEW, _STEP = np.radians(57.0), np.radians(17.0)


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
) -> SyntheticScene:
    """Makes a room with a table, chairs, cabinets and small things, recorded with a hand-held RGB-D camera.

    Equal arguments give equal scenes, whatever the number of threads.

    Args:
        seed: determines room, things, trajectory and noise. Each has its own random stream: the difficulties below can
            be turned off without changing the rest.
        size: "small" (6 views of 160 x 120 pixels, 6,000 points), "medium" (20 of 320 x 240, 40,000), or "large" (60 of
            640 x 480, 150,000); larger rooms hold more things. The next four override its numbers.
        num_views: at least 1.
        height: pixels, at least 16.
        width: pixels, at least 16.
        num_points: at least 1, at most the number of valid depth pixels.
        pose_error: standard deviation of the reported camera positions, metres; the orientations' standard deviation is
            ``pose_error`` / 2 m, in radians. 0 to 0.05; a good tracker has 0.002 to 0.01.
        depth_noise: standard deviation of the depth at 1 m, metres; it grows with the square of the depth. 0 to 0.05;
            a Kinect has 0.0015.
        depth_holes: probability of no depth where a surface is seen at a grazing angle, or beside a nearer one. 0 to 1.
        image_noise: standard deviation of the pixel values in [0, 1]. 0 to 0.5.

    Raises:
        ValueError: an argument out of its range (named), or more points than the depth images have.
    """
    if size not in SIZES:
        raise ValueError(f"size: expected one of {', '.join(map(repr, SIZES))}, got {size!r}")
    names, given = ("num_views", "height", "width", "num_points"), (num_views, height, width, num_points)
    whole: dict[str, Any] = dict(zip(names, SIZES[size], strict=False))
    whole |= {name: value for name, value in zip(names, given, strict=True) if value is not None}
    for (name, value), least in zip({**whole, "seed": seed}.items(), (1, 16, 16, 1, 0), strict=True):
        if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
            raise ValueError(f"{name}: expected an integer of at least {least}, got {value!r}")
    errors = {"pose_error": pose_error, "depth_noise": depth_noise, "image_noise": image_noise}
    for (name, error), most in zip({**errors, "depth_holes": depth_holes}.items(), (0.05, 0.05, 0.5, 1), strict=True):
        if not 0 <= error <= most:  # also rejects NaN
            raise ValueError(f"{name}: expected 0 to {most}, got {error!r}")
    count, *shape, num_points = whole.values()
    streams = np.random.SeedSequence(seed).spawn(4 + 2 * count)
    of_room, of_walk, of_poses, of_cloud, *of_views = map(np.random.default_rng, streams)
    room, things = furnish(of_room, SIZES[size][-1])
    focal = shape[1] / 2 / np.tan(_FIELD_OF_VIEW / 2)
    camera = np.array([[focal, 0.0, (shape[1] - 1) / 2], [0.0, focal, (shape[0] - 1) / 2], [0.0, 0.0, 1.0]])
    true = _walk(of_walk, room, count)
    poses = [_drift(of_poses, pose_error) @ pose if pose_error else pose.copy() for pose in true]
    seen = [look(things, camera, pose, shape) for pose in true]
    images = [_photograph(rng, view, image_noise) for rng, view in zip(of_views[:count], seen, strict=True)]
    depths = [_measure(*each, depth_noise, depth_holes) for each in zip(of_views[count:], seen, strict=True)]
    points, pixel = _sample(of_cloud, depths, camera, poses, num_points)
    colors = torch.from_numpy(np.stack(images, 1).reshape(3, -1)[:, pixel].T.copy())
    kinds = {one: thing.kind for one, thing in enumerate(things) if thing.kind != "other"}
    image_labels = tuple(torch.from_numpy(view.labels) for view in seen)
    labels = torch.stack(image_labels).flatten()[torch.from_numpy(pixel)]
    truth = Truth(labels, image_labels, kinds)
    frames = []
    for index, arrays in enumerate(zip(images, poses, depths, strict=True)):
        image, pose, depth, intrinsics = map(torch.from_numpy, (*arrays, camera.copy()))
        frames.append(Frame(image, intrinsics, pose, depth, name=f"frame-{index:06d}"))
    surfaces = [np.concatenate([solid.triangles() for solid in thing.solids]) for thing in things]
    return SyntheticScene(
        Scene(torch.from_numpy(points), frames, colors, name=f"synthetic-{size}-{seed}", truth=truth),
        labels,
        image_labels,
        tuple(thing.name for thing in things),
        tuple(thing.kind for thing in things),
        tuple(map(torch.from_numpy, true)),
        torch.from_numpy(np.concatenate(surfaces)),
        torch.from_numpy(np.repeat(np.arange(len(things)), list(map(len, surfaces)))),
    )


def _walk(rng: Rng, room: tuple[float, float, float], count: int) -> list[Array]:
    """True world-to-camera poses [4, 4]: an arc around the table at eye height, looking across it."""
    step = min(_STEP, 2 * np.pi / count) * rng.choice([-1, 1])
    angle = rng.uniform(0, 2 * np.pi) + step * (np.arange(count) + rng.normal(0, 0.12, count))
    sway = np.sin(0.35 * np.arange(count)[:, None] * rng.uniform(0.5, 2.0, 6) + rng.uniform(0, 2 * np.pi, 6))
    around = np.stack([np.cos(angle), np.sin(angle)], 1)
    reach = np.array(room[:2]) / 2 - 0.75  # metres from the walls
    eyes = np.column_stack([np.clip((1.5 + 0.2 * sway[:, :1]) * around, -reach, reach), 1.5 + 0.15 * sway[:, 1]])
    targets = np.column_stack([-(0.3 + 0.3 * sway[:, 2:3]) * around + 0.2 * sway[:, 3:5], 0.7 + 0.2 * sway[:, 5]])
    return [_look_at(*each) for each in zip(eyes, targets, rng.normal(0, 0.03, count), strict=True)]


def _look_at(eye: Array, target: Array, roll: float) -> Array:
    """[4, 4] world-to-camera pose, OpenCV axes; `roll` in radians."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0]) / np.hypot(z[0], z[1])
    y, c, s = np.cross(z, x), np.cos(roll), np.sin(roll)
    pose = np.eye(4)
    pose[:3, :3] = c * x + s * y, c * y - s * x, z
    pose[:3, 3] = -dot(pose[:3, :3].T, eye)
    return pose


def _drift(rng: Rng, pose_error: float) -> Array:
    """[4, 4], what a tracker adds to a pose."""
    (x, y, z), error = rng.normal(size=3) * pose_error / 2, np.eye(4)
    half = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / 2
    error[:3, :3] = np.linalg.solve(np.eye(3) - half, np.eye(3) + half)  # a rotation (Cayley)
    error[:3, 3] = rng.normal(size=3) * pose_error
    return error


def _photograph(rng: Rng, view: View, noise: float) -> Array:
    """[3, H, W] float32 in [0, 1]: the light, a little blurred, with noise."""
    wide = np.pad(view.light.transpose(2, 0, 1), ((0, 0), (1, 1), (1, 1)), mode="edge")
    tall = (wide[..., :-2] + 2 * wide[..., 1:-1] + wide[..., 2:]) / 4
    image = (tall[:, :-2] + 2 * tall[:, 1:-1] + tall[:, 2:]) / 4
    return np.clip(image + noise * rng.standard_normal(image.shape), 0, 1).astype(np.float32)


def _measure(rng: Rng, view: View, noise: float, holes: float) -> Array:
    """[H, W] float32 metres, 0 = unknown: the depth with noise, and with holes where such a camera has them."""
    depth, wide = view.depth, np.pad(view.depth, ((0, 0), (2, 0)), mode="edge")
    shadowed = depth - np.minimum(wide[:, :-2], wide[:, 1:-1]) > 0.1 * depth  # the projector is beside the camera
    gone = ((view.facing < 0.12) | shadowed) & (rng.random(depth.shape) < holes)
    error = noise * depth**2 * rng.standard_normal(depth.shape)
    return np.where((depth > 0) & ~gone, np.maximum(depth + error, 1e-3), 0).astype(np.float32)


def _sample(rng: Rng, depths: list[Array], camera: Array, poses: list[Array], count: int) -> tuple[Array, Array]:
    """Points [count, 3] float32 of random pixels, mostly near ones; and the pixels, counted over all images."""
    depth = np.stack(depths).astype(float)
    valid = np.flatnonzero(depth)
    if len(valid) < count:
        raise ValueError(f"num_points: expected at most {len(valid)}, the depths of {len(depths)} views, got {count}")
    near = 1 / depth.ravel()[valid]
    pixel = rng.choice(valid, count, replace=False, p=near / near.sum())
    z, (frame, row, column) = depth.ravel()[pixel], np.unravel_index(pixel, depth.shape)
    ahead = (column - camera[0, 2]) / camera[0, 0] * z, (row - camera[1, 2]) / camera[1, 1] * z, z
    pose = np.stack(poses)[frame].T
    return np.stack([dot(pose[i, :3], np.stack(ahead) - pose[3, :3]) for i in range(3)], 1).astype(np.float32), pixel
