"""The scenes of most tests: their truth must be the truth, and their difficulties what they are said to be."""

import numpy as np
import pytest
import torch

from torchjoint.synthetic import make_scene
from torchjoint.synthetic.room import box, dot, lathe
from torchjoint.synthetic.scene import SIZES

CLEAN = {"pose_error": 0.0, "depth_noise": 0.0, "depth_holes": 0.0, "image_noise": 0.0}
TINY = {"num_views": 2, "height": 48, "width": 64, "num_points": 300}


@pytest.fixture(scope="module")
def noisy():
    return make_scene(3)


@pytest.fixture(scope="module")
def clean(scene_of):
    return scene_of(3, **CLEAN)


def first_hits(triangles, origin, rays):
    """The first triangle [R] that each ray hits, and the distance in lengths of the ray; a slow twin (Moeller)."""
    corner, one, two = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    across = torch.linalg.cross(rays[:, None], two[None])
    scale = (across * one).sum(-1)
    to_eye = origin - corner
    u = (across * to_eye).sum(-1) / scale
    turned = torch.linalg.cross(to_eye, one)
    v = (turned * rays[:, None]).sum(-1) / scale
    distance = (turned * two).sum(-1) / scale
    hit = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (distance > 0)
    distance, triangle = torch.where(hit, distance, torch.inf).min(1)
    return triangle, distance


class TestTruth:
    def test_depth_and_labels_are_those_of_the_triangles(self, clean):
        frame, pose = clean.scene.frames[2], clean.true_world_to_camera[2]
        pixel = torch.randperm(120 * 160, generator=torch.Generator().manual_seed(0))[:500]
        row, column = pixel // 160, pixel % 160
        ahead = torch.stack([column, row, torch.ones(500)], 1).double() @ torch.linalg.inv(frame.intrinsics).T
        eye = -pose[:3, :3].T @ pose[:3, 3]
        triangle, depth = first_hits(clean.triangles.double(), eye, ahead @ pose[:3, :3])
        labels = clean.triangle_labels[triangle].where(depth < torch.inf, -1)
        same = labels == clean.image_labels[2][row, column]
        assert same.float().mean() > 0.995  # within a rounding of float32 of an edge
        assert torch.allclose(depth[same].nan_to_num(posinf=0), frame.depth[row, column][same].double(), atol=1e-4)
        assert len(labels.unique()) > 10

    def test_points_are_those_of_pixels(self, clean):
        """Each point is in an image where its depth, its label and its colour are those of its pixel."""
        found = torch.zeros(len(clean.point_labels), dtype=torch.bool)
        for frame, labels in zip(clean.scene.frames, clean.image_labels, strict=True):
            seen = clean.scene.points.double() @ frame.world_to_camera[:3, :3].T + frame.world_to_camera[:3, 3]
            column, row = ((seen @ frame.intrinsics.T)[:, :2] / seen[:, 2:]).round().long().unbind(1)
            inside = (seen[:, 2] > 0) & (row >= 0) & (row < 120) & (column >= 0) & (column < 160)
            row, column = row.clamp(0, 119), column.clamp(0, 159)
            same = (frame.depth[row, column] - seen[:, 2]).abs() < 1e-4
            same &= labels[row, column] == clean.point_labels
            found |= inside & same & (clean.scene.colors == frame.image[:, row, column].T).all(1)
        assert found.all()

    def test_the_surface_is_closed_and_faces_outward(self, clean):
        for solid, volume in ((box(2.0, 3.0, 4.0), 24.0), (lathe([(1.0, 0.0), (1.0, 2.0)], 64), 2 * np.pi)):
            triangles = solid.moved((5.0, 6.0, 7.0), 0.3).triangles().transpose(1, 2, 0).astype(float)
            parts = dot(triangles[0], np.cross(triangles[1], triangles[2], axis=0)) / 6
            assert parts.sum() == pytest.approx(volume, rel=0.01)

    def test_every_instance_has_a_name_and_a_kind(self, noisy):
        names = noisy.instance_names
        assert {"floor", "wall", "table", "chair"} <= set(names)
        assert names.count("wall") == 4
        assert len(names) == len(noisy.instance_kinds)
        assert torch.equal(noisy.triangle_labels.unique(), torch.arange(len(names)))
        assert noisy.scene.truth.kinds == {i: kind for i, kind in enumerate(noisy.instance_kinds) if kind != "other"}
        assert set(noisy.instance_kinds) == {"flat", "concave", "other"}
        assert all(int(labels.min()) >= -1 and int(labels.max()) < len(names) for labels in noisy.image_labels)

    def test_it_is_cluttered(self, noisy):
        assert (torch.bincount(noisy.point_labels) >= 10).sum() >= 12
        assert all(len(labels.unique()) >= 6 for labels in noisy.image_labels)


