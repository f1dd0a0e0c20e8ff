"""Camera poses of a hand-held walk around the furniture in the middle of a room."""

from __future__ import annotations

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.world import World

#: Horizontal field of view of a Kinect-like camera, degrees.
FIELD_OF_VIEW = 57.0
#: Degrees between consecutive views, until the walk is a full circle.
_STEP = 17.0
#: Distance between camera and walls, metres: only the front of a wardrobe is farther from the wall.
WALL_MARGIN = 0.75


def intrinsics(height: int, width: int) -> Array:
    """[3, 3] camera matrix of an image of ``height`` x ``width`` pixels, centres at integer coordinates."""
    focal = width / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    return np.array([[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]])


def walk(rng: Rng, world: World, num_views: int) -> list[Array]:
    """True world-to-camera poses, [4, 4] each: an arc around ``world.focus`` at eye height, looking across it."""
    x, y, half_x, half_y = world.focus
    arc = np.radians(min(_STEP * num_views, 360.0)) * rng.choice([-1, 1])
    angle = rng.uniform(0, 2 * np.pi) + arc * (np.arange(num_views) + rng.normal(0, 0.12, num_views)) / num_views
    away = 0.7 + 0.2 * _sway(rng, num_views)
    reach = np.array([world.room[0], world.room[1]]) / 2 - WALL_MARGIN
    eye_x = np.clip(x + (half_x + away) * np.cos(angle), -reach[0], reach[0])
    eye_y = np.clip(y + (half_y + away) * np.sin(angle), -reach[1], reach[1])
    eye_z = 1.5 + 0.17 * _sway(rng, num_views)
    # The camera looks across the table: a near target fills the image with the table, a far one with the opposite wall.
    beyond = 0.25 + 0.5 * _sway(rng, num_views)
    target_x = x - beyond * np.cos(angle) + 0.3 * _sway(rng, num_views)
    target_y = y - beyond * np.sin(angle) + 0.3 * _sway(rng, num_views)
    target_z = 0.75 + 0.3 * _sway(rng, num_views)
    roll = np.radians(2.5) * (_sway(rng, num_views) + rng.normal(0, 0.4, num_views))
    return [
        _look_at(np.array(eye), np.array(target), float(lean))
        for eye, target, lean in zip(
            zip(eye_x, eye_y, eye_z, strict=True), zip(target_x, target_y, target_z, strict=True), roll, strict=True
        )
    ]


def erroneous(rng: Rng, poses: list[Array], pose_error: float) -> list[Array]:
    """Adds the errors of a tracker to poses.

    Args:
        rng: source of the errors.
        poses: [4, 4] each, true.
        pose_error: standard deviation of the camera's position along each axis, metres; the orientation's is
            ``pose_error`` / 2 m, in radians. Errors of consecutive views have correlation 0.8: trackers drift more than
            they jump.
    """
    if pose_error == 0:
        return [pose.copy() for pose in poses]
    error = np.zeros(6)
    reported = []
    for i, pose in enumerate(poses):
        fresh = rng.standard_normal(6)
        error = fresh if i == 0 else 0.8 * error + 0.6 * fresh
        jitter = np.eye(4)
        jitter[:3, :3] = _rotation(error[:3] * pose_error / 2)
        jitter[:3, 3] = error[3:] * pose_error
        reported.append(jitter @ pose)
    return reported


def _sway(rng: Rng, count: int) -> Array:
    """[count] smooth values in about [-1, 1]; a few oscillations over the walk."""
    time = np.arange(count) / 20.0
    waves = [np.sin(2 * np.pi * (f * time + rng.random())) for f in rng.uniform([0.5, 1.2, 2.5], [1.2, 2.5, 4.0])]
    return np.asarray(0.5 * waves[0] + 0.35 * waves[1] + 0.15 * waves[2])


def _look_at(eye: Array, target: Array, roll: float) -> Array:
    """[4, 4] world-to-camera pose, OpenCV axes; the world's z is up."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.stack([c * x + s * y, c * y - s * x, z])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ eye
    return pose


def _rotation(vector: Array) -> Array:
    """[3, 3] rotation by a rotation vector, radians (Rodrigues)."""
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross))
