"""Which things stand on, hang on, contain and touch which."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

import torchjoint as tj
from torchjoint.results.exports.graph import export_graph
from torchjoint.results.relations import Relation

UP = torch.tensor([0.0, 0, 1])


def grid(low, high, step=0.02):
    """Points of an axis-parallel rectangle; one extent is zero."""
    axes = [np.arange(a, b + step / 2, step) if b > a else [a] for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def box(low, high):
    """The top and the sides of a box."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    sides = [grid((x, y0, z0), (x, y1, z1)) for x in (x0, x1)] + [grid((x0, y, z0), (x1, y, z1)) for y in (y0, y1)]
    return np.concatenate([*sides, grid((x0, y0, z1), high)])


def graph_of(*things):
    points = np.concatenate(things)
    labels = torch.cat([torch.full((len(thing),), index) for index, thing in enumerate(things)])
    scene = tj.Scene(torch.from_numpy(points).float())
    return tj.Result.of(tj.Segmentation(labels, ()), scene).graph(UP)


FLOOR = grid((0, 0, 0), (2, 2, 0))
WALL = grid((0, 2.01, 0.02), (2, 2.01, 2))


def kinds(graph):
    return [(one.kind, one.first, one.second) for one in graph.relations]


def test_a_box_on_the_floor_and_a_box_on_it():
    graph = graph_of(FLOOR, box((0.5, 0.5, 0.01), (1, 1, 0.5)), box((0.6, 0.6, 0.51), (0.8, 0.8, 0.7)))
    assert kinds(graph) == [("stands on", 1, 0), ("stands on", 2, 1)]
    assert all(one.area > 0 for one in graph.relations)
    assert graph.relations[0].share > 0.9
    assert [one.second for one in graph.of(2)] == [1]


def test_hidden_feet():
    """Nothing of the lowest 10 cm of a cabinet was seen."""
    assert kinds(graph_of(FLOOR, box((0.5, 0.5, 0.1), (1, 1, 1)))) == [("stands on", 1, 0)]


def test_a_picture_hangs_on_the_wall():
    picture = grid((0.5, 1.99, 1), (1, 1.99, 1.6))
    assert ("hangs on", 2, 1) in kinds(graph_of(FLOOR, WALL, picture))
    assert not [one for one in kinds(graph_of(FLOOR, WALL, picture)) if one[0] == "stands on" and one[1] == 2]


def test_a_thing_in_a_box():
    walls = box((0, 0, 0), (1, 1, 1))
    inside = box((0.4, 0.4, 0.3), (0.6, 0.6, 0.5))
    assert ("contains", 0, 1) in kinds(graph_of(walls, inside))
    assert ("contains", 1, 0) not in kinds(graph_of(walls, inside))


def test_two_boxes_beside_each_other_touch():
    graph = graph_of(box((0, 0, 0), (0.5, 0.5, 0.5)), box((0.51, 0, 0), (1, 0.5, 0.5)))
    assert kinds(graph) == [("touches", 0, 1)]
    network = pytest.importorskip("networkx") and graph.to_networkx()
    assert sorted(network.edges()) == [(0, 1), (1, 0)]
    assert network.number_of_nodes() == 2
    assert graph.relations[0].to_dict()["kind"] == "touches"


def test_the_file_is_read_by_networkx(tmp_path):
    networkx = pytest.importorskip("networkx")
    things = [FLOOR, box((0.2, 0.2, 0.01), (0.5, 0.5, 0.3)), box((1.2, 1.2, 0.01), (1.5, 1.5, 0.3))]
    points = torch.from_numpy(np.concatenate(things)).float()
    labels = torch.cat([torch.full((len(thing),), index) for index, thing in enumerate(things)])
    result = replace(tj.Result.of(tj.Segmentation(labels, ()), tj.Scene(points)), segment_names={1: "chair"})
    export_graph(tmp_path / "graph.json", result)
    read = networkx.node_link_graph(json.loads((tmp_path / "graph.json").read_text(encoding="utf-8")), edges="edges")
    expected = result.graph().to_networkx()
    assert sorted(read.edges(data="kind")) == sorted(expected.edges(data="kind"))
    assert (1, 0, "stands on") in list(read.edges(data="kind"))
    assert read.nodes[1]["name"] == "chair"
    assert read.nodes[1]["points"] == int((labels == 1).sum())
    assert read.nodes[1]["size"] == pytest.approx([0.3, 0.3, 0.29], abs=1e-3)


def test_apart_nothing_is_related():
    assert kinds(graph_of(grid((0, 0, 0), (1, 1, 0)), grid((5, 5, 3), (6, 6, 3)))) == []


def test_a_generated_room(scene_of):
    """All that stands on a table or a cabinet is above it; most of what a person would name is found."""
    made = scene_of(0, num_points=15_000)
    ids, labels = made.point_labels.unique(return_inverse=True)
    graph = tj.Result.of(tj.Segmentation(labels, ()), tj.Scene(made.scene.points)).graph(UP)
    names = [made.instance_names[int(one)] for one in ids]
    on = [(names[one.first], names[one.second]) for one in graph.relations if one.kind == "stands on"]
    assert ("table", "floor") in on
    assert ("cup", "table") in on
    assert ("floor", "table") not in on
    assert graph == tj.Result.of(tj.Segmentation(labels, ()), tj.Scene(made.scene.points)).graph(UP)
    assert isinstance(graph.relations[0], Relation)
