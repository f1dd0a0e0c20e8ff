"""Step 6, method learned: the vote of several segmentations, by hand and against a slow twin; the model's members."""

from collections import Counter
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torchjoint_lab.synthetic import make_domain_scene

import torchjoint as tj
from torchjoint import ops
from torchjoint.scene import Masks
from torchjoint.segments.learned.agglomeration import (
    WITH_IMAGES,
    calibrated_linkage,
    judge_of,
    merge_superpoints,
    merging_steps,
)
from torchjoint.segments.learned.boundary_model import BoundaryModel, load_boundary_model
from torchjoint.segments.learned.consensus import (
    DEVIATION,
    NOISE,
    Ensemble,
    build_consensus,
    jittered,
    segments_of_members,
    vote,
)
from torchjoint.segments.learned.small_regions import MIN_SIZE, MIN_SIZE_IN_IMAGES
from torchjoint.segments.learned.superpoint_graph import masks_of_superpoints
from torchjoint.segments.learned.superpoints import build_superpoint_graph


def with_masks(seen, masks):
    return replace(seen, masks=masks)


def tensors(*rows):
    return [torch.tensor(row) for row in rows]


def consensus_by_hand(segments, size):
    """The groups of superpoints by average linkage of the share of segmentations that have two points together."""
    groups = [[superpoint] for superpoint in range(len(size))]

    def share(one, other):
        together = [sum(int(size[a] * size[b]) for a in one for b in other if of[a] == of[b]) for of in segments]
        return sum(together) / (len(segments) * int(size[one].sum()) * int(size[other].sum()))

    while len(groups) > 1:
        most, a, b = max(
            (share(one, other), -a, -b) for a, one in enumerate(groups) for b, other in enumerate(groups) if a < b
        )
        if most < 0.5:
            break
        groups[-a] = sorted(groups[-a] + groups[-b])
        del groups[-b]
    return groups


class TestVote:
    def test_the_majority_wins(self):
        segments = tensors([0, 0, 1], [0, 0, 0], [0, 1, 1])
        joined, against = vote(segments, torch.arange(3), torch.tensor([1, 1, 1]))
        # 0 and 1 are together twice, 1 and 2 twice: the first pair wins; then 2 is with 0 once, and with 1 twice.
        assert joined.tolist() == [[0, 0], [1, 2]]
        assert against.tolist() == pytest.approx([1 / 3, 1 / 2])

    def test_points_count_not_superpoints(self):
        segments = tensors([0, 0, 1], [0, 0, 0], [0, 1, 1])
        joined, against = vote(segments, torch.arange(3), torch.tensor([4, 1, 1]))
        assert joined.tolist() == [[0], [1]]  # 2 is with 0 once of three times, and 0 has most of the points
        assert against.tolist() == pytest.approx([1 / 3])

    def test_only_what_touches(self):
        segments = tensors([0, 1, 0], [0, 1, 0])
        size = torch.ones(3, dtype=torch.int64)
        assert vote(segments, torch.arange(3), size)[0].tolist() == [[0], [2]]
        touching = torch.tensor([[0, 1], [1, 2]])
        assert vote(segments, torch.arange(3), size, touching)[0].shape == (2, 0)

    def test_regions_instead_of_superpoints(self):
        segments = tensors([0, 1, 1, 2], [0, 0, 0, 1])
        joined, against = vote(segments, torch.tensor([0, 1, 1, 2]), torch.ones(4, dtype=torch.int64))
        assert joined.tolist() == [[0], [1]]
        assert against.tolist() == pytest.approx([0.5])

    @given(st.data())
    def test_is_average_linkage(self, data):
        superpoints = data.draw(st.integers(1, 7))
        label = st.lists(st.integers(0, 3), min_size=superpoints, max_size=superpoints)
        segments = [torch.unique(torch.tensor(data.draw(label)), return_inverse=True)[1] for _ in range(3)]
        # Powers of two that differ: no two shares are equal but by construction.
        size = torch.tensor(data.draw(st.permutations([2**k for k in range(superpoints)])))
        joined, _ = vote(segments, torch.arange(superpoints), size)
        group = ops.connected_components(joined, superpoints).tolist()
        expected = consensus_by_hand(segments, size)
        found = [
            [superpoint for superpoint in range(superpoints) if group[superpoint] == of] for of in range(max(group) + 1)
        ]
        assert sorted(found) == sorted(expected)


