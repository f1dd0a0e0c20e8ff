"""Step 6, method learned: features by hand, what is missing, and what must not matter."""

import dataclasses
import math

import pytest
import torch

import torchjoint as tj
from torchjoint.cloud.graph import build_point_graph
from torchjoint.cloud.scales import measure_scales
from torchjoint.scene import Cloud, Scene
from torchjoint.segments.learned.boundary_features import FEATURE_NAMES, boundary_features
from torchjoint.segments.learned.images import image_agreement, segments_of_superpoints
from torchjoint.segments.learned.region_statistics import (
    InnerEdges,
    Surface,
    axes,
    bulge_of_unions,
    covariance_of_unions,
    pooled,
    statistics_of_points,
)
from torchjoint.segments.learned.superpoint_graph import SuperpointGraph
from torchjoint.segments.learned.superpoints import build_superpoint_graph
from torchjoint.views.evidence import Evidence
from torchjoint.views.observations import Observations

LEARNED = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])
OF_COLORS = {"lightness_difference", "chroma_difference", "color_contrast"} | {
    name for name in FEATURE_NAMES if name.startswith(("color_spread", "color_step", "texture"))
}
OF_IMAGES = {"seen_share", "log_views", "overlap_gain", "better_overlap", "worse_overlap"} | {
    name for name in FEATURE_NAMES if name.startswith(("disagreement", "contour", "agreement"))
}


def value(features: torch.Tensor, name: str, row: int = 0) -> float:
    return features[row, FEATURE_NAMES.index(name)].item()


def missing(features: torch.Tensor) -> set[str]:
    """The features that no boundary has."""
    return {name for name, column in zip(FEATURE_NAMES, features.T, strict=True) if column.isnan().all()}


def corner(step=0.01, side=20):
    """A floor, and a wall that stands on it: points, and normals that point into the room."""
    along, out = torch.meshgrid(torch.arange(2 * side) * step, (torch.arange(side) + 0.5) * step, indexing="ij")
    floor = torch.stack([out, along, torch.zeros_like(out)], -1).view(-1, 3)
    wall = torch.stack([torch.zeros_like(out), along, out], -1).view(-1, 3)
    up, sideways = torch.tensor([0.0, 0, 1]).expand_as(floor), torch.tensor([1.0, 0, 0]).expand_as(wall)
    return torch.cat([floor, wall]), torch.cat([up, sideways])


def evidence_of(points, normals=None, colors=None) -> SuperpointGraph:
    """Without images."""
    scales = measure_scales(points)
    graph = build_point_graph(Cloud(points, colors, normals), LEARNED.point_graph.neighbors, scales)
    return build_superpoint_graph(graph, scales, Evidence.zeros(graph.edge_index.shape[1], len(points)))


