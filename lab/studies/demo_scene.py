"""Renders the recording of `torchjoint demo`, torchjoint/models/demo: `python lab/studies/demo_scene.py [--overview]`.

A furnished room, as a hand-held RGB-D camera records it that goes half around the table. The cloud is fused from the
depth images, as that of any recording; a point's true instance is that of the nearest surface that a camera sees.
--overview: instead segments the recording, as the demo does, and makes docs/overview.jpg of its picture.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from itertools import cycle
from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from scipy.spatial import KDTree
from torchjoint_lab.synthetic.furnished import sensor, trajectory
from torchjoint_lab.synthetic.furnished.render import Renderer
from torchjoint_lab.synthetic.furnished.room import make_world
from torchjoint_lab.synthetic.furnished.world import World

import torchjoint as tj

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "torchjoint" / "models" / "demo"
#: Which room, and how many small things are in it, 0 to 1.
SEED, CLUTTER = 4, 0.7
VIEWS, HEIGHT, WIDTH = 12, 360, 480
#: Where the walk around the table begins, and how far it goes, in turns: the room stays open to one side.
FIRST, ARC = 0.75, 0.42
#: Heights of the camera, and of what it looks at, in turn, metres.
LOOKS = ((1.75, 0.35), (1.5, 0.85))
#: Errors of a good camera: of positions, metres; of the depth at 1 m; of pixels; blur in pixels; of the exposure.
POSE_ERROR, DEPTH_NOISE, IMAGE_NOISE, BLUR, EXPOSURE = 0.002, 0.0004, 0.006, 0.7, 0.1
#: Inverse depths are multiples of this, 1/metres: depth cameras match images by fractions of a pixel.
STEP = 0.001
#: The smallest files for such depth have no filter.
PNG = [cv2.IMWRITE_PNG_COMPRESSION, 9, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE]
#: Distance of fused points; and of a point from a surface, if it is to have its instance; metres.
VOXEL, NEAR = 0.022, 0.03


def look_at(world: World, turn: float, heights: tuple[float, float]) -> np.ndarray:
    """[4, 4] world to camera: `turn` around the room, at a height; looks at a height above the table's middle."""
    reach = np.array(world.room[:2]) / 2 - trajectory.WALL_MARGIN
    eye = np.clip(3 * np.array([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)]), -reach, reach)
    ahead = np.array([*(world.focus[:2] - eye), heights[1] - heights[0]])
    right = np.array([ahead[1], -ahead[0], 0.0]) / np.hypot(*ahead[:2])
    ahead /= np.linalg.norm(ahead)
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(ahead, right), ahead
    pose[:3, 3] = -pose[:3, :3] @ [*eye, heights[0]]
    return pose


def write_frames(folder: Path) -> tuple[np.ndarray, list[np.ndarray]]:
    """Writes the frames in the style of 7-Scenes; returns places [K, 3] that they see, and their true labels."""
    of_room, of_poses, of_images = (np.random.default_rng(s) for s in np.random.SeedSequence(SEED).spawn(3))
    world, intrinsics = make_world(of_room, CLUTTER), trajectory.intrinsics(HEIGHT, WIDTH)
    turns = FIRST + ARC * np.arange(VIEWS) / (VIEWS - 1)
    true = [look_at(world, turn, look) for turn, look in zip(turns, cycle(LOOKS), strict=False)]
    np.savetxt(folder / "camera-intrinsics.txt", intrinsics, fmt="%.6f")
    renderer, places, labels = Renderer(world), [], []
    for index, pose in enumerate(trajectory.erroneous(of_poses, true, POSE_ERROR)):
        view, stem = renderer.view(true[index], intrinsics, HEIGHT, WIDTH), folder / f"frame-{index:06d}"
        image = sensor.photograph(of_images, view, EXPOSURE, BLUR, IMAGE_NOISE)
        color = Image.fromarray(np.round(255 * image).astype(np.uint8))
        color.save(f"{stem}.color.jpg", quality=88, optimize=True)
        depth = sensor.measure_depth(of_images, view, float(intrinsics[0, 0]), DEPTH_NOISE, 1.0)
        steps = np.round(1 / np.where(depth > 0, depth, np.inf) / STEP)
        millimetres = np.where(steps > 0, 1000 / (STEP * np.maximum(steps, 1)), 0)
        cv2.imwrite(f"{stem}.depth.png", millimetres.round().astype(np.uint16), PNG)
        np.savetxt(f"{stem}.pose.txt", np.linalg.inv(pose), fmt="%.9f")
        row, column = np.mgrid[:HEIGHT, :WIDTH]
        ahead = np.stack([column, row, 1 + 0 * row], -1) @ np.linalg.inv(intrinsics).T * view.depth[..., None]
        places.append(((ahead - pose[:3, 3]) @ pose[:3, :3]).reshape(-1, 3))
        labels.append(view.labels)
    return np.concatenate(places), labels


def render(folder: Path) -> None:
    """Writes the recording."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    places, images = write_frames(folder)
    ids, labels = np.unique(np.stack(images), return_inverse=True)
    labels = labels - int(ids[0] < 0)  # instances that are seen; -1: none
    for index, image in enumerate(labels.reshape(VIEWS, HEIGHT, WIDTH)):
        file = folder / f"frame-{index:06d}.truth.png"
        Image.fromarray((image + 1).astype(np.uint8)).save(file, optimize=True)
    points = tj.load_scene(folder, cloud=folder / "cloud.ply", voxel_size=VOXEL).points
    seen = labels.ravel() >= 0
    away, nearest = KDTree(places[seen]).query(points.numpy(), workers=-1)
    truth = np.where(away < NEAR, labels.ravel()[seen][nearest], -1)
    np.save(folder / "cloud.truth.npy", truth.astype(np.int8 if truth.max() < 128 else np.int16))
    size = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
    print(f"{folder}: {len(points):,} points, {(truth < 0).mean():.1%} of no instance; {truth.max() + 1} instances")
    print(f"{size:.2f} MB")


def draw() -> None:
    """Makes docs/overview.jpg of what the demo draws."""
    with tempfile.TemporaryDirectory() as work:
        subprocess.run([sys.executable, "-m", "torchjoint", "demo", "-o", f"{work}/demo"], check=True)
        picture = Image.open(f"{work}/demo/overview.png").convert("RGB")
    picture.thumbnail((1536, 1536), Image.Resampling.LANCZOS)
    picture.save(ROOT / "docs" / "overview.jpg", quality=85)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--overview", action="store_true")
    parser.add_argument("-o", "--out", type=Path, default=DEMO)
    arguments = parser.parse_args()
    draw() if arguments.overview else render(arguments.out)


if __name__ == "__main__":
    main()
