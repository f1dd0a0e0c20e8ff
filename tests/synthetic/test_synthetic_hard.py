"""The harder rooms and the rippled depth: what they add must be there, and nothing else may change."""

from __future__ import annotations

import functools
import hashlib

import numpy as np
import pytest
import torch
from synthetic_scenes import CLEAN, TINY, surface_of

from torchjoint.synthetic import make_scene
from torchjoint.synthetic.mesh import box
from torchjoint.synthetic.room import make_world
from torchjoint.synthetic.sensor import rippled
from torchjoint.synthetic.world import KINDS, Item, World

o3d = pytest.importorskip("open3d", reason="Open3D measures distances to a surface")

SEEDS = (0, 7)
#: What only harder rooms have.
ADDED = {
    "card", "envelope", "folder", "mat", "doormat", "notice", "panel", "hatch", "pillar", "rail", "coat stand", "plant",
    "clothes rail", "crate", "basket", "drawer",
}  # fmt: skip


@functools.cache
def room(seed: int, hard: bool = True) -> World:
    return make_world(np.random.default_rng(seed), hardship=np.random.default_rng([seed, 1]) if hard else None)


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
    """Other figures rest on the rooms as they were. Rounded, for another processor may round otherwise."""

    @pytest.mark.parametrize(
        ("seed", "names", "triangles", "points", "image"),
        [
            (0, "a96b7c9089ddd898", 11876, [0.0939, -0.59163, 0.61242], 0.494455),
            (3, "7cdaf91cc6947214", 8272, [0.29795, 0.56513, 0.63521], 0.452331),
            (100, "c7a6d57199ef46c2", 7988, [-0.00101, -0.86474, 0.67847], 0.443676),
        ],
    )
    def test_the_rooms_are_what_they_were(self, seed, names, triangles, points, image) -> None:
        scene = make_scene(seed, **{**TINY, "num_points": 2000})
        assert hashlib.sha256("".join(scene.instance_names).encode()).hexdigest()[:16] == names
        assert len(scene.triangles) == triangles
        assert scene.scene.points.double().mean(0).tolist() == pytest.approx(points, abs=1e-3)
        assert scene.scene.frames[1].image.double().mean().item() == pytest.approx(image, abs=1e-4)

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


class TestKinds:
    @pytest.mark.parametrize(
        ("size", "hollow", "kind"),
        [
            ((0.2, 0.3, 0.015), False, "flat"),
            ((0.2, 0.002, 0.3), False, "flat"),
            ((0.2, 0.3, 0.016), False, "other"),
            ((0.01, 0.2, 0.3), False, "other"),  # a book that stands
            ((0.2, 0.3, 0.1), True, "concave"),
        ],
    )
    def test_kind(self, size, hollow, kind) -> None:
        assert Item("thing", size, [], hollow=hollow).kind == kind

    def test_every_instance_has_one(self) -> None:
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


DEPTH = np.full((120, 160), 2.0, dtype=np.float32)


@pytest.fixture(scope="module")
def errors() -> np.ndarray:
    """[80, 120, 160] of the inverse depth."""
    return np.stack([1 / rippled(np.random.default_rng(s), DEPTH, 0.002) - 0.5 for s in range(80)])


class TestRipple:
    def test_size_and_mean(self, errors: np.ndarray) -> None:
        steps = 1.4 * 0.002
        assert errors.std() == pytest.approx(np.hypot(0.002, steps / np.sqrt(12)), rel=0.05)
        assert abs(errors.mean()) < 3 * errors.mean(axis=(1, 2)).std() / np.sqrt(80)

    def test_neighbours_share_it_and_views_do_not(self, errors: np.ndarray) -> None:
        def alike(a: np.ndarray, b: np.ndarray) -> float:
            return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])

        assert alike(errors[:, :, 1:], errors[:, :, :-1]) > 0.8
        assert alike(errors[:, 1:], errors[:, :-1]) > 0.8
        assert 0.3 < alike(errors[:, :, 12:], errors[:, :, :-12]) < 0.8
        assert abs(alike(errors[1:], errors[:-1])) < 0.1

    def test_it_grows_with_the_square_of_the_depth(self) -> None:
        near, far = (rippled(np.random.default_rng(0), depth, 0.002) - depth for depth in (DEPTH, 2 * DEPTH))
        assert far.std() / near.std() == pytest.approx(4, rel=0.1)

    def test_holes_stay(self) -> None:
        holed = DEPTH.copy()
        holed[10:20] = 0
        assert np.array_equal(rippled(np.random.default_rng(0), holed, 0.01) == 0, holed == 0)

    @pytest.mark.slow
    def test_fused_walls_are_thicker(self) -> None:
        flat, wavy = (make_scene(3, **CLEAN, depth_ripple=ripple) for ripple in (0.0, 0.002))
        assert torch.equal(flat.scene.frames[0].image, wavy.scene.frames[0].image)
        assert torch.equal(flat.triangles, wavy.triangles)
        thick = [
            np.quantile(surface_of(scene).compute_distance(o3d.core.Tensor(scene.scene.points.numpy())).numpy(), 0.5)
            for scene in (flat, wavy)
        ]
        assert thick[0] < 0.0005
        assert 0.002 < thick[1] < 0.02

    def test_the_range(self) -> None:
        with pytest.raises(ValueError, match=r"^depth_ripple: expected 0 to 0\.05 \(metres at 1 m\), got 0\.1"):
            make_scene(0, **TINY, depth_ripple=0.1)


def test_boxes_have_the_largest_faces_below() -> None:
    """What :class:`TestHard` takes for granted: two of a flat box's four large triangles are its lower side."""
    assert (box((0.2, 0.3, 0.001)).positions[..., 2].max(axis=1) == 0).sum() == 2
