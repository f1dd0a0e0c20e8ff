"""Step 6, learned: black and white points among others have no colour."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

import torchjoint as tj
from torchjoint.segments.learned.images import without_dropouts
from torchjoint.segments.learned.superpoints import build_superpoint_graph


def by_hand(colors, edges):
    """The same, point by point."""
    neighbors = [[] for _ in colors]
    for one, other in edges:
        neighbors[one].append(other)
        neighbors[other].append(one)
    blank = [color in ([0, 0, 0], [1, 1, 1]) for color in colors]
    return [b and sum(blank[n] for n in near) < len(near) / 2 for b, near in zip(blank, neighbors, strict=True)]


@given(st.data())
def test_by_hand(data):
    count = data.draw(st.integers(1, 8))
    value = st.sampled_from([0.0, 0.5, 1.0])
    colors = data.draw(st.lists(st.lists(value, min_size=3, max_size=3), min_size=count, max_size=count))
    edges = data.draw(st.lists(st.tuples(*[st.integers(0, count - 1)] * 2), max_size=16))
    edge_index = torch.tensor(edges, dtype=torch.int64).reshape(-1, 2).t()
    found = without_dropouts(torch.tensor(colors), edge_index)
    expected = torch.tensor(by_hand(colors, edges))
    assert torch.equal(found[:, 0].isnan(), expected)
    assert torch.equal(found[~expected], torch.tensor(colors)[~expected])


def test_black_points_of_a_room_have_no_colour(scene_of):
    scene = scene_of(0, num_points=6000).scene
    black = torch.rand(len(scene.points), generator=torch.Generator().manual_seed(0)) < 0.1
    segmenter = tj.JointSegmenter()
    segmenter.reset(scene.points, scene.colors.masked_fill(black[:, None], 0))
    segmenter.update(scene.frames)
    graph = segmenter.graph
    statistics = build_superpoint_graph(graph, graph.scales, segmenter.state).statistics
    share = float(statistics.colored.sum() / statistics.size.sum())
    assert 0.89 < share < 0.92
