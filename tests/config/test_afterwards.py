"""What a segmenter stores of the frames, and on which parameters this depends."""

import pytest

from torchjoint.config import Config, evidence_config, evidence_differences


@pytest.mark.parametrize("method", ["learned", "scan", "auto"])
def test_another_method_stores_something_else(method):
    other = Config().set([f"point_segments.method={method}"])
    paper = Config().set(["point_segments.method=paper"])
    assert evidence_config(other).point_segments.method == method
    assert evidence_differences(paper, other) == ["point_segments.method"]


def test_what_counts_afterwards():
    config = Config.from_preset("paper")
    later = config.set(["paper.weight=0.1", "paper.convex_factor=0.5", "refinement.color_weight=50", "scan.min_size=9"])
    assert evidence_differences(config, later) == []
    earlier = config.set(["propagation.window=5", "point_graph.neighbors=8", "paper.normal_neighbors=20"])
    names = ["point_graph.neighbors", "propagation.window", "paper.normal_neighbors"]
    assert evidence_differences(config, earlier) == names
    assert evidence_differences(evidence_config(config), config) == []
