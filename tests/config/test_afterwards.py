"""What a segmenter stores of the frames, and on which parameters this depends."""

import pytest

from torchjoint.config import Config, evidence_config, evidence_differences


def test_regions_and_edges_store_the_same():
    regions, edges = (Config().set([f"point_segments.method={name}"]) for name in ("regions", "edges"))
    assert evidence_config(regions) == evidence_config(edges)
    assert evidence_differences(regions, edges) == []


@pytest.mark.parametrize("method", ["learned", "scan", "auto"])
def test_the_other_methods_do_not(method):
    other = Config().set([f"point_segments.method={method}"])
    assert evidence_config(other).point_segments.method == method
    assert evidence_differences(Config.from_preset("regions"), other) == ["point_segments.method"]


def test_what_counts_afterwards():
    config = Config.from_preset("regions")
    later = config.set(["propagation.weight=0.1", "point_graph.convex_factor=1", "refinement.method=cuts"])
    assert evidence_differences(config, later) == []
    earlier = config.set(["propagation.window=3", "point_graph.neighbors=8", "contours.closed=false"])
    names = ["contours.closed", "point_graph.neighbors", "propagation.window"]
    assert evidence_differences(config, earlier) == names
    assert evidence_differences(evidence_config(config), config) == []
