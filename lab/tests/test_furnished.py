"""Furnished rooms are what benchmarks and trainings rest on: their truth must be the truth."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import torch
from synthetic_scenes import CLEAN, TINY, surface_of
from torchjoint_lab.synthetic.furnished import make_scene
from torchjoint_lab.synthetic.furnished.scene import SIZES

from torchjoint.synthetic import SyntheticScene

o3d = pytest.importorskip("open3d", reason="Open3D measures distances to a surface")


scene_of = functools.cache(make_scene)


@pytest.fixture(scope="module")
def noisy() -> SyntheticScene:
    return scene_of(3)


@pytest.fixture(scope="module")
def clean() -> SyntheticScene:
    return scene_of(3, **CLEAN)


def _pixels(frame, points: torch.Tensor, pose: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """Index of the points whose nearest pixel sees them within 1 cm; that pixel's row and column."""
    camera = points.double() @ pose[:3, :3].T + pose[:3, 3]
    image = camera @ frame.intrinsics.T
    column, row = (image[:, :2] / image[:, 2:]).round().long().unbind(1)
    height, width = frame.size
    inside = (camera[:, 2] > 0.1) & (row >= 0) & (row < height) & (column >= 0) & (column < width)
    index = inside.nonzero()[:, 0]
    row, column = row[index], column[index]
    near = (camera[index, 2] - frame.depth[row, column]).abs() < 0.01
    return index[near], row[near], column[near]


class TestShape:
    def test_small_is_as_documented(self, noisy: SyntheticScene) -> None:
        scene = noisy.scene
        assert scene.points.shape == scene.colors.shape == (6_000, 3)
        assert scene.normals is None
        assert noisy.point_labels.shape == (6_000,)
        assert noisy.point_labels.dtype == torch.int64
        assert len(scene.frames) == len(noisy.image_labels) == len(noisy.true_world_to_camera) == 6
        for i, (frame, labels) in enumerate(zip(scene.frames, noisy.image_labels, strict=True)):
            assert frame.size == tuple(labels.shape) == tuple(frame.depth.shape) == (120, 160)
            assert labels.dtype == torch.int64
            assert frame.name == f"frame-{i:06d}"
            assert frame.labels is None
            width = 2 * torch.rad2deg(torch.atan(80 / frame.intrinsics[0, 0])).item()
            assert width == pytest.approx(57, abs=0.1)

    def test_other_sizes(self) -> None:
        assert SIZES["medium"][:4] == (20, 240, 320, 40_000)
        assert SIZES["large"][:4] == (60, 480, 640, 150_000)
        medium = make_scene(0, "medium", num_views=2)
        assert medium.scene.points.shape == (40_000, 3)
        assert medium.scene.frames[1].size == (240, 320)

    def test_overrides(self) -> None:
        tiny = make_scene(1, **TINY)
        assert len(tiny.scene.frames) == 2
        assert tiny.scene.frames[0].size == (48, 64)
        assert len(tiny.scene.points) == 300
        assert len(make_scene(1, **{**TINY, "num_views": 1}).scene.frames) == 1

    def test_every_instance_has_a_name(self, noisy: SyntheticScene) -> None:
        ids = torch.cat([noisy.point_labels, *(labels.flatten() for labels in noisy.image_labels)])
        assert ids.min() >= -1
        assert ids.max() < len(noisy.instance_names)
        assert all(noisy.instance_names)
        assert {"floor", "wall", "table", "chair"} <= set(noisy.instance_names)
        assert noisy.instance_names.count("wall") == 4
        assert torch.equal(noisy.triangle_labels.unique(), torch.arange(len(noisy.instance_names)))

    def test_it_is_cluttered(self, noisy: SyntheticScene) -> None:
        assert (torch.bincount(noisy.point_labels) >= 10).sum() >= 12
        assert all(len(labels.unique()) >= 6 for labels in noisy.image_labels)


