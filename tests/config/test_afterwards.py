"""What a segmenter stores of the frames, and on which parameters this depends."""

import pytest

from torchjoint.config import Config, evidence_config, evidence_differences


@pytest.mark.parametrize("method", ["learned", "scan", "paper"])
def test_each_method_stores_its_own(method):
    other = Config().set([f"point_segments.method={method}"])
    assert evidence_config(other).point_segments.method == method
    assert evidence_differences(Config(), other) == ["point_segments.method"]


def test_what_counts_afterwards():
    config = Config.from_preset("paper")
    later = config.set(["paper.weight=0.1", "paper.convex_factor=0.1", "scan.gap=0.3", "refinement.color_weight=50"])
    assert evidence_differences(config, later) == []
    assert evidence_config(later) == evidence_config(config)
    earlier = config.set(["propagation.window=5", "point_graph.neighbors=8", "contours.closed=true"])
    names = ["contours.closed", "point_graph.neighbors", "propagation.window"]
    assert evidence_differences(config, earlier) == names
    assert evidence_differences(evidence_config(config), config) == []


def test_normals_count_before():
    config = Config.from_preset("paper")
    other = config.set(["paper.normal_neighbors=20", "paper.weight=0.1"])
    assert evidence_differences(config, other) == ["paper.normal_neighbors"]
