"""Step 6, method learned: merging by hand, the rounds, and the method as a whole with a model by hand."""

import dataclasses
from dataclasses import replace

import pytest
import torch
from torchjoint_lab.synthetic import make_domain_scene

import torchjoint as tj
from torchjoint import ops
from torchjoint.runtime.groups import first_places
from torchjoint.segments.learned.agglomeration import (
    ALONE,
    COARSER,
    HEIGHT_STEP,
    WITH_IMAGES,
    judge_of,
    merge_superpoints,
    merging_steps,
)
from torchjoint.segments.learned.boundary_features import FEATURE_NAMES, boundary_features
from torchjoint.segments.learned.boundary_model import OF_IMAGES, PACKAGED, load_boundary_model
from torchjoint.segments.learned.consensus import COPIES, build_consensus, jittered
from torchjoint.segments.learned.method import segment
from torchjoint.segments.learned.superpoints import build_superpoint_graph
from torchjoint.views.evidence import Evidence

LEARNED = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])


class ByCrease:
    """A model by hand: creases are boundaries. It remembers what it was asked."""

    def __init__(self, *thresholds):
        self.thresholds = thresholds
        self.members = (self,)
        self.asked = []

    def probability(self, number, values):
        self.asked.append((number, len(values)))
        return values[:, FEATURE_NAMES.index("crease_mean")].double().clamp(0, 1)


@pytest.fixture(scope="module")
def scene(scene_of):
    return scene_of(3).scene


def build_hierarchy(evidence, model):
    return merge_superpoints(evidence, merging_steps(model.thresholds), judge_of(model))


def segmenter_of(scene, order=None):
    segmenter = tj.JointSegmenter(LEARNED)
    segmenter.reset(scene.points, scene.colors)
    segmenter.update([scene.frames[index] for index in order or range(len(scene.frames))])
    return segmenter


@pytest.fixture(scope="module")
def segmenter(scene):
    return segmenter_of(scene)


@pytest.fixture(scope="module")
def evidence(segmenter):
    graph = segmenter.graph
    return build_superpoint_graph(graph, graph.scales, segmenter.state)


def by_probability(graph, probability, threshold):
    """The merged regions of the superpoints, by the operator that gives labels instead of merges, edge by edge."""
    count = graph.boundaries.num_edges
    edges, cost = graph.pairs.repeat_interleave(count, 1), probability.float().repeat_interleave(count)
    return ops.merge_regions(edges, cost, torch.ones(len(graph), dtype=torch.int64), threshold)


def after_rounds(evidence, model, *rounds):
    """The labels after rounds (number, threshold)."""
    region, graph = evidence.superpoint, evidence
    for number, threshold in rounds:
        if graph.pairs.shape[1] == 0:
            break
        group = by_probability(graph, model.probability(number, boundary_features(graph)), threshold)
        region, graph = group[region], graph.grouped(group)
    return region