def asked(ensemble, values, member):
    return ensemble.probabilities(member, 0, values, torch.arange(len(member)))


class TestEnsemble:
    def test_who_says_what(self):
        ensemble = Ensemble(BoundaryModel(tuple(Always(p) for p in (0.2, 0.4, 0.9))))
        member = torch.tensor([0, 1, 2, 6, 7, 8])
        found = asked(ensemble, torch.zeros(6, 1), member)
        assert found.tolist() == pytest.approx([0.2, 0.4, 0.9, 0.65, 0.55, 0.3])
        silent = Silent(BoundaryModel(tuple(Always(p) for p in (0.2, 0.4, 0.9))))
        assert silent.first_probabilities(torch.zeros(2, 1))[member, 1].tolist() == pytest.approx(found)

    def test_a_share_of_the_members(self):
        ensemble = Ensemble(BoundaryModel(tuple(Always(p) for p in (0.2, 0.4, 0.9))), slice(2, None, 3))
        found = asked(ensemble, torch.zeros(2, 1), torch.tensor([0, 2])).tolist()
        assert found == pytest.approx([0.9, 0.3])
        assert ensemble.first_probabilities(torch.zeros(1, 1))[[0, 2], 0].tolist() == pytest.approx(found)

    def test_the_only_member_judges_alone(self):
        ensemble = Ensemble(BoundaryModel((Always(0.3),)))
        assert asked(ensemble, torch.zeros(2, 1), torch.tensor([0, 2])).tolist() == pytest.approx([0.3, 0.3])

    def test_each_member_also_judges_with_noise(self):
        ensemble = Ensemble(BoundaryModel(tuple(Always(p / 10) for p in range(1, 6))))
        found = asked(ensemble, torch.zeros(15, 1), torch.arange(15))
        assert found[:5].tolist() == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
        odds = torch.logit(found[5:10]) - torch.logit(found[:5])
        assert 0 < odds.abs().min() < odds.abs().max() < NOISE * 3**0.5
        assert found[10:].tolist() == pytest.approx([(1.5 - (p + 1) / 10) / 4 for p in range(5)])

    def test_noise_is_repeatable_and_limited(self):
        model = BoundaryModel((Always(0.5), Always(0.5)))
        member = torch.arange(6).repeat(1000)
        one, same = (asked(Ensemble(model), torch.zeros(6000, 1), member) for _ in range(2))
        assert torch.equal(one, same)
        is_perturbed = (member == 2) | (member == 3)
        assert (one[~is_perturbed] == 0.5).all()
        odds = torch.logit(one[is_perturbed])
        assert odds.std() == pytest.approx(NOISE, rel=0.05)
        assert odds.abs().max() < NOISE * 3**0.5


class Always:
    """A member of a model that has one answer to all questions."""

    thresholds = (0.5,)
    feature_names = ("any",)

    def __init__(self, answer):
        self.answer = answer

    def probability(self, number, values):
        return torch.full((len(values),), self.answer, dtype=torch.float64)


@pytest.fixture(scope="module")
def segmenter():
    scene = make_domain_scene("table", 11, num_views=2).scene
    segmenter = tj.JointSegmenter()
    segmenter.reset(scene.points, scene.colors)
    segmenter.update(scene.frames)
    return segmenter


@pytest.fixture(scope="module")
def evidence(segmenter):
    graph = segmenter.graph
    return build_superpoint_graph(graph, graph.scales, segmenter.state)