class TestSeed:
    def test_same_seed_same_scene(self, noisy: SyntheticScene) -> None:
        again = make_scene(3)
        assert torch.equal(again.scene.points, noisy.scene.points)
        assert torch.equal(again.scene.colors, noisy.scene.colors)
        assert torch.equal(again.point_labels, noisy.point_labels)
        assert again.instance_names == noisy.instance_names
        for one, other in zip(again.scene.frames, noisy.scene.frames, strict=True):
            assert torch.equal(one.image, other.image)
            assert torch.equal(one.depth, other.depth)
            assert torch.equal(one.world_to_camera, other.world_to_camera)

    def test_seeds_differ(self) -> None:
        one, other = make_scene(1, **TINY), make_scene(2, **TINY)
        assert one.triangles.shape != other.triangles.shape
        assert (one.scene.frames[0].image - other.scene.frames[0].image).abs().mean() > 0.05

    def test_difficulties_do_not_change_the_rest(self, noisy: SyntheticScene, clean: SyntheticScene) -> None:
        assert torch.equal(noisy.triangles, clean.triangles)
        for one, other in zip(noisy.image_labels, clean.image_labels, strict=True):
            assert torch.equal(one, other)


class TestTruth:
    def test_points_land_on_pixels_of_their_label(self, clean: SyntheticScene) -> None:
        agree = total = 0
        seen = torch.zeros(len(clean.point_labels), dtype=torch.bool)
        for frame, labels in zip(clean.scene.frames, clean.image_labels, strict=True):
            index, row, column = _pixels(frame, clean.scene.points, frame.world_to_camera)
            seen[index] = True
            windows = torch.nn.functional.pad(labels[None, None].double(), (1, 1, 1, 1), mode="replicate")
            windows = windows.unfold(2, 3, 1).unfold(3, 3, 1)[0, 0].flatten(2)[row, column]
            inner = (windows == windows[:, :1]).all(dim=1)  # within a pixel of a border, either label is right
            agree += int((labels[row, column] == clean.point_labels[index])[inner].sum())
            total += int(inner.sum())
        assert total > 6_000
        assert agree / total > 0.99
        assert seen.float().mean() > 0.95

    def test_clean_points_lie_on_their_surface(self, clean: SyntheticScene) -> None:
        nearest = surface_of(clean).compute_closest_points(o3d.core.Tensor(clean.scene.points.numpy()))
        distance = (torch.from_numpy(nearest["points"].numpy()) - clean.scene.points).norm(dim=1)
        labels = clean.triangle_labels[torch.from_numpy(nearest["primitive_ids"].numpy().astype(np.int64))]
        assert distance.quantile(0.99) < 0.001
        # 1 mm of paper, and two things that touch, leave the nearest surface open to chance
        assert (labels == clean.point_labels).float().mean() > 0.98

    def test_depth_and_labels_are_those_of_pixel_centres(self, clean: SyntheticScene) -> None:
        frame, pose = clean.scene.frames[2], clean.true_world_to_camera[2]
        grid = torch.stack(torch.meshgrid(torch.arange(160.0), torch.arange(120.0), indexing="xy"), dim=-1)
        ray = torch.cat([grid, torch.ones(120, 160, 1)], dim=-1).double() @ torch.linalg.inv(frame.intrinsics).T
        ray = ray @ pose[:3, :3]
        eye = (-pose[:3, :3].T @ pose[:3, 3]).expand_as(ray)
        rays = torch.cat([eye, ray], dim=-1).float().numpy()
        hit = surface_of(clean).cast_rays(o3d.core.Tensor(rays))
        labels = clean.triangle_labels[torch.from_numpy(hit["primitive_ids"].numpy().astype(np.int64))]
        assert (labels == clean.image_labels[2]).float().mean() > 0.999
        error = (torch.from_numpy(hit["t_hit"].numpy()) - frame.depth).abs()
        assert (error < 1e-3).float().mean() > 0.999

    def test_points_have_the_colours_of_the_images(self, clean: SyntheticScene) -> None:
        frame = clean.scene.frames[0]
        index, row, column = _pixels(frame, clean.scene.points, frame.world_to_camera)
        difference = (frame.image[:, row, column].T - clean.scene.colors[index]).abs().mean(dim=1)
        assert difference.median() < 0.06