class TestCorner:
    def test_two_planes_that_meet(self):
        points, normals = corner()
        evidence = evidence_of(points, normals)
        half = len(points) // 2
        assert evidence.superpoint.tolist() == [0] * half + [1] * half
        features = boundary_features(evidence)
        assert evidence.pairs.tolist() == [[0], [1]]
        assert features.shape == (1, len(FEATURE_NAMES))
        assert features.dtype == torch.float32
        side, step = 20, 0.01
        deviations = [step * math.sqrt((count**2 - 1) / 12) for count in (side, 2 * side)]
        extent = math.hypot(*deviations, side / 4 * step * math.sqrt(2))  # of floor and wall together
        expected = {
            **{f"{name}_{part}": 1 for name in ("crease", "bend") for part in ("mean", "low", "median", "high")},
            "unoriented_share": 0,
            "log_points_small": math.log(half),
            "log_points_large": math.log(half),
            "thickness_small": 0,
            "flatness_large": 1,
            "elongation_small": deviations[1] / deviations[0],
            "width_large": deviations[0] / evidence.statistics.spacing[1].item(),
            "extent_ratio": 1,
            "normals_cosine": 0,
            "side_of_large": side / 2 * step / deviations[1],
            "side_of_small": side / 2 * step / deviations[1],
            "center_distance": math.sqrt(2) * side / 2 * step / (2 * math.hypot(*deviations)),
            "perimeter_share_small": 1,
            "log_neighbors_small": 0,
            "crease_above_mean_of_small": 0,
            "crease_above_least_of_large": 0,
            **dict.fromkeys(("bulge_small", "bulge_large", "roughness_small", "roughness_large"), 0),
            "bulge_union": -side / 4 * step / extent,  # hollow: the room is inside
            "bulge_growth": -side / 4 * step / extent,
            "bend_above_roughness": 1 / 0.02,
        }
        assert {name: value(features, name) for name in expected} == pytest.approx(expected, abs=2e-3)
        count = int(evidence.boundaries.num_edges)
        assert value(features, "boundary_share") == pytest.approx(count / (count + half))
        assert value(features, "boundary_per_perimeter_large") == pytest.approx(count / math.sqrt(half))

    def test_no_colours_and_no_images(self):
        points, normals = corner()
        evidence = evidence_of(points, normals)
        assert missing(boundary_features(evidence)) == OF_COLORS | OF_IMAGES
        colors = torch.where(normals > 0.5, 0.2, 0.7)
        evidence = evidence_of(points, normals, colors)
        features = boundary_features(evidence)
        assert missing(features) == OF_IMAGES
        assert value(features, "color_spread_small") == pytest.approx(0, abs=1e-3)
        assert value(features, "color_step_low") == pytest.approx(value(features, "color_step_high"))
        difference = math.hypot(value(features, "lightness_difference"), value(features, "chroma_difference"))
        assert difference == pytest.approx(value(features, "color_step_mean"), rel=1e-5)
        assert value(features, "color_contrast") == pytest.approx(difference / 2, rel=1e-3)
        assert value(features, "color_step_ratio") == pytest.approx(difference / 0.5, rel=1e-5)  # most steps are 0
        assert value(features, "texture_small") == value(features, "texture_large") == 0
        assert value(features, "color_step_above_texture") == pytest.approx(difference / 0.5, rel=1e-5)

    def test_one_region_has_no_boundary(self):
        evidence = evidence_of(*corner())
        whole = evidence.grouped(torch.zeros(len(evidence), dtype=torch.int64))
        assert whole.pairs.shape == (2, 0)
        assert boundary_features(whole).shape == (0, len(FEATURE_NAMES))