class Silent(Ensemble):
    """The ensemble without noise."""

    def _perturbed(self, probability, is_perturbed):
        return probability


@pytest.fixture
def silent(monkeypatch):
    monkeypatch.setattr("torchjoint.segments.learned.consensus.Ensemble", Silent)


class TestConsensus:
    @pytest.mark.parametrize("masked", [False, True])
    def test_trees_are_those_of_each_member_by_itself(self, evidence, segmenter, silent, masked):
        model = load_boundary_model()
        if masked:
            stacks = [torch.stack([seen.labels % 4 == 0, seen.labels % 4 < 2]) for seen in segmenter.state.observations]
            observations = [*map(with_masks, segmenter.state.observations, map(Masks.from_stack, stacks))]
            evidence = replace(evidence, masks=masks_of_superpoints(evidence.superpoint, observations), occlusions=None)
        linkage, steps = calibrated_linkage(evidence, model), merging_steps(model.thresholds)
        _, levels, segments = segments_of_members([evidence], model)
        assert levels == [0.075, 0.15, 0.2, 0.25, 0.3, 0.35, 0.425, 0.5, 0.6, 0.8, 0.9, 1.0]
        for member, members in ((1, [1]), (6, [1]), (14, [0, 1, 2, 3])):
            judge = judge_of(BoundaryModel(tuple(model.members[member] for member in members)))
            alone = merge_superpoints(evidence, steps, judge, linkage)
            for level, of_members in zip(levels, segments, strict=True):
                assert torch.equal(of_members[member], alone.segments_of_superpoints(level))

    def test_each_copy_has_its_share_of_the_members(self, evidence, silent):
        model = load_boundary_model()
        _, _, expected = segments_of_members([evidence], model)
        _, _, segments = segments_of_members([evidence, evidence], model)
        order = [*range(0, 15, 2), *range(1, 15, 2)]
        for of_members, alone in zip(segments, expected, strict=True):
            assert all(torch.equal(one, alone[member]) for one, member in zip(of_members, order, strict=True))

    def test_trees_made_copy_by_copy_are_the_same(self, evidence, monkeypatch):
        model = load_boundary_model()
        _, _, expected = segments_of_members([evidence] * 3, model)
        monkeypatch.setattr("torchjoint.segments.learned.consensus.MANY_POINTS", 0)
        monkeypatch.setattr("torchjoint.segments.learned.consensus.MANY_BOUNDARIES", 0)  # nor all members at once
        _, _, found = segments_of_members([evidence] * 3, model)
        for one, other in zip(expected, found, strict=True):
            assert all(map(torch.equal, one, other))
            assert len(one) == len(other) == 15

    def test_a_superpoint_is_where_most_of_its_points_are(self, evidence, segmenter, silent):
        graph, model = segmenter.graph, load_boundary_model()
        other = build_superpoint_graph(jittered(graph, graph.scales, 1), graph.scales, segmenter.state)
        assert not torch.equal(other.superpoint, evidence.superpoint)
        _, _, segments = segments_of_members([evidence, other], model)
        _, _, own = segments_of_members([other], model)
        of_point = own[0][1][other.superpoint]  # member 1 after the first step
        for superpoint in range(len(evidence.statistics.size)):
            most = Counter(sorted(of_point[evidence.superpoint == superpoint].tolist())).most_common(1)
            assert int(segments[0][8][superpoint]) == most[0][0]  # of equally many the lowest comes first
        for level in range(1, len(own)):
            after = torch.full((int(own[0][1].max()) + 1,), -1)
            after[own[0][1]] = own[level][1]
            assert torch.equal(segments[level][8], after[segments[0][8]])

    @pytest.mark.parametrize("height", [0.5, 0.6])
    def test_a_level_has_together_what_most_trees_have(self, evidence, height):
        model = load_boundary_model()
        _, levels, segments = segments_of_members([evidence], model)
        of_superpoint = build_consensus([evidence], model).segments_of_superpoints(height)
        a, b = evidence.pairs
        trees = torch.stack(segments[levels.index(height)])
        share = (trees[:, a] == trees[:, b]).double().mean(0)
        together = of_superpoint[a] == of_superpoint[b]
        assert together[share == 1].all()
        assert share[together].mean() > 0.95
        assert share[~together].mean() < 0.5

    def test_the_default_level_has_no_small_regions(self, evidence):
        hierarchy = build_consensus([evidence], load_boundary_model())
        assert hierarchy.default == WITH_IMAGES
        of_superpoint = hierarchy.segments_of_superpoints(WITH_IMAGES)
        size = torch.bincount(of_superpoint[hierarchy.superpoint])
        a, b = of_superpoint[evidence.pairs]
        has_neighbour = torch.zeros(len(size), dtype=torch.bool)
        has_neighbour[torch.cat([a[a != b], b[a != b]])] = True
        assert size[has_neighbour].min() >= MIN_SIZE_IN_IMAGES
        below = torch.bincount(hierarchy.cut(0.3))
        assert below.min() < MIN_SIZE_IN_IMAGES  # finer levels have them

    def test_small_regions_are_larger_without_images(self, evidence):
        hierarchy = build_consensus([replace(evidence, images=None, occlusions=None)], load_boundary_model())
        of_superpoint = hierarchy.segments_of_superpoints(hierarchy.default)
        touches = of_superpoint[evidence.pairs[:, of_superpoint[evidence.pairs[0]] != of_superpoint[evidence.pairs[1]]]]
        assert torch.bincount(of_superpoint[hierarchy.superpoint])[touches.unique()].min() >= MIN_SIZE

    def test_levels_are_nested_and_end_in_superpoints(self, evidence):
        hierarchy = build_consensus([evidence], load_boundary_model())
        assert torch.equal(hierarchy.at(1), evidence.superpoint)
        counts = [int(hierarchy.at(granularity).max()) + 1 for granularity in (0, 0.3, 0.5, 0.7, 0.9, 1)]
        assert counts == sorted(counts)
        assert len(set(counts)) > 4

    def test_threads_do_not_matter(self, evidence, set_threads):
        model = load_boundary_model()
        expected = build_consensus([evidence], model)
        for threads in (1, 3):
            set_threads(threads)
            again = build_consensus([evidence], model)
            assert torch.equal(again.merges, expected.merges)
            assert torch.equal(again.heights, expected.heights)


