"""Step 6, methods paper and scan: equations of the paper, images count as they should."""

import pytest
import torch

import torchjoint as tj
from torchjoint import ops
from torchjoint.cloud.edge_weights import EdgeWeights, discounted_angle, geometric_weights
from torchjoint.cloud.graph import PointGraph, orient_normals
from torchjoint.segments import paper
from torchjoint.segments.scan import method as scan
from torchjoint.segments.scan.method import segment_levels
from torchjoint.views.evidence import Evidence
from torchjoint.views.propagation import disagreement

CONFIG = tj.Config.from_preset("paper")


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(3, num_points=6000)


def segment_points(graph: PointGraph, state: Evidence, config: tj.Config) -> torch.Tensor:
    return paper.segment(graph, state, config)


def graph_and_state(scene: tj.Scene, config: tj.Config) -> tuple[PointGraph, Evidence]:
    """The graph, and what all frames say."""
    segmenter = tj.JointSegmenter(config)
    segmenter.reset(scene.points, scene.colors)
    segmenter.update(list(scene.frames))
    return segmenter.graph, segmenter.state


@pytest.fixture(scope="module")
def case(synthetic):
    return CONFIG, *graph_and_state(synthetic.scene, CONFIG)


class TestMethods:
    @pytest.mark.parametrize(("normalization", "num_images"), [("all", 6), ("saturating", None)])
    def test_weights_are_those_of_eq_3_to_6(self, case, normalization, num_images):
        _, graph, state = case
        values = {"scale": 2, "min_size": 9, "weight": 0.42, "distance_weight": 0.3, "convex_factor": 0.5}
        values |= {"color_weight": 0.1, "normalization": normalization}
        config = CONFIG.replace({"paper": values})
        normals, oriented = orient_normals(graph, state.facing)
        terms = EdgeWeights(discounted_angle(0.5), 1.0, 0.3, 0.1)
        weights = geometric_weights(graph.points, graph.edge_index, normals, oriented, terms, graph.colors)
        weights += 0.42 * disagreement(state.views, state.overlap_sum, 0.5, num_images)
        expected = ops.felzenszwalb(graph.edge_index, weights, graph.num_points, 2.0, 9)
        assert torch.equal(segment_points(graph, state, config), expected)

    def test_a_scan_asks_no_image(self, case):
        config, graph, state = case
        expected = segment_levels(graph.points, config.scan).at()
        assert torch.equal(scan.segment(graph, state, config).at(), expected)
        assert not torch.equal(segment_points(graph, state, config), expected)

    def test_labels_leave_no_number_out(self, case):
        config, graph, state = case
        labels = segment_points(graph, state, config)
        assert labels.dtype == torch.int64
        assert labels.unique().tolist() == list(range(int(labels.max()) + 1))
        assert labels.max() > 3


class TestWeight0:
    def test_no_image_has_a_say(self, case):
        """As with no frames at all, once the normals' signs are known."""
        config, graph, state = case
        config = config.set(["paper.weight=0"])
        blind = Evidence.empty(graph)
        blind.facing = state.facing
        assert torch.equal(segment_points(graph, state, config), segment_points(graph, blind, config))

    def test_otherwise_they_have(self, case):
        config, graph, state = case
        blind = Evidence.empty(graph)
        blind.facing = state.facing
        assert not torch.equal(segment_points(graph, state, config), segment_points(graph, blind, config))

    def test_the_heaviest(self, case):
        """No weight that a config may have makes costs too large for the operators."""
        config, graph, state = case
        labels = segment_points(graph, state, config.set(["paper.weight=1000"]))
        assert labels.shape == (graph.num_points,)
        assert labels.max() > 3
