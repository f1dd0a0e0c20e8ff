"""Which things stand on, hang on, contain and touch which."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

import torchjoint as tj
from torchjoint.cli.export import export
from torchjoint.results.edits import Edit, Edits, write_edits
from torchjoint.results.folder import write_result
from torchjoint.results.parts import Parts
from torchjoint.results.relations import Relation, Relations
from torchjoint.runtime.outputs import BusyError, lock

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
    return tj.Result.of(tj.Segmentation(labels, ()), tj.Scene(torch.from_numpy(points).float())).graph()


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


def test_a_table_does_not_stand_on_a_chair():
    """A leg of it touches the seat; the legs have few of the table's points, so few are below the seat."""
    legs = [grid((x, y, 0.02), (x, y, 0.72)) for x in (0.5, 1.5) for y in (0.5, 1.5)]
    table = np.concatenate([grid((0.5, 0.5, 0.74), (1.5, 1.5, 0.74)), *legs])
    chair = np.concatenate([grid((0.2, 0.41, 0.42), (0.49, 0.71, 0.42)), grid((0.2, 0.41, 0.02), (0.2, 0.71, 0.9))])
    assert kinds(graph_of(FLOOR, table, chair)) == [("stands on", 1, 0), ("stands on", 2, 0), ("touches", 1, 2)]


def test_a_picture_hangs_on_the_wall():
    picture = grid((0.5, 1.99, 1), (1, 1.99, 1.6))
    assert ("hangs on", 2, 1) in kinds(graph_of(FLOOR, WALL, picture))
    assert not [one for one in kinds(graph_of(FLOOR, WALL, picture)) if one[0] == "stands on" and one[1] == 2]


def test_a_floor_hangs_on_nothing():
    """It goes up a little at a large cabinet, as a noisy floor does."""
    floor = np.concatenate([FLOOR, grid((0, 2, 0.02), (2, 2, 0.3))])
    cabinet = np.concatenate([grid((0, 2.02, 0.1), (2, 2.02, 2)), grid((0, 2.04, 2), (2, 4.04, 2))])
    assert kinds(graph_of(floor, cabinet)) == [("stands on", 1, 0), ("touches", 0, 1)]


def test_a_thing_does_not_hang_on_a_smaller_one():
    """The back of a chair is at the edge of a table whose legs were not seen."""
    table, back = box((0.5, 0.5, 0.6), (1.5, 1.5, 0.8)), grid((0.8, 0.48, 0.4), (1.2, 0.48, 1))
    assert "hangs on" not in [kind for kind, *_ in kinds(graph_of(FLOOR, table, back))]


def test_a_thing_in_a_box():
    walls = box((0, 0, 0), (1, 1, 1))
    inside = box((0.4, 0.4, 0.3), (0.6, 0.6, 0.5))
    assert ("contains", 0, 1) in kinds(graph_of(walls, inside))
    assert ("contains", 1, 0) not in kinds(graph_of(walls, inside))


def test_what_lies_on_a_side_is_not_inside():
    """A picture on a wall of some thickness, as noise makes it; all its points are in the box of the wall."""
    wall, picture = box((0, 2, 0), (2, 2.08, 2)), grid((0.5, 2.01, 1), (1, 2.01, 1.6))
    assert "contains" not in [kind for kind, *_ in kinds(graph_of(wall, picture))]


def test_two_boxes_beside_each_other_touch():
    graph = graph_of(box((0, 0, 0), (0.5, 0.5, 0.5)), box((0.51, 0, 0), (1, 0.5, 0.5)))
    assert kinds(graph) == [("touches", 0, 1)]


@pytest.fixture
def saved(tmp_path):
    """The folder of a result: a floor, and two boxes on it."""
    things = [FLOOR, box((0.2, 0.2, 0.01), (0.5, 0.5, 0.3)), box((1.2, 1.2, 0.01), (1.5, 1.5, 0.3))]
    labels = torch.cat([torch.full((len(thing),), index) for index, thing in enumerate(things)])
    scene = tj.Scene(torch.from_numpy(np.concatenate(things)).float())
    write_result(tmp_path, scene, tj.Segmentation(labels, ()), tj.Config(), "test")
    return tmp_path


def test_segments_json_has_the_relations(saved):
    before = json.loads((saved / "segments.json").read_text())
    with pytest.raises(ValueError, match=r"segments\.json: expected relations, as .*'relations'"):
        Relations.load(saved)
    graph = tj.load_result(saved).graph()
    graph.save(saved)
    record = json.loads((saved / "segments.json").read_text())
    assert record.pop("relations") == [asdict(one) for one in graph.relations]
    assert record == before
    read = Relations.load(saved)
    assert kinds(read) == kinds(tj.load_result(saved).graph()) == [("stands on", 1, 0), ("stands on", 2, 0)]
    assert read == graph
    assert [one.second for one in read.of(1)] == [0]


