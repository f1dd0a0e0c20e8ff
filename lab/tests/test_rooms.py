"""The rooms stay what they were, things have a kind, and rippled depth has the errors it should have."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
import torch
from synthetic_scenes import CLEAN, TINY, surface_of
from torchjoint_lab.synthetic.furnished import make_scene
from torchjoint_lab.synthetic.furnished.sensor import rippled
from torchjoint_lab.synthetic.furnished.world import Item

o3d = pytest.importorskip("open3d", reason="Open3D measures distances to a surface")


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