class TestRounds:
    def test_each_round_asks_about_larger_regions(self, evidence):
        model = ByCrease(0.1, 0.2, 0.3)
        build_hierarchy(evidence, model)
        numbers, boundaries = zip(*model.asked, strict=True)
        assert numbers[:7] == (0, 0, 1, 1, 2, 2, 2)
        assert set(numbers[7:]) <= {2}
        assert list(boundaries) == sorted(boundaries, reverse=True)
        assert boundaries[0] == evidence.pairs.shape[1]

    @pytest.mark.parametrize("thresholds", [(0.1, 0.2, 0.3), (0.15, 0.25, 0.35, 0.5), (0.3, 0.1), (0.9,)])
    def test_the_level_of_the_highest_threshold_is_the_rounds(self, evidence, thresholds):
        model = ByCrease(*thresholds)
        hierarchy = build_hierarchy(evidence, model)
        expected = after_rounds(evidence, model, *merging_steps(thresholds))
        assert torch.equal(hierarchy.cut(max(thresholds)), expected)
        assert hierarchy.default == max(WITH_IMAGES, *thresholds)

    def test_the_default_level_of_the_package_s_model(self, evidence):
        model = load_boundary_model()
        steps = [(0, 0.075), (0, 0.15), (1, 0.2), (1, 0.25), (2, 0.3), (2, 0.35), (3, 0.425), (3, 0.5), (3, 0.5)]
        by_hand = after_rounds(evidence, model, *steps, (3, WITH_IMAGES))
        assert torch.equal(build_hierarchy(evidence, model).at(), by_hand)

    @pytest.mark.slow
    def test_a_cut_at_a_threshold_is_the_state_after_its_round(self, evidence):
        model = ByCrease(0.1, 0.2, 0.3)
        hierarchy = build_hierarchy(evidence, model)
        rounds = [*merging_steps(model.thresholds), *((2, threshold) for threshold in COARSER)]
        for last, (_, threshold) in enumerate(rounds):
            if last != 5:  # the second run of a step goes on below the same threshold
                expected = after_rounds(evidence, model, *rounds[: last + 1])
                assert torch.equal(hierarchy.cut(threshold), expected)

    def test_the_ends(self, evidence):
        hierarchy = build_hierarchy(evidence, ByCrease(0.1, 0.3))
        assert torch.equal(hierarchy.at(1), evidence.superpoint)
        connected = by_probability(evidence, torch.zeros(evidence.pairs.shape[1]), 1.0)
        assert torch.equal(hierarchy.at(0), connected[evidence.superpoint])

    def test_heights_never_fall_on_the_way_up(self, evidence):
        hierarchy = build_hierarchy(evidence, ByCrease(0.1, 0.2, 0.3))
        assert hierarchy.heights.min() >= HEIGHT_STEP
        top = [0.0] * hierarchy.num_superpoints
        for (a, b), height in zip(hierarchy.merges.tolist(), hierarchy.heights.tolist(), strict=True):
            assert height >= max(top[a], top[b])
            top[a] = height  # each merge names the lowest superpoints of the two segments
        assert len(set(hierarchy.merges[:, 1].tolist())) == len(hierarchy.merges)

    def test_labels_are_numbered_by_first_appearance(self, evidence):
        labels = build_hierarchy(evidence, ByCrease(0.1, 0.3)).at()
        first = [int((labels == label).nonzero()[0]) for label in range(int(labels.max()) + 1)]
        assert first == sorted(first)
        assert labels.dtype == torch.int64
        assert labels.shape == evidence.superpoint.shape

    def test_stops_when_no_boundary_is_left(self, evidence):
        model = ByCrease(1.0, 1.0, 1.0)
        labels = build_hierarchy(evidence, model).at()
        first, second = labels[first_places(evidence.superpoint)[evidence.pairs]]
        assert torch.equal(first, second)
        assert model.asked[-1][1] < evidence.pairs.shape[1]  # halfway, some boundaries are left
        assert len(model.asked) == 2


def grey_of(scene):
    frames = [dataclasses.replace(frame, image=frame.image[:1].expand(3, -1, -1)) for frame in scene.frames]
    return dataclasses.replace(scene, colors=scene.colors[:, :1].expand(-1, 3), frames=frames)


