"""Copies of points, their order, and the place of the origin change no label."""

import dataclasses

import pytest
import torch

import torchjoint as tj
from torchjoint.cloud.local import LocalFrame, composed, distinct_points, order_of_points, without_copies

METHODS = ["learned", "paper", "scan"]


@pytest.fixture(scope="module")
def scene(scene_of):
    return scene_of(4).scene


@pytest.fixture(scope="module")
def result_of(scene):
    known = {}

    def result(method):
        if method not in known:
            known[method] = segmented(scene, method)
        return known[method]

    return result


def config_of(method):
    own = ["paper.min_size=20"] if method == "paper" else []
    return tj.Config().set([f"point_segments.method={method}", *own, "boundary.detector=gradient"])


def segmented(scene, method="learned"):
    return tj.JointSegmenter(config_of(method))(scene)


def picked(scene, chosen):
    colors = None if scene.colors is None else scene.colors[chosen]
    return dataclasses.replace(scene, points=scene.points[chosen], colors=colors, truth=None)


def moved(scene, offset):
    """The scene around another origin, in float64."""
    back = torch.eye(4, dtype=torch.float64)
    back[:3, 3] = -offset
    frames = [dataclasses.replace(f, world_to_camera=f.world_to_camera @ back) for f in scene.frames]
    return dataclasses.replace(scene, points=scene.points.double() + offset, frames=frames)


def assert_same(one, other):
    assert torch.equal(one.points, other.points)
    assert all(torch.equal(*pair) for pair in zip(one.images, other.images, strict=True))


class TestCopies:
    @pytest.mark.parametrize("method", METHODS)
    @pytest.mark.parametrize("times", [2, pytest.param(30, marks=pytest.mark.slow)])
    def test_each_point_several_times(self, scene, result_of, method, times):
        number = torch.arange(len(scene.points)).repeat(times)
        result = segmented(picked(scene, number), method)
        plain = result_of(method)
        assert torch.equal(result.points, plain.points[number])
        assert all(torch.equal(*pair) for pair in zip(result.images, plain.images, strict=True))

    def test_padding_by_repetition(self, scene, result_of):
        count = len(scene.points)
        number = torch.cat([torch.arange(count), torch.full((20_000,), 17)])
        assert torch.equal(segmented(picked(scene, number)).points, result_of("learned").points[number])

    def test_superpoints_of_a_sample_with_replacement(self, scene):
        plain = tj.superpoints(scene.points, scene.colors)
        count = len(plain)
        drawn = torch.randint(count, (5 * count,), generator=torch.Generator().manual_seed(0))
        number = torch.cat([torch.arange(count), drawn])
        assert torch.equal(tj.superpoints(scene.points[number], scene.colors[number]), plain[number])

    @pytest.mark.parametrize("method", ["learned", "paper"])
    def test_points_within_a_cube(self, scene, method):
        """Nearly equal points, as of scans that overlap: each pair counts as one point, and gets one label."""
        segmenter = tj.JointSegmenter(config_of(method), merge_within=0.01)
        count = len(scene.points)
        jitter = 1e-5 * torch.randn(count, 3, generator=torch.Generator().manual_seed(0))
        both = torch.cat([scene.points, scene.points + jitter])
        twice = tj.Scene(both, scene.frames, colors=scene.colors.repeat(2, 1))
        result = segmenter(twice)
        assert segmenter.graph.num_points < 1.02 * count
        assert (result.points[:count] == result.points[count:]).float().mean() > 0.99
        assert result.points[0] == 0
        assert int((result.points[1:] - torch.cummax(result.points, 0).values[:-1]).max()) <= 1

    def test_a_cube_that_cannot_be(self):
        with pytest.raises(ValueError, match="merge_within: expected metres >= 0, got -1"):
            tj.JointSegmenter(merge_within=-1.0)

    def test_viewpoints_and_normals_of_copies(self, scene):
        normals = torch.nn.functional.normalize(scene.points - scene.points.mean(0), dim=1)
        eye = scene.points.new_tensor([0.0, 0, 2]).expand(len(normals), 3)
        number = torch.arange(len(normals)).repeat(3)
        for given in ({"normals": normals}, {"viewpoint": eye}):
            plain = tj.superpoints(scene.points, **given)
            copies = {name: value[number] for name, value in given.items()}
            assert torch.equal(tj.superpoints(scene.points[number], **copies), plain[number])

    def test_distinct_points_by_hand(self):
        points = torch.tensor([[1.0, 2, 3], [0, 0, 0], [1, 2, 3], [-0.0, 0, 0], [1, 2, 4]])
        assert distinct_points(points).tolist() == [0, 1, 0, 1, 2]
        assert distinct_points(points[[0, 1, 4]]) is None
        assert distinct_points(torch.zeros(4, 3)).tolist() == [0, 0, 0, 0]

    def test_the_size_of_blocks_changes_nothing(self, monkeypatch):
        points = torch.rand(400, 3, generator=torch.Generator().manual_seed(0)) + 5

        def results():
            frame = LocalFrame.of(points)
            return (
                frame.origin,
                frame.cloud(tj.Scene(points)).points,
                [distinct_points(torch.cat([points, points[i : i + 1]])) for i in range(0, 400, 40)],
            )

        origin, local, found = results()
        assert torch.equal(origin, points.double().median(0).values)
        assert all(one[-1] == 40 * i for i, one in enumerate(found))
        monkeypatch.setattr("torchjoint.cloud.local.BLOCK", 64)
        assert distinct_points(points) is None
        for one, other in zip(results(), (origin, local, found), strict=True):
            assert all(map(torch.equal, one, other))

    def test_distinct_points_of_equal_codes(self, monkeypatch):
        """Numbers that do not tell points apart: they are sorted by coordinates."""
        monkeypatch.setattr("torchjoint.cloud.local._codes", lambda rows: (rows[:, 0] * 0).astype("uint64"))
        points = torch.randint(3, (60, 3), generator=torch.Generator().manual_seed(0)).double()
        expected, first = torch.unique(points, dim=0, return_inverse=True)
        found = distinct_points(points)
        assert int(found.max()) + 1 == len(expected)
        assert torch.equal(found[:, None] == found, first[:, None] == first)
        assert found[0] == 0
        assert int((found[1:] - torch.cummax(found, 0).values[:-1]).max()) == 1  # by first appearance

    def test_colours_of_copies_are_averaged(self):
        points = torch.tensor([[0.0, 0, 0], [0, 0, 0], [1, 0, 0]])
        colors = torch.tensor([[0.0, 0, 0], [1, 0.5, 0], [0, 0, 1]])
        merged, of_point = without_copies(tj.Scene(points, colors=colors))
        assert merged.colors.tolist() == [[0.5, 0.25, 0], [0, 0, 1]]
        assert of_point.tolist() == [0, 0, 1]

    def test_maps_are_applied_in_turn(self):
        assert composed(None, None) is None
        first, second = torch.tensor([0, 1, 1]), torch.tensor([4, 7])
        assert composed(first, second).tolist() == [4, 7, 7]
        assert composed(first, None) is composed(None, first) is first