class TestSummaries:
    def test_points_without_colors_do_not_count(self):
        """Region 0 has two points with a colour, region 1 one, region 2 none."""
        lab, none = torch.tensor([[1.0, 2, 3], [3, 2, 1], [5, 5, 5]]), [torch.nan] * 3
        lab = torch.stack([lab[0], torch.tensor(none), lab[1], lab[2], torch.tensor(none), torch.tensor(none)])
        points, ones = torch.randn(6, 3, generator=torch.Generator().manual_seed(0)), torch.ones(6)
        surface = Surface(points, points, ones > 0, ones, ones, lab)
        region = torch.tensor([0, 0, 0, 1, 1, 2])
        inner = InnerEdges(region[:-1], ones[:-1], torch.tensor([4.0, torch.nan, 2, torch.nan, torch.nan]))
        found = statistics_of_points(region, surface, [inner])
        assert found.colored.tolist() == [2, 1, 0]
        assert found.color[:2].tolist() == [[2, 2, 2], [5, 5, 5]]
        assert found.color_variance[:2].tolist() == [[1, 0, 1], [0, 0, 0]]
        assert found.texture[:2].tolist() == [3, 0]
        assert torch.cat([found.color[2], found.color_variance[2], found.texture[2:]]).isnan().all()
        union = pooled(found, torch.tensor([0, 0, 1]), 2)
        assert union.colored.tolist() == [3, 0]
        assert union.color[0].tolist() == [3, 3, 3]
        assert union.color_variance[0].tolist() == pytest.approx([8 / 3, 2, 8 / 3])
        assert union.texture[0].item() == 2
        assert torch.cat([union.color[1], union.color_variance[1], union.texture[1:]]).isnan().all()

    @pytest.mark.parametrize("missing", [0, 20])
    def test_regions_of_superpoints_are_regions_of_points(self, missing):
        generator = torch.Generator().manual_seed(0)
        points, normals, lab = (torch.randn(60, 3, generator=generator) for _ in range(3))
        lab[torch.randperm(60, generator=generator)[:missing]] = torch.nan
        noise, spacing, oriented = torch.rand(3, 60, generator=generator)
        surface = Surface(points + 100, normals, oriented > 0.3, noise, spacing, lab)
        superpoint = torch.arange(60) % 12
        of_superpoint = torch.arange(12) // 4
        of_edge = superpoint.repeat(4)  # each superpoint has as many edges for a point
        turn, step = torch.rand(2, 240, generator=generator)
        halves = [InnerEdges(of_edge[half], turn[half], step[half]) for half in (slice(100), slice(100, None))]
        superpoints = statistics_of_points(superpoint, surface, halves)
        expected = statistics_of_points(
            of_superpoint[superpoint], surface, [InnerEdges(of_superpoint[of_edge], turn, step)]
        )
        for name, found, wanted in zip(
            superpoints._fields, pooled(superpoints, of_superpoint, 3), expected, strict=True
        ):
            if missing and name == "texture":
                continue  # of a union the mean of its parts by their points with a colour, not by their edges
            torch.testing.assert_close(found, wanted)
        union = covariance_of_unions(expected, torch.tensor([0]), torch.tensor([2]))
        both = (points + 100)[of_superpoint[superpoint] != 1].double()
        torch.testing.assert_close(union[0], torch.cov(both.T, correction=0))
        torch.testing.assert_close(axes(union)[0, 2].square(), torch.linalg.eigvalsh(union[0])[-1])
        outward = torch.where(surface.oriented[:, None], normals, 0.0)[of_superpoint[superpoint] != 1].double()
        bulge = bulge_of_unions(expected, torch.tensor([0]), torch.tensor([2]))
        torch.testing.assert_close(bulge[0], ((both - both.mean(0)) * outward).sum(1).mean())

    def test_the_origin_does_not_matter(self):
        generator = torch.Generator().manual_seed(3)
        points, normals = torch.randn(2, 60, 3, generator=generator)
        superpoint, of_superpoint, ones = torch.arange(60) % 12, torch.arange(12) // 4, torch.ones(60)
        inner = InnerEdges(torch.empty(0, dtype=torch.int64), torch.empty(0), None)

        def bulges(shift):
            surface = Surface(points.double() + torch.tensor(shift), normals, ones > 0, ones, ones, None)
            regions = pooled(statistics_of_points(superpoint, surface, [inner]), of_superpoint, 3)
            union = bulge_of_unions(regions, torch.tensor([0, 1]), torch.tensor([2, 2]))
            return torch.cat([regions.bulge, union])

        torch.testing.assert_close(bulges([512.0, -256, 1]), bulges([0.0, 0, 0]), rtol=0, atol=1e-9)

    def test_bulges_and_roughness_by_hand(self):
        """A ball, a hollow ball, a plane, and points without oriented normals."""
        directions = torch.nn.functional.normalize(torch.randn(200, 3, generator=torch.Generator().manual_seed(1)))
        directions = torch.cat([directions, -directions])  # the mean is the centre
        flat = torch.cat([directions[:, :2], torch.zeros(400, 1)], 1)
        up = torch.tensor([0.0, 0, 1]).expand(400, 3)
        points = torch.cat([0.3 * directions, 0.3 * directions, flat, 0.3 * directions])
        normals = torch.cat([directions, -directions, up, directions])
        region, ones = torch.arange(4).repeat_interleave(400), torch.ones(1600)
        surface = Surface(points, normals, region < 3, ones, ones, None)
        inner = InnerEdges(torch.tensor([0, 0, 1]), torch.tensor([0.25, 0.5, 1.0]), None)
        found = statistics_of_points(region, surface, [inner])
        assert found.bulge.tolist() == pytest.approx([0.3, -0.3, 0, 0], abs=1e-6)
        assert found.outward.abs().amax(1).tolist() == pytest.approx([0, 0, 1, 0], abs=1e-6)
        assert found.roughness.tolist() == [0.375, 1, 0, 0]
        assert found.texture is None


#: Superpoint 0 has points 0-3, superpoint 1 has 4-9, superpoint 2 has 10-12.
SUPERPOINTS = torch.tensor([0] * 4 + [1] * 6 + [2] * 3)
PAIRS = torch.tensor([[0, 0, 1], [1, 2, 2]])