@pytest.mark.parametrize("length", [0.1, 5.0])
def test_only_the_direction_of_up_counts(saved, length):
    result = tj.load_result(saved)
    upright, other = (replace(result, scene=replace(result.scene, up=up)) for up in (UP, length * UP))
    assert other.graph() == upright.graph()


@pytest.mark.parametrize(
    ("up", "error", "message"),
    [
        (torch.zeros(3), ValueError, "up: expected a direction, got zeros"),
        (torch.ones(2), ValueError, r"up: expected shape \[3\], got \[2\]"),
        (torch.tensor([0, 0, torch.nan]), ValueError, "up: expected finite values"),
        ([0.0, 0.0, 1.0], TypeError, r"up: expected a torch\.Tensor, got list"),
    ],
)
def test_what_is_no_direction_is_an_error(saved, up, error, message):
    with pytest.raises(error, match=message):
        replace(tj.load_result(saved).scene, up=up)


def test_the_graph_of_another_result_is_not_saved(saved):
    graph = tj.load_result(saved).graph()
    with pytest.raises(ValueError, match="expected the segments of the graph"):
        Relations(graph.relations, graph.labels.clamp_max(1)).save(saved)
    assert "relations" not in json.loads((saved / "segments.json").read_text())


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "eats"},
        {"first": 3},
        {"first": 1.0},
        {"first": True},
        {"first": 0, "second": 0},
        {"second": "0"},
        {"area": float("nan")},
        {"area": -1.0},
        {"area": True},
        {"share": "1"},
        {"share": 7.0},
        {"more": 1},
    ],
)
def test_damaged_relations_are_an_error(saved, change):
    tj.load_result(saved).graph().save(saved)
    record = json.loads((saved / "segments.json").read_text())
    record["relations"][0] |= change
    (saved / "segments.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match=r"segments\.json: expected relations, as `torchjoint export .* adds them: "):
        Relations.load(saved)


@pytest.mark.parametrize("change", [lambda of: of.pop(), lambda of: of.reverse(), lambda of: of[0].update(points=1)])
def test_segments_of_another_result_are_an_error(saved, change):
    tj.load_result(saved).graph().save(saved)
    record = json.loads((saved / "segments.json").read_text())
    change(record["segments"])
    (saved / "segments.json").write_text(json.dumps(record))
    for read in (Relations.load, tj.load_result(saved).graph().save):
        with pytest.raises(ValueError, match=r"segments\.json: not .*: expected the 3 segments of points\.npz"):
            read(saved)


def test_only_one_adds_to_segments_json_at_a_time(saved):
    before = (saved / "segments.json").read_bytes()
    with lock(saved / ".segments.json.lock", "busy"), pytest.raises(BusyError, match="writing it; save again"):
        tj.load_result(saved).graph().save(saved)
    assert (saved / "segments.json").read_bytes() == before


def test_a_link_is_not_read(saved):
    tj.load_result(saved).graph().save(saved)
    (saved / "segments.json").rename(saved / "elsewhere.json")
    (saved / "segments.json").symlink_to(saved / "elsewhere.json")
    with pytest.raises(ValueError, match=r"segments\.json: expected a file, got a link"):
        Relations.load(saved)
    (saved / "segments.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"segments\.json: missing; expected a result"):
        Relations.load(saved)


def test_export_adds_the_relations(saved, capsys):
    export(saved, "graph")
    assert capsys.readouterr().out == f"{saved / 'segments.json'}\n"
    assert len(Relations.load(saved).relations) == 2
    with pytest.raises(ValueError, match=r"--format graph adds to segments\.json: expected no -o"):
        export(saved, "graph", out=Path("graph.json"))
    write_edits(saved, Edits(Parts(tj.load_result(saved)).count, None, (Edit("name", (0,), "floor"),)))
    with pytest.warns(UserWarning, match="--format graph leaves corrections by hand out"):
        export(saved, "graph")


def test_apart_nothing_is_related():
    assert kinds(graph_of(grid((0, 0, 0), (1, 1, 0)), grid((5, 5, 3), (6, 6, 3)))) == []


def test_a_generated_room(scene_of):
    """All that stands on a table or a cabinet is above it; most of what a person would name is found."""
    made = scene_of(3, num_points=15_000)
    ids, labels = made.point_labels.unique(return_inverse=True)
    graph = tj.Result.of(tj.Segmentation(labels, ()), tj.Scene(made.scene.points)).graph()
    names = [made.instance_names[int(one)] for one in ids]
    on = [(names[one.first], names[one.second]) for one in graph.relations if one.kind == "stands on"]
    assert ("table", "floor") in on
    assert ("cup", "table") in on
    assert ("floor", "table") not in on
    assert graph == tj.Result.of(tj.Segmentation(labels, ()), tj.Scene(made.scene.points)).graph()
    assert isinstance(graph.relations[0], Relation)