class TestShape:
    def test_small_is_as_documented(self, noisy):
        scene = noisy.scene
        assert scene.points.shape == scene.colors.shape == (6_000, 3)
        assert scene.normals is None
        assert noisy.point_labels.shape == (6_000,)
        assert len(scene.frames) == len(noisy.image_labels) == len(noisy.true_world_to_camera) == 6
        for i, (frame, labels) in enumerate(zip(scene.frames, noisy.image_labels, strict=True)):
            assert frame.size == tuple(labels.shape) == tuple(frame.depth.shape) == (120, 160)
            assert labels.dtype == torch.int64
            assert frame.name == f"frame-{i:06d}"
            width = 2 * torch.rad2deg(torch.atan(80 / frame.intrinsics[0, 0])).item()
            assert width == pytest.approx(57, abs=0.1)

    def test_other_sizes(self):
        assert SIZES["medium"][:4] == (20, 240, 320, 40_000)
        assert SIZES["large"][:4] == (60, 480, 640, 150_000)
        medium = make_scene(0, "medium", num_views=2)
        assert medium.scene.points.shape == (40_000, 3)
        assert medium.scene.frames[1].size == (240, 320)

    def test_overrides(self):
        tiny = make_scene(1, **{**TINY, "num_views": 1})
        assert [frame.size for frame in tiny.scene.frames] == [(48, 64)]
        assert len(tiny.scene.points) == 300


class TestSeed:
    def test_same_seed_same_scene(self, noisy):
        again = make_scene(3)
        assert torch.equal(again.scene.points, noisy.scene.points)
        assert torch.equal(again.scene.colors, noisy.scene.colors)
        assert torch.equal(again.point_labels, noisy.point_labels)
        assert again.instance_names == noisy.instance_names
        for one, other in zip(again.scene.frames, noisy.scene.frames, strict=True):
            assert torch.equal(one.image, other.image)
            assert torch.equal(one.depth, other.depth)
            assert torch.equal(one.world_to_camera, other.world_to_camera)

    def test_seeds_differ(self):
        one, other = make_scene(1, **TINY), make_scene(2, **TINY)
        assert one.triangles.shape != other.triangles.shape
        assert (one.scene.frames[0].image - other.scene.frames[0].image).abs().mean() > 0.05

    def test_difficulties_do_not_change_the_rest(self, noisy, clean):
        assert torch.equal(noisy.triangles, clean.triangles)
        assert all(map(torch.equal, noisy.image_labels, clean.image_labels))
        assert all(map(torch.equal, noisy.true_world_to_camera, clean.true_world_to_camera))


class TestSensor:
    def test_depth_noise_grows_with_distance(self, clean):
        spoilt = make_scene(3, **{**CLEAN, "depth_noise": 0.0015})
        truth = torch.stack([frame.depth for frame in clean.scene.frames])
        error = (torch.stack([frame.depth for frame in spoilt.scene.frames]) - truth) / truth.square()
        assert error[(truth > 0.5) & (truth < 1.5)].std() == pytest.approx(0.0015, rel=0.1)
        assert error[truth > 2.5].std() == pytest.approx(0.0015, rel=0.1)

    def test_holes(self, noisy, clean):
        holes = torch.stack([frame.depth == 0 for frame in noisy.scene.frames])
        assert 0.003 < holes.float().mean() < 0.3
        nothing = torch.stack([labels == -1 for labels in clean.image_labels])
        assert torch.equal(torch.stack([frame.depth == 0 for frame in clean.scene.frames]), nothing)

    def test_pose_error(self, noisy, clean):
        for scene, low, high in ((clean, 0, 1e-12), (noisy, 0.0005, 0.02)):
            for true, frame in zip(scene.true_world_to_camera, scene.scene.frames, strict=True):
                eyes = [torch.linalg.inv(pose)[:3, 3] for pose in (true, frame.world_to_camera)]
                assert low <= torch.linalg.norm(eyes[0] - eyes[1]) <= high

    def test_image_noise_is_fresh_in_each_image(self, clean):
        grainy = make_scene(3, **{**CLEAN, "image_noise": 0.02})
        noise = [one.image - two.image for one, two in zip(grainy.scene.frames, clean.scene.frames, strict=True)]
        assert 0.012 < noise[0].std() < 0.022
        assert not torch.equal(noise[0], noise[1])

    def test_density_is_uneven(self, noisy):
        cells = np.unique(np.floor(noisy.scene.points.numpy() / 0.2).astype(int), axis=0, return_counts=True)[1]
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
    ],
)
def test_bad_arguments_are_named(argument, value):
    with pytest.raises(ValueError, match=f"^{argument}: expected"):
        make_scene(**{"num_views": 1, "height": 32, "width": 32, argument: value})