class TestSensor:
    def test_depth_noise_grows_with_distance(self, clean: SyntheticScene) -> None:
        spoilt = scene_of(3, **{**CLEAN, "depth_noise": 0.0015})
        truth = torch.stack([frame.depth for frame in clean.scene.frames])
        error = torch.stack([frame.depth for frame in spoilt.scene.frames]) - truth
        near, far = (truth > 0.5) & (truth < 1.5), truth > 2.5
        assert 0.0005 < error[near].std() < 0.004
        assert error[far].std() > 3 * error[near].std()
        assert (error.abs() < 8 * 0.0015 * truth.square() + 1e-6).all()

    def test_noisy_points_lie_within_the_noise(self) -> None:
        spoilt = scene_of(3, **{**CLEAN, "depth_noise": 0.0015})
        distance = surface_of(spoilt).compute_distance(o3d.core.Tensor(spoilt.scene.points.numpy())).numpy()
        assert 0.0005 < np.median(distance) < 0.008
        assert distance.max() < 6 * 0.0015 * 5**2

    def test_holes(self, noisy: SyntheticScene, clean: SyntheticScene) -> None:
        holes = torch.stack([frame.depth == 0 for frame in noisy.scene.frames]).float().mean()
        assert 0.003 < holes < 0.3
        assert all((frame.depth > 0).all() for frame in clean.scene.frames)

    def test_pose_error(self, noisy: SyntheticScene, clean: SyntheticScene) -> None:
        for truth, scene in ((clean.true_world_to_camera, clean), (noisy.true_world_to_camera, noisy)):
            offsets = [
                torch.linalg.norm(torch.linalg.inv(pose)[:3, 3] - torch.linalg.inv(frame.world_to_camera)[:3, 3])
                for pose, frame in zip(truth, scene.scene.frames, strict=True)
            ]
            assert max(offsets) == 0 if scene is clean else 0.0005 < max(offsets) < 0.02

    @pytest.mark.slow
    def test_exposure_and_noise_vary_between_views(self, clean: SyntheticScene) -> None:
        exposed = make_scene(3, **{**CLEAN, "exposure": 0.15})
        ratio = torch.tensor(
            [
                (one.image.mean() / other.image.mean()).item()
                for one, other in zip(exposed.scene.frames, clean.scene.frames, strict=True)
            ]
        )
        assert ratio.std() > 0.02
        grainy = make_scene(3, **{**CLEAN, "image_noise": 0.02})
        noise = [one.image - other.image for one, other in zip(grainy.scene.frames, clean.scene.frames, strict=True)]
        assert 0.012 < noise[0].std() < 0.022
        assert not torch.equal(noise[0], noise[1])

    def test_blur_smears(self) -> None:
        sharp, blurred = (make_scene(3, **{**CLEAN, **TINY, "motion_blur": b}) for b in (0.0, 20.0))
        steps = [torch.stack([f.image.diff(dim=2).abs().mean() for f in s.scene.frames]) for s in (sharp, blurred)]
        assert (steps[1] < steps[0]).any()
        assert (steps[1] <= steps[0] + 1e-3).all()

    def test_shadows_and_textures(self, clean: SyntheticScene) -> None:
        image = clean.scene.frames[1].image
        lit = make_scene(3, **CLEAN, shadows=False).scene.frames[1].image
        flat = make_scene(3, **CLEAN, textures=False).scene.frames[1].image
        assert (image - lit).abs().mean() > 0.01
        assert flat.diff(dim=2).abs().mean() < 0.8 * image.diff(dim=2).abs().mean()

    def test_density_is_uneven(self, noisy: SyntheticScene) -> None:
        points = noisy.scene.points.numpy()
        cells = np.unique(np.floor(points / 0.2).astype(int), axis=0, return_counts=True)[1]
        assert np.percentile(cells, 90) > 4 * np.percentile(cells, 10)


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("seed", -1),
        ("seed", 0.5),
        ("size", "huge"),
        ("num_views", 0),
        ("height", 8),
        ("width", 100.0),
        ("num_points", 0),
        ("num_points", True),
        ("num_points", 10_000_000),
        ("pose_error", -0.1),
        ("depth_noise", 1.0),
        ("depth_holes", 1.5),
        ("image_noise", float("nan")),
        ("motion_blur", -1.0),
        ("exposure", 2.0),
    ],
)
def test_bad_arguments_are_named(argument: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"^{argument}: expected"):
        make_scene(**{"num_views": 1, "height": 32, "width": 32, argument: value})
