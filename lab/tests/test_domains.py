"""Scenes of every domain: valid, repeatable, their truth the same in points and images, as hard as they say."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import torch
from torchjoint_lab.synthetic import DOMAINS, SyntheticScene, domain_settings, make_domain_scene
from torchjoint_lab.synthetic.furnished import mesh
from torchjoint_lab.synthetic.rigs import Rig

pytest.importorskip("open3d")

#: Of a truth's labels, so many must be right: depths err at edges, and colours' pixels are a shift away.
AGREEMENT = 0.75


@functools.cache
def scene_of(domain: str, seed: int = 3, num_views: int = 2) -> SyntheticScene:
    return make_domain_scene(domain, seed, num_views=num_views, num_points=4000)


@pytest.mark.parametrize("domain", DOMAINS)
class TestEveryDomain:
    def test_is_a_whole_scene(self, domain: str) -> None:
        made = scene_of(domain)
        scene = made.scene
        assert scene.name == f"{domain}-3"
        assert len(scene.frames) == len(made.image_labels) == len(scene.truth.images) == 2
        assert len(scene.points) == len(made.point_labels) <= 4000
        assert torch.isfinite(scene.points).all()
        assert made.point_labels.min() >= 0
        assert made.point_labels.max() < len(made.instance_names) == len(made.instance_kinds)
        assert len(made.point_labels.unique()) >= 4
        assert all(image.max() < len(made.instance_names) for image in made.image_labels)
        assert all(0.02 < float(frame.image.mean()) < 0.98 for frame in scene.frames)

    def test_truth_is_the_instances_or_void(self, domain: str) -> None:
        made = scene_of(domain)
        known = made.scene.truth.points
        assert ((known == made.point_labels) | (known == -1)).all()
        assert domain == "street" or (known >= 0).all()

    def test_points_and_pixels_have_the_same_instances(self, domain: str) -> None:
        made = scene_of(domain)
        agree = total = 0
        for frame, labels, pose in zip(made.scene.frames, made.image_labels, made.true_world_to_camera, strict=True):
            camera = made.scene.points.double() @ pose[:3, :3].T + pose[:3, 3]
            ahead = camera[:, 2] > 0.1
            pixel = (camera @ frame.intrinsics.T.double())[ahead]
            column, row = (pixel[:, :2] / pixel[:, 2:]).round().long().T
            inside = (row >= 0) & (row < labels.shape[0]) & (column >= 0) & (column < labels.shape[1])
            seen = _first(camera[ahead][inside], row[inside], column[inside], labels.shape)
            point = made.point_labels[ahead][inside][seen]
            agree += int((point == labels[row[inside][seen], column[inside][seen]]).sum())
            total += len(point)
        assert total > 100
        assert agree > AGREEMENT * total

    def test_settings_vary(self, domain: str) -> None:
        drawn = [domain_settings(domain, seed) for seed in range(40)]
        assert len({settings.num_views for settings in drawn}) > 3
        assert len({settings.sensor for settings in drawn}) == (1 if domain == "street" else 3)
        noise = [settings.depth_noise for settings in drawn]
        assert max(noise) > 2 * min(noise)
        assert all(settings.pose_error == 0 for settings in drawn if settings.num_views == 1)
        assert any(settings.cropped for settings in drawn)


@pytest.mark.parametrize(("domain", "least", "most"), [("room", 90, 100), ("kitchen", 90, 100), ("desk", 50, 60)])
def test_some_scenes_have_many_views(domain: str, least: int, most: int) -> None:
    views = [domain_settings(domain, seed).num_views for seed in range(120)]
    assert least < max(views) <= most
    assert min(views) < 12


def _first(camera: torch.Tensor, row: torch.Tensor, column: torch.Tensor, shape: torch.Size) -> torch.Tensor:
    """Which points are the nearest of their 8 x 8 pixels, within 2 %."""
    cell = (row // 8) * (shape[1] // 8 + 1) + column // 8
    nearest = torch.full((int(cell.max()) + 1,), torch.inf, dtype=camera.dtype)
    nearest.scatter_reduce_(0, cell, camera[:, 2], "amin")
    return camera[:, 2] < 1.02 * nearest[cell]


def same(a: SyntheticScene, b: SyntheticScene) -> bool:
    tensors = [
        (a.scene.points, b.scene.points),
        (a.point_labels, b.point_labels),
        (a.triangles, b.triangles),
        *((x.image, y.image) for x, y in zip(a.scene.frames, b.scene.frames, strict=True)),
        *((x.world_to_camera, y.world_to_camera) for x, y in zip(a.scene.frames, b.scene.frames, strict=True)),
        *zip(a.image_labels, b.image_labels, strict=True),
    ]
    return all(torch.equal(x, y) for x, y in tensors)


@pytest.mark.parametrize("domain", ["bin", pytest.param("street", marks=pytest.mark.slow)])
def test_equal_arguments_give_equal_scenes(domain: str) -> None:
    assert same(scene_of(domain), make_domain_scene(domain, 3, num_views=2, num_points=4000))


def test_seeds_and_domains_differ() -> None:
    assert len({domain_settings(domain, seed) for domain in DOMAINS for seed in range(5)}) == 5 * len(DOMAINS)


def test_a_street_is_one_scan_without_colours() -> None:
    made = scene_of("street")
    assert made.scene.colors is None
    assert made.scene.frames[0].depth is None
    names = np.array(made.instance_names)
    assert (names == "ground").sum() == 1
    void = set(names[np.unique(made.point_labels[made.scene.truth.points < 0])])
    assert void <= {"tree", "hedge", "fence", "wall", "building", "bin", "bench", "stone"}
    assert made.scene.points.norm(dim=1).max() < 81
    below = made.scene.points[made.scene.truth.points == int(np.flatnonzero(names == "ground")[0])]
    assert -4 < float(below[below[:, :2].norm(dim=1) < 8, 2].median()) < -1


def test_rooms_have_few_loose_sheets_left() -> None:
    made = scene_of("room")
    names = np.array(made.instance_names)
    seen = np.unique(made.triangle_labels)
    thin = np.isin(names, ("paper", "magazine", "poster", "picture"))
    assert thin[seen].sum() < 0.6 * thin.sum()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"domain": "moon"}, "domain: expected one of"),
        ({"domain": "table", "lidar": "64"}, "lidar: expected None, or for streets one of"),
        ({"domain": "street", "lidar": "8"}, "lidar: expected None, or for streets one of"),
        ({"domain": "table", "seed": -1}, "seed: expected"),
        ({"domain": "table", "num_views": 0}, "num_views: expected"),
        ({"domain": "table", "num_points": True}, "num_points: expected"),
    ],
)
def test_bad_arguments_are_named(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_domain_scene(**arguments)


def test_no_camera_stands_in_a_high_heap() -> None:
    class Tower:
        """A column, 0.4 m wide and 1.2 m high."""

        def clearance(self, place: np.ndarray) -> float:
            return max(np.hypot(*place[:2]) - 0.2, place[2] - 1.2)

    rig = Rig((0, 0, 0.1), (0.03, 0.03, 0.02), (0.7, 1.1), (np.radians(70), np.radians(88)), 0.0, 1.0)
    poses = rig.poses(np.random.default_rng(0), Tower(), 8)
    eyes = [-pose[:3, :3].T @ pose[:3, 3] for pose in poses]
    assert min(Tower().clearance(eye) for eye in eyes) > 0.15


def test_a_tube_skips_points_that_stand_still() -> None:
    """A cable's path, held back at the edge of a table, stays at one place for several points."""
    path = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 1e-12, 0], [1, 1, 0]])
    expected = mesh.tube(path[[0, 1, 4]], 0.1)
    found = mesh.tube(path, 0.1)
    for name in ("positions", "normals", "uv"):
        assert np.isfinite(getattr(expected, name)).all()
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