class TestMethod:
    @pytest.fixture(autouse=True)
    def _model(self, monkeypatch):
        self.packaged = []

        def load(path, packaged):
            self.packaged.append(packaged)
            return ByCrease(0.1, 0.2, 0.3)

        monkeypatch.setattr("torchjoint.segments.learned.method.load_boundary_model", load)

    def test_which_model_and_level(self, scene):
        bare = dataclasses.replace(scene, frames=())
        mask = tj.Masks.from_stack(torch.ones(1, *scene.frames[0].image.shape[1:], dtype=torch.bool))
        masked = dataclasses.replace(scene, frames=[dataclasses.replace(scene.frames[0], masks=mask)])
        for given, packaged, height in (
            (bare, PACKAGED, ALONE),
            (scene, OF_IMAGES, WITH_IMAGES),
            (masked, OF_IMAGES, WITH_IMAGES),
            (grey_of(scene), PACKAGED, WITH_IMAGES),  # that model learned from grey scenes, too
        ):
            assert tj.JointSegmenter()(given).hierarchy.default == height
            assert self.packaged[-1] == packaged

    def test_is_the_consensus(self, segmenter, evidence):
        graph = segmenter.graph
        others = [jittered(graph, graph.scales, number) for number in range(1, COPIES)]
        copies = [evidence, *(build_superpoint_graph(other, graph.scales, segmenter.state) for other in others)]
        hierarchy = build_consensus(copies, ByCrease(0.1, 0.2, 0.3))
        expected = hierarchy.transferred(segmenter.graph.of_given)[0].at()
        result = segmenter.compute()
        assert torch.equal(result.points, expected)
        assert expected.max() > 3
        assert len(result.images) == 6

    def test_neither_order_nor_threads_matter(self, scene, segmenter, set_threads):
        expected = segmenter.compute(images=False)
        for threads in (1, 3):
            set_threads(threads)
            again = segmenter_of(scene, [5, 3, 1, 0, 2, 4]).compute(images=False)
            assert torch.equal(again.points, expected.points)
            assert torch.equal(again.hierarchy.merges, expected.hierarchy.merges)
            assert torch.equal(again.hierarchy.heights, expected.hierarchy.heights)

    @pytest.mark.parametrize("count", [1, 2, 5, 40])
    def test_tiny_clouds(self, count):
        points = torch.rand(count, 3, generator=torch.Generator().manual_seed(0))
        for colors in (None, points):
            segmenter = tj.JointSegmenter(LEARNED)
            segmenter.reset(points, colors)
            assert segmenter.compute().points.shape == (count,)

    def test_needs_the_scales(self, segmenter):
        graph = replace(segmenter.graph, scales=None)
        with pytest.raises(ValueError, match="graph: method learned needs a graph that was built with the scales"):
            segment(graph, Evidence.empty(graph), LEARNED)

    def test_no_parameter_of_step_6_counts(self, segmenter):
        other = LEARNED.set(["paper.scale=1", "paper.weight=0", "scan.gap=1"])
        expected = segmenter.compute(images=False).points
        message = r"scan\.gap, paper\.weight, paper\.scale: without effect here, where method learned"
        with pytest.warns(UserWarning, match=message):
            assert torch.equal(segmenter.compute(images=False, config=other).points, expected)

    @pytest.mark.parametrize("method", ["paper", "scan"])
    def test_another_method_needs_another_graph(self, scene, segmenter, method):
        message = r"config: stored evidence depends on point_segments\.method; add the frames again"
        other = LEARNED.set([f"point_segments.method={method}"])
        with pytest.raises(ValueError, match=message):
            segmenter.compute(config=other)
        seen = tj.JointSegmenter(other)
        seen.reset(scene.points)
        with pytest.raises(ValueError, match=message):  # nor the other way round
            seen.compute(config=LEARNED)


def test_the_model_of_the_package_finds_what_stands_on_a_table():
    """The whole way with the model that is shipped, on a generated scene that it was not trained on."""
    scene = make_domain_scene("table", 11, num_views=2, num_points=5000).scene
    segmenter = tj.JointSegmenter()
    result = segmenter(scene)
    assert tj.metrics.mean_best_iou(result.points, scene.truth.points) > 0.5
    again = tj.JointSegmenter()
    again.reset(scene.points, scene.colors)
    for frame in reversed(scene.frames):
        again.update(frame)
    assert torch.equal(result.points, again.compute(images=False).points)
    bare = tj.JointSegmenter()(tj.Scene(scene.points))
    assert 1 < bare.num_point_segments < 200