class TestImages:
    def agreement(self, *observations, of_superpoint=(0, 1, 2), pairs=PAIRS):
        images = segments_of_superpoints(SUPERPOINTS, observations)
        columns = image_agreement(images.grouped(torch.tensor(of_superpoint)), max(of_superpoint) + 1, pairs)
        return torch.stack(list(columns.values()), 1)

    def test_by_hand(self, seen):
        # Shares of superpoint 0: label 1: 1/2, label 2: 1/2. Superpoint 1: 2: 1/2, 3: 1/2. Superpoint 2: 3: 1.
        first = seen(range(13), [1, 1, 2, 2] + [2] * 3 + [3] * 3 + [3] * 3)
        second = seen(range(10), [0] * 10)  # superpoint 2 is hidden
        result = self.agreement(first, second)
        total = (0.5 * 24 + 1 * 24) / 48
        # Best overlaps: superpoint 0 with label 1: 2 of 4, or with label 0: 4 of 10; superpoint 1: 6 of 10. Union: 10
        # of 10.
        assert result[0].tolist() == pytest.approx([total, 0.75, 0.25, math.log(3), 1 - 0.6, 0.6, 0.5, 0.5])
        assert result[1, :3].tolist() == [0, 0, 0]
        # Superpoint 2 with label 3: 3 of 6; the union of 1 and 2: 6 of 9.
        assert result[2].tolist() == pytest.approx([0.5, 0.5, 0, math.log(2), 2 / 3 - 0.6, 0.6, 0.5, 0])

    def test_superpoints_add_up(self, seen):
        view = seen(range(13), [1, 1, 2, 2] + [2] * 3 + [3] * 3 + [3] * 3)
        merged = self.agreement(view, of_superpoint=(0, 1, 1), pairs=torch.tensor([[0], [1]]))
        assert merged[0, 0].item() == pytest.approx(1 / 3)  # label 2 has 3 of 9 points of the merged region

    def test_two_points_are_too_few(self, seen):
        result = self.agreement(seen([0, 1, 4, 5, 6], [1] * 5))
        assert result[0, [0, 1, 2, 7]].isnan().all()
        # Superpoint 1 alone has 3 of the segment's 5 points.
        assert result[0, 3:7].tolist() == pytest.approx([0, -3 / 5, 3 / 5, 0])

    def test_nothing_seen(self, seen):
        result = self.agreement(seen([], []), seen([0, 5], [-1, -1]))
        assert result[:, [0, 1, 2, 7]].isnan().all()
        assert (result[:, 3:7] == 0).all()


@pytest.fixture(scope="module")
def scene(scene_of):
    return scene_of(3).scene


def seen_by_learned(scene, order=None) -> tuple[tj.JointSegmenter, SuperpointGraph, torch.Tensor]:
    segmenter = tj.JointSegmenter(LEARNED)
    segmenter.reset(scene.points, scene.colors)
    segmenter.update([scene.frames[index] for index in order or range(len(scene.frames))])
    graph = segmenter.graph
    assert graph.scales is not None
    evidence = build_superpoint_graph(graph, graph.scales, segmenter.state)
    return segmenter, evidence, boundary_features(evidence)


@pytest.fixture(scope="module")
def reference(scene):
    return seen_by_learned(scene)


class TestInvariance:
    def test_a_scene_has_all_features(self, reference):
        _, evidence, features = reference
        assert features.shape[0] > 50
        assert missing(features) == set()
        assert features.shape[0] == evidence.pairs.shape[1]
        assert not features.isinf().any()

    def test_order_of_frames(self, scene, reference):
        _, evidence, features = seen_by_learned(scene, order=[4, 0, 5, 2, 1, 3])
        assert torch.equal(evidence.superpoint, reference[1].superpoint)
        assert torch.equal(features.nan_to_num(-9), reference[2].nan_to_num(-9))

    def test_threads(self, scene, reference, set_threads):
        for threads in (1, 3):
            set_threads(threads)
            _, evidence, features = seen_by_learned(scene)
            assert torch.equal(evidence.superpoint, reference[1].superpoint)
            assert torch.equal(features.nan_to_num(-9), reference[2].nan_to_num(-9))

    def test_units(self, scene, reference):
        frames = []
        for frame in scene.frames:
            world_to_camera = frame.world_to_camera.clone()
            world_to_camera[:3, 3] *= 2
            frames.append(dataclasses.replace(frame, world_to_camera=world_to_camera))
        larger = Scene(2 * scene.points, frames, colors=scene.colors)
        _, evidence, features = seen_by_learned(larger)
        assert torch.equal(evidence.superpoint, reference[1].superpoint)
        torch.testing.assert_close(features, reference[2], rtol=1e-4, atol=1e-4, equal_nan=True)

    def test_without_observations_images_do_not_count(self, reference):
        segmenter, _, _ = reference
        graph = segmenter.graph
        unseen = dataclasses.replace(segmenter.state, observations=Observations())
        evidence = build_superpoint_graph(graph, graph.scales, unseen)
        assert evidence.images is None
        assert missing(boundary_features(evidence)) == OF_IMAGES


def test_names_are_unique():
    assert len(set(FEATURE_NAMES)) == len(FEATURE_NAMES) == 94
