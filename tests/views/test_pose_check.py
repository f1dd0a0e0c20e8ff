"""Whether edges of a scan fall on edges of an image."""

import dataclasses
import functools
import math
import warnings

import numpy as np
import pytest
import torch
from PIL import Image, ImageDraw

import torchjoint as tj
from torchjoint.cloud.local import LocalFrame
from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.config import VisibilityConfig
from torchjoint.scene.frame import PoseWarning
from torchjoint.views.pose_check import CHANCE, PoseCheck, combined, frames_to_check

CONFIG = VisibilityConfig()
SIZE = (240, 400)
INTRINSICS = torch.tensor([[200.0, 0, 199.5], [0, 200, 119.5], [0, 0, 1]], dtype=torch.float64)


@functools.cache  # tests turn the cameras of a few clouds
def spacing_of_points(points):
    return nearest_neighbors(points, 16).spacing


def spacing_of(scene):
    return spacing_of_points(scene.points)


def check_of(scene, frames):
    check = PoseCheck(scene.cloud, spacing_of(scene), CONFIG, LocalFrame.of_world(), scene.name)
    check.check_all(frames)
    return check


def alignment(scene, frames=None):
    check = check_of(scene, frames or scene.frames)
    return combined([look.edges for look in check._looks if look.edges is not None])


def messages(scene):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_of(scene, frames_to_check(scene).values()).warn()
    assert all(issubclass(one.category, PoseWarning) for one in caught)
    return [str(one.message) for one in caught]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda labels: labels, False),
        (lambda labels: labels[1:] + labels[:1], True),
        (lambda labels: [one.flip(0, 1) for one in labels], True),
        (lambda labels: [one.roll(16, dims=1) for one in labels], True),
    ],
)
@pytest.mark.parametrize("kind", ["labels", "masks"])
def test_masks_of_other_images_are_told(scene_of, change, told, kind):
    synthetic = scene_of(0)
    given = change(list(synthetic.image_labels))
    if kind == "masks":
        given = [tj.masks.from_labels(one) for one in given]
    pairs = zip(synthetic.scene.frames, given, strict=True)
    frames = [dataclasses.replace(frame, **{kind: one}) for frame, one in pairs]
    found = messages(dataclasses.replace(synthetic.scene, frames=frames))
    assert [one.endswith("mirrored or turned?") for one in found] == [True] * told


def test_few_borders_of_masks_are_too_little_evidence(scene_of):
    frame = scene_of(0).scene.frames[0]
    mask = torch.full(frame.size, -1)
    mask[10:98, 10:128] = 0  # no edges at its borders: as of one white thing before white
    assert messages(dataclasses.replace(scene_of(0).scene, frames=[dataclasses.replace(frame, masks=mask)])) == []


def turned(scene, right, down=0.0):
    """The scene with its cameras turned, degrees."""
    angles = math.radians(right), math.radians(down)
    about_y, about_x = torch.eye(4).double(), torch.eye(4).double()
    about_y[0, 0] = about_y[2, 2] = math.cos(angles[0])
    about_y[0, 2], about_y[2, 0] = math.sin(angles[0]), -math.sin(angles[0])
    about_x[1, 1] = about_x[2, 2] = math.cos(angles[1])
    about_x[1, 2], about_x[2, 1] = -math.sin(angles[1]), math.sin(angles[1])
    frames = [dataclasses.replace(f, world_to_camera=about_x @ about_y @ f.world_to_camera) for f in scene.frames]
    return dataclasses.replace(scene, frames=frames)


@pytest.fixture(scope="module")
def boxes():
    """A scan of 40 beams of some boxes before a wall, and a picture of them."""
    rng = np.random.default_rng(0)
    picture = Image.new("RGB", SIZE[::-1], (120, 120, 120))
    draw = ImageDraw.Draw(picture)
    v, u = (axis.ravel() for axis in np.mgrid[3:237:6, 2:398:1.5])
    depth = np.full(len(u), 12.0)
    for far in np.linspace(10, 3, 14):  # nearer ones last: they are in front
        left, top = rng.uniform(0, 360), rng.uniform(0, 200)
        right, bottom = left + rng.uniform(20, 60), top + rng.uniform(20, 80)
        draw.rectangle([left, top, right, bottom], fill=tuple(rng.integers(0, 256, 3).tolist()))
        depth[(u > left) & (u < right) & (v > top) & (v < bottom)] = far
    pixels = np.asarray(picture) + rng.normal(0, 4, (*SIZE, 3))
    image = torch.from_numpy(pixels.clip(0, 255).astype(np.uint8)).permute(2, 0, 1)
    points = np.stack([(u - 199.5) / 200 * depth, (v - 119.5) / 200 * depth, depth], axis=1)
    frame = tj.Frame(image, INTRINSICS, torch.eye(4).double())
    return tj.Scene(torch.from_numpy(points), [frame], name="boxes")