class TestOrder:
    @pytest.mark.parametrize("method", METHODS)
    def test_it_changes_no_segment_of_points_and_pixels(self, scene, result_of, method):
        order = torch.randperm(len(scene.points), generator=torch.Generator().manual_seed(4))
        shuffled, plain = segmented(picked(scene, order), method), result_of(method)
        number = torch.full((plain.num_point_segments,), -1)
        number[plain.points[order]] = shuffled.points  # the same segments with other numbers
        assert torch.equal(number[plain.points[order]], shuffled.points)
        assert sorted(number.tolist()) == list(range(shuffled.num_point_segments))
        for image, expected in zip(shuffled.images, plain.images, strict=True):
            has_points = (expected >= 0) & (expected < len(number))
            assert torch.equal(torch.where(has_points, number[expected.clamp(0, len(number) - 1)], expected), image)

    def test_nor_a_level_of_the_hierarchy(self, scene, result_of):
        order = torch.arange(len(scene.points)).flip(0)
        shuffled, plain = segmented(picked(scene, order)), result_of("learned")
        for granularity in (0.2, 0.8):
            one, other = shuffled.at(granularity), plain.at(granularity)
            pairs = torch.unique(torch.stack([one.points, other.points[order]]), dim=1)
            assert pairs.shape[1] == one.num_point_segments == other.num_point_segments
            for image, expected in zip(one.images, other.images, strict=True):
                assert torch.equal(image >= one.num_point_segments, expected >= one.num_point_segments)

    def test_points_have_an_order_of_their_own(self):
        points = torch.rand(500, 3, generator=torch.Generator().manual_seed(0)) - 0.5
        points[1] = points[0] + 1e-9 * torch.tensor([0.0, 0.0, 1.0])  # may fall in one cell, or be a copy
        points = torch.unique(points, dim=0)
        expected = points[order_of_points(points)]
        for seed in range(3):
            shuffled = points[torch.randperm(len(points), generator=torch.Generator().manual_seed(seed))]
            assert torch.equal(shuffled[order_of_points(shuffled)], expected)
        corners = torch.cartesian_prod(torch.arange(2.0), torch.arange(2.0), torch.arange(2.0))
        assert torch.equal(order_of_points(corners), torch.arange(8))

    def test_points_in_one_cell_are_ordered_by_coordinates(self):
        near = torch.tensor([[0.0, 0.0, 2e-9], [0.0, 0.0, 1e-9], [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
        assert order_of_points(near).tolist() == [3, 1, 0, 2]
        assert order_of_points(torch.zeros(1, 3)).tolist() == [0]


class TestOrigin:
    @pytest.mark.parametrize("method", ["learned", pytest.param("paper", marks=pytest.mark.slow)])
    @pytest.mark.parametrize("offset", [(8000.0, -1000.0, 256.0), (500_000.0, 5_400_000.0, 0.0)])
    def test_it_changes_no_label(self, scene, result_of, method, offset):
        there = moved(scene, torch.tensor(offset, dtype=torch.float64))
        assert there.points.dtype == torch.float64
        assert_same(segmented(there, method), result_of(method))

    def test_nor_a_superpoint(self, scene):
        offset = torch.tensor([500_000.0, 5_400_000.0, 100.0], dtype=torch.float64)
        eye = torch.tensor([0.0, 0, 2], dtype=torch.float64)
        here = tj.superpoints(scene.points, scene.colors, viewpoint=eye)
        there = tj.superpoints(scene.points.double() + offset, scene.colors, viewpoint=eye + offset)
        assert torch.equal(here, there)

    def test_offsets_that_float64_rounds_change_next_to_nothing(self, scene, result_of):
        offset = torch.tensor([512_345.678_9, 5_412_345.432_1, 123.456_7], dtype=torch.float64)
        result = segmented(moved(scene, offset))
        assert tj.metrics.segmentation_covering(result.points, result_of("learned").points).symmetric > 0.99

    def test_float32_that_was_rounded_is_told(self, scene):
        far = (scene.points.double() + 1e6).float()  # 6 cm
        with pytest.warns(UserWarning, match=r"points: coordinates keep only 0\.12 m, but neighbours are"):
            tj.JointSegmenter().reset(far)
        with pytest.warns(UserWarning, match="pass float64"):
            tj.superpoints(far)

    @pytest.mark.parametrize("offset", [0.0, 4e6])
    def test_what_was_rounded_before_is_told(self, scene, offset):
        """Float64 of numbers that had been float32, far from the origin, was segmented in silence."""
        rounded = (scene.points.double() / 0.1).round() * 0.1 + offset
        with pytest.warns(UserWarning, match=r"points: coordinates keep only 0\.1 m, but neighbours are 0\.1"):
            tj.JointSegmenter().reset(rounded)
        with pytest.warns(UserWarning, match="coordinates keep only"):
            tj.superpoints(rounded)

    def test_copies_are_no_rounding(self, scene, recwarn):
        tj.superpoints(scene.points.repeat(3, 1))
        assert not recwarn.list

    def test_the_frame_moves_with_the_cloud(self):
        points = torch.rand(1001, 3, generator=torch.Generator().manual_seed(0))
        points[0] = 1e6  # a wild point does not count
        offset = torch.tensor([1e6, -(2.0**22), 3], dtype=torch.float64)
        here, there = LocalFrame.of(points), LocalFrame.of(points.double() + offset)
        assert torch.equal(there.origin, here.origin + offset)
        assert (here.origin < 1).all()
        assert here.step == there.step

    def test_a_scan_keeps_its_origin(self, scene):
        segmenter = tj.JointSegmenter(tj.Config().set(["point_segments.method=scan"]))
        segmenter.reset(scene.points)
        assert torch.equal(segmenter.graph.points[segmenter.graph.of_given], scene.points)

    def test_projection_is_as_exact_as_the_points(self, scene):
        offset = torch.tensor([500_000.0, 5_400_000.0, 0.0], dtype=torch.float64)
        there = moved(scene, offset)
        assert torch.equal(
            tj.views.visibility.in_any_view(scene.points, scene.frames),
            tj.views.visibility.in_any_view(there.points, there.frames),
        )

    def test_clouds_at_different_places_are_not_merged(self, scene):
        segmenters = [tj.JointSegmenter() for _ in range(2)]
        for segmenter, x in zip(segmenters, (0.0, 64.0), strict=True):
            segmenter.reset(scene.points.double() + torch.tensor([x, 0, 0], dtype=torch.float64))
        with pytest.raises(ValueError, match="same points"):
            segmenters[0].merge(segmenters[1])
