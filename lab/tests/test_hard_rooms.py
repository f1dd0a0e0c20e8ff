"""The harder rooms: what they add must be there, and nothing else may change."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import torch
from synthetic_scenes import TINY, surface_of
from torchjoint_lab.synthetic import make_scene
from torchjoint_lab.synthetic.furnished.mesh import box
from torchjoint_lab.synthetic.furnished.room import make_world
from torchjoint_lab.synthetic.furnished.site import Site
from torchjoint_lab.synthetic.furnished.world import KINDS, World
from torchjoint_lab.synthetic.hard_rooms import harden

o3d = pytest.importorskip("open3d", reason="Open3D measures distances to a surface")

SEEDS = (0, 7)
#: What only harder rooms have.
ADDED = {
    "card", "envelope", "folder", "mat", "doormat", "notice", "panel", "hatch", "pillar", "rail", "coat stand", "plant",
    "clothes rail", "crate", "basket", "drawer",
}  # fmt: skip


@functools.cache
def room(seed: int, hard: bool = True) -> World:
    more = functools.partial(_harden, seed) if hard else None
    return make_world(np.random.default_rng(seed), furnish_more=more)


def _harden(seed: int, site: Site, focus: tuple[float, float, float, float]) -> None:
    harden(site, np.random.default_rng([seed, 1]), focus)


@pytest.fixture(scope="module")
def rooms() -> dict[int, World]:
    return {seed: room(seed) for seed in SEEDS}


def of_others(world: World, instance: int) -> o3d.t.geometry.RaycastingScene:
    corners = world.triangles[world.labels != instance].reshape(-1, 3)
    scene = o3d.t.geometry.RaycastingScene()
    faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(o3d.core.Tensor(np.ascontiguousarray(corners)), o3d.core.Tensor(faces))
    return scene


@pytest.mark.slow
class TestUnchanged:
    def test_nothing_that_was_there_moves(self, rooms: dict[int, World]) -> None:
        for seed in SEEDS:
            easy, hard = room(seed, False), rooms[seed]
            assert np.array_equal(hard.triangles[: len(easy.triangles)], easy.triangles)
            assert hard.names[: len(easy.names)] == easy.names
            assert hard.focus == easy.focus
            assert not ADDED & set(easy.names)

    def test_scenes(self) -> None:
        easy, hard = make_scene(4, **TINY), make_scene(4, **TINY, hard=True)
        assert torch.equal(hard.triangles[: len(easy.triangles)], easy.triangles)
        assert all(map(torch.equal, easy.true_world_to_camera, hard.true_world_to_camera))
        assert len(hard.instance_names) > len(easy.instance_names) + 15


class TestHard:
    def test_what_is_added(self, rooms: dict[int, World]) -> None:
        for seed, hard in rooms.items():
            before = len(room(seed, False).names)
            added = hard.kinds[before:]
            assert added.count("flat") >= 15
            assert added.count("concave") >= 3
            assert {"pillar", "notice", "crate"} <= set(hard.names[before:])

    def test_flat_things_lie_on_something(self, rooms: dict[int, World]) -> None:
        for world in rooms.values():
            for instance in [i for i, kind in enumerate(world.kinds) if kind == "flat"]:
                own = world.triangles[world.labels == instance]
                area = np.linalg.norm(np.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0]), axis=1)
                middles = own[area > 0.9 * area.max()].mean(axis=1)
                distance = of_others(world, instance).compute_distance(o3d.core.Tensor(middles)).numpy()
                assert np.sort(distance)[1] <= 0.015, world.names[instance]  # both halves of the lower side

    def test_none_goes_through_another(self, rooms: dict[int, World]) -> None:
        for seed, world in rooms.items():
            before = len(room(seed, False).names)
            for instance in [
                i for i, name in enumerate(world.names) if i >= before and name not in ("crate", "drawer")
            ]:
                own = world.triangles[world.labels == instance]
                middle = (own.min(axis=(0, 1)) + own.max(axis=(0, 1))) / 2
                inward = middle - own  # what touches does not go through: less 0.3 mm
                own = own + np.sign(inward) * np.minimum(np.abs(inward) / 2, 3e-4)
                start, end = own.reshape(-1, 3), np.roll(own, -1, axis=1).reshape(-1, 3)
                rays = np.concatenate([start, end - start], axis=1).astype(np.float32)
                hit = of_others(world, instance).test_occlusions(o3d.core.Tensor(rays), tnear=0.0, tfar=1.0).numpy()
                assert not hit.any(), (seed, world.names[instance])

    @pytest.mark.parametrize("seed", [SEEDS[0], *(pytest.param(seed, marks=pytest.mark.slow) for seed in SEEDS[1:])])
    def test_cameras_have_room(self, seed: int) -> None:
        scene = make_scene(seed, "small", num_points=100, height=16, width=16, hard=True, num_views=24)
        eyes = torch.stack([torch.linalg.inv(pose)[:3, 3] for pose in scene.true_world_to_camera])
        assert surface_of(scene).compute_distance(o3d.core.Tensor(eyes.float().numpy())).numpy().min() > 0.15

    def test_every_instance_has_a_kind(self) -> None:
        scene = make_scene(3, **TINY, hard=True)
        assert len(scene.instance_kinds) == len(scene.instance_names)
        assert set(scene.instance_kinds) == set(KINDS)
        by_name = dict(zip(scene.instance_names, scene.instance_kinds, strict=True))
        assert by_name["floor"] == by_name["wall"] == by_name["table"] == by_name["pillar"] == "other"
        assert by_name["notice"] == by_name["card"] == "flat"
        assert by_name["crate"] == "concave"
        special = {i: kind for i, kind in enumerate(scene.instance_kinds) if kind != "other"}
        assert scene.scene.truth is not None
        assert scene.scene.truth.kinds == special


def test_boxes_have_the_largest_faces_below() -> None:
    """What :class:`TestHard` takes for granted: two of a flat box's four large triangles are its lower side."""
    assert (box((0.2, 0.3, 0.001)).positions[..., 2].max(axis=1) == 0).sum() == 2