def test_a_right_pose_is_far_from_chance(boxes):
    found = alignment(boxes)
    assert found.correlation > 0.3
    assert found.significance > 6
    assert messages(boxes) == []


@pytest.mark.parametrize("angles", [(6, 0), (-6, 0), (0, 6), (0, -6), (8, 8)])
def test_a_wrong_pose_is_not(boxes, angles):
    wrong, right = alignment(turned(boxes, *angles)), alignment(boxes)
    # Not quite chance: what is turned along long edges still lies on them.
    assert wrong.significance < 0.5 * right.significance
    assert wrong.correlation < 0.5 * right.correlation


def test_a_wrong_pose_is_warned_of_if_nothing_else_tells(boxes):
    wrong = turned(boxes, -6)
    assert alignment(wrong).significance < CHANCE
    assert len(messages(wrong)) == 1
    assert "boxes: image edges coincide with depth jumps of the points no more than by chance" in messages(wrong)[0]
    frame = wrong.frames[0]
    with_depth = dataclasses.replace(wrong, frames=[dataclasses.replace(frame, depth=torch.full(SIZE, 9.0))])
    with_colors = dataclasses.replace(wrong, colors=torch.rand(wrong.points.shape))
    assert not any("edges" in message for message in messages(with_depth) + messages(with_colors))


def test_the_result_is_the_same_with_any_number_of_threads(boxes, set_threads):
    results = []
    for threads in (1, 2, 3):
        set_threads(threads)
        results.append(alignment(boxes))
    assert results[0] == results[1] == results[2]


def test_flat_scenes_and_blank_images_tell_nothing(boxes):
    wall = boxes.points / boxes.points[:, 2:]
    assert alignment(dataclasses.replace(boxes, points=wall)) is None  # no jumps
    blank = dataclasses.replace(boxes.frames[0], image=torch.full((3, *SIZE), 0.5))
    assert alignment(boxes, [blank]) is None
    assert alignment(dataclasses.replace(boxes, points=boxes.points[:5])) is None
    assert alignment(dataclasses.replace(boxes, points=-boxes.points)) is None  # behind the camera


def test_a_cloud_of_many_views_is_no_scan(boxes):
    behind = torch.cat([boxes.points, boxes.points * 1.5])
    assert alignment(dataclasses.replace(boxes, points=behind)) is None


@pytest.mark.parametrize("seed", range(4))
def test_synthetic_scenes_without_colours_are_silent(seed, scene_of):
    scene = scene_of(seed).scene
    frames = [dataclasses.replace(frame, depth=None) for frame in scene.frames]
    assert messages(dataclasses.replace(scene, frames=frames, colors=None)) == []


class TestRealData:
    @pytest.mark.slow
    def test_kitti_s_calibration_is_right(self, shared):
        scenes = [tj.load_scene(path) for path in tj.datasets.list_scenes(shared / "data" / "kitti").values()]
        assert all(alignment(scene).significance > 3 for scene in scenes)
        assert messages(scenes[0]) == []

    @pytest.mark.slow
    def test_so_is_that_of_each_camera_of_nuscenes(self, shared):
        scene = tj.load_scene(shared / "data" / "nuscenes")
        assert alignment(scene).significance > 6
        assert messages(scene) == []
        assert all(alignment(scene, [frame]).significance > 2 for frame in scene.frames)

    @pytest.mark.slow
    def test_most_turned_cameras_are_noticed(self, shared):
        scene = tj.load_scene(shared / "data" / "nuscenes")
        wrong = [turned(scene.select_frames([i]), *angles) for i in range(6) for angles in ((5, 1), (-2, 4), (-4, -4))]
        assert sum(alignment(scene).significance < CHANCE for scene in wrong) >= 9  # of 18

    def test_the_guess_of_an_office_is_wrong(self, shared):
        scene = tj.load_scene(shared / "data" / "vlp16")
        assert alignment(scene).significance < -1
        assert any("wrong extrinsics or intrinsics" in message for message in messages(scene))

    def test_a_mended_one_is_silent(self, shared):
        # Found by hand, and seen to be right by looking: down by 15.6 degrees, to the left by 9.6, and 20 cm aside.
        scene = turned(tj.load_scene(shared / "data" / "vlp16"), 9.6, 15.6)
        frame = scene.frames[0]
        pose = frame.world_to_camera.clone()
        pose[:3, 3] += torch.tensor([0.2, 0, 0.05], dtype=torch.float64)
        mended = dataclasses.replace(scene, frames=[dataclasses.replace(frame, world_to_camera=pose)])
        assert not any("edges" in message for message in messages(mended))

    @pytest.mark.slow
    def test_depth_cameras_are_silent(self, shared):
        for name in ("learn0", "learn36"):
            scene = tj.load_scene(shared / "data" / "mosd" / f"{name}.pcd")
            frame = dataclasses.replace(scene.frames[0], depth=None)
            assert messages(dataclasses.replace(scene, frames=[frame], colors=None)) == []