class TestCopies:
    def test_points_move_and_normals_follow(self, segmenter):
        graph = segmenter.graph
        copy = jittered(graph, graph.scales, 1)
        step = (copy.points - graph.points) / graph.scales.spacing[:, None]
        assert step.std(0).tolist() == pytest.approx([DEVIATION] * 3, rel=0.1)
        assert step.abs().max() < DEVIATION * 3**0.5 * 1.01
        nearest = graph.neighbors[:, : graph.scales.normal_neighbors]
        some = torch.arange(0, graph.num_points, 97)
        around = torch.cat([copy.points[some, None], copy.points[nearest[some].long()]], 1).double()
        centred = around - around.mean(1, keepdim=True)
        expected = torch.linalg.svd(centred).Vh[:, 2]
        assert (expected * copy.normals[some]).sum(1).abs().min() > 1 - 1e-4
        assert (copy.normals * graph.normals).sum(1).min() >= 0
        assert not torch.equal(copy.wide_normals, graph.wide_normals)
        assert copy.edge_index is graph.edge_index

    def test_equal_numbers_give_equal_copies(self, segmenter):
        graph = segmenter.graph
        one, same, other = (jittered(graph, graph.scales, number) for number in (1, 1, 2))
        assert torch.equal(one.points, same.points)
        assert torch.equal(one.normals, same.normals)
        assert not torch.equal(one.points, other.points)

    def test_given_normals_stay(self, segmenter):
        graph = replace(segmenter.graph, has_given_normals=True)
        assert jittered(graph, graph.scales, 1).normals is graph.normals
