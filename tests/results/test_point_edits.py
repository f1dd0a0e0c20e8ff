"""Labels of points: out, edited in another program, and back."""

import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import torchjoint as tj
from torchjoint.results.edits import Edit, Edits
from torchjoint.results.exports.boxes import export_point_labels
from torchjoint.results.folder import write_result
from torchjoint.results.parts import Parts
from torchjoint.results.shared_edits import ForeignLabels, edits_of_points, read_point_labels, without_older


def parts_of(superpoint, stored):
    """A result whose superpoints [N] form the stored segments [P]."""
    superpoint, stored = torch.tensor(superpoint), torch.tensor(stored)
    scene = tj.Scene(torch.arange(3.0 * len(superpoint)).reshape(-1, 3))
    result = tj.Result.of(tj.Segmentation(stored[superpoint].unique(return_inverse=True)[1], ()), scene)
    parts = Parts(result)
    vars(parts).update(of_point=superpoint.numpy(), stored=stored.numpy())  # as of a hierarchy
    return parts


def changes_of(parts, of_point, names=None, before=None):
    labels = ForeignLabels(np.array(of_point), names or {})
    return edits_of_points(parts, before or Edits(parts.count), labels)


#: Four superpoints of two points each; the first two form segment 0, the others 1.
SUPERPOINTS, STORED = [0, 0, 1, 1, 2, 2, 3, 3], [0, 0, 1, 1]


def test_what_nobody_edited_changes_nothing():
    assert changes_of(parts_of(SUPERPOINTS, STORED), [7, 7, 7, 7, 3, 3, 3, 3]) == ((), 0)
    assert changes_of(parts_of(SUPERPOINTS, STORED), [0] * 8) == ((), 0)  # all objects were deleted


def test_many_names_of_many_superpoints_take_little_memory():
    parts = parts_of(range(50_000), np.arange(50_000) // 100)
    steps = tuple(Edit("name", (100 * segment,), f"tree {segment}") for segment in range(500))
    tracemalloc.start()
    assert len(parts.names(Edits(parts.count, steps=steps))) == 500
    assert tracemalloc.get_traced_memory()[1] < 8e6  # a table of all superpoints for each name: 25 MB
    tracemalloc.stop()


@pytest.mark.parametrize("name", ["thing", " a chair "])
def test_a_name_that_files_hold_in_another_way_is_not_edited(name):
    parts, told = parts_of(SUPERPOINTS, STORED), "" if name == "thing" else name.strip()
    before = Edits(parts.count, steps=(Edit("name", (0,), name),))
    assert changes_of(parts, [7, 7, 7, 7, 3, 3, 3, 3], {7: told}, before) == ((), 0)


def test_superpoints_go_to_the_object_of_most_of_their_points():
    parts = parts_of(SUPERPOINTS, STORED)
    assert changes_of(parts, [7, 7, 3, 3, 3, 3, 3, 3])[0] == (Edit("gather", (1, 2, 3)),)
    assert changes_of(parts, [7, 7, 7, 7, 3, 3, 4, 4])[0] == (Edit("gather", (3,)),)
    assert changes_of(parts, [7] * 8)[0] == (Edit("gather", (0, 1, 2, 3)),)
    # Points without an object follow their segment, and those that are fewer their superpoint.
    assert changes_of(parts, [7, 7, 0, 0, 7, 7, 7, 7])[0] == (Edit("gather", (0, 1, 2, 3)),)
    assert changes_of(parts, [7, 7, 0, 0, 3, 3, 3, 7]) == ((), 1)


def test_older_labels_with_a_moved_superpoint_are_refused(tmp_path):
    """What was moved gave its object another number, so that the later join did not count."""
    parts = parts_of(range(5), [0, 0, 1, 2, 2])
    before = Edits(parts.count, steps=(Edit("join", (4, 1)),))
    steps, _ = changes_of(parts, [1, 1, 3, 3, 3], before=before)
    with pytest.raises(ValueError, match=r"more like those before the last joins or splits by hand \(1\)"):
        without_older(steps, parts, before, tmp_path / "label.json")
    assert without_older(steps[:0], parts, before, tmp_path / "label.json") == ()


def test_names_are_those_after_the_edits():
    parts = parts_of(SUPERPOINTS, STORED)
    before = Edits(4, None, (Edit("name", (1,), "chair"),))
    assert changes_of(parts, [7, 7, 7, 7, 3, 3, 3, 3], {7: "chair", 3: "", 9: "gone"}, before) == ((), 0)
    with pytest.warns(UserWarning, match="1 empty names change nothing; the viewer removes names"):
        assert changes_of(parts, [7, 7, 7, 7, 3, 3, 3, 3], {7: "thing", 3: ""}, before) == ((), 0)
    # The named superpoint leaves, so its segment has to be named again.
    steps, _ = changes_of(parts, [7, 7, 3, 3, 3, 3, 3, 3], {7: "chair", 3: "desk"}, before)
    assert steps == (
        Edit("gather", (1, 2, 3)),
        Edit("name", (1,), "desk"),
        Edit("name", (0,), "chair"),
    )


@given(st.data())
def test_the_edits_make_the_objects(data):
    """Where each superpoint has one object, the segments after the edits are the objects."""
    count = data.draw(st.integers(1, 8))
    numbers = st.lists(st.integers(0, 3), min_size=count, max_size=count)
    stored, wanted = data.draw(numbers), np.array(data.draw(numbers)) + 1
    joins = data.draw(st.lists(st.tuples(*[st.integers(0, count - 1)] * 2), max_size=2))
    before = Edits(count, None, tuple(Edit("join", pair) for pair in joins))
    parts = parts_of(list(range(count)), stored)
    steps = changes_of(parts, wanted, before=before)[0]
    table = parts.table(replace(before, steps=before.steps + steps))
    assert np.array_equal(table[:, None] == table, wanted[:, None] == wanted)


def test_the_round_trip_of_the_command_line(run, scene_of, tmp_path, capsys):
    config = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])
    scene, out, file = scene_of(3).scene, tmp_path / "out", tmp_path / "points.json"
    out.mkdir()
    write_result(out, scene, tj.JointSegmenter(config)(scene), config, "test")
    run("export", out, "--format", "segmentsai", "-o", file)
    label = json.loads(file.read_text())
    before = tj.load_result(out)
    assert label["point_annotations"] == (before.points + 1).tolist()
    assert label["annotations"][1] == {"id": 2, "category_id": 1, "attributes": {"name": ""}}
    run("edits", "import", out, file)
    assert "things gathered: 0, joined to others: 0, names changed: 0" in capsys.readouterr().out
    assert not (out / "edits.json").exists()
    superpoints = before.hierarchy.superpoint
    moved = (
        superpoints == superpoints[before.points == before.points.bincount().argmax()][0]
    )  # one piece of the largest
    ids = torch.where(moved | (before.points == 0), 1, before.points + 1)
    label["point_annotations"] = ids.tolist()
    label["annotations"][0]["attributes"]["name"] = "a thing of two"
    file.write_text(json.dumps({"attributes": label}))
    run("edits", "import", out, file)
    assert "things gathered: 1, joined to others: 0, names changed: 1" in capsys.readouterr().out
    after = tj.load_result(out)
    same = torch.stack([after.points, ids]).unique(dim=1)
    assert same.shape[1] == after.points.unique().numel() == ids.unique().numel()
    assert after.segment_names == {int(after.points[ids == 1][0]): "a thing of two"}
    export_point_labels(file, after)
    run("edits", "import", out, file)
    assert capsys.readouterr().out == "things gathered: 0, joined to others: 0, names changed: 0\n"
    label = json.loads(file.read_text())
    label["point_annotations"] = [0 if one == 1 else one for one in label["point_annotations"]]
    file.write_text(json.dumps(label))
    run("edits", "import", out, file)
    assert "things without a labelled point stay (join them in the viewer): 1\n" in capsys.readouterr().out
    corrections = (out / "edits.json").read_bytes()
    label["point_annotations"] = torch.randint(1, 9, (len(ids),), generator=torch.Generator().manual_seed(0)).tolist()
    label["annotations"] = []
    file.write_text(json.dumps(label))
    with pytest.raises(
        SystemExit, match=r"points\.json: is it of another result than .*\? \d+ points have another label"
    ):
        run("edits", "import", out, file)
    assert (out / "edits.json").read_bytes() == corrections


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[1]", "expected an object, got list"),
        ('{"point_annotations": [1, 2], "annotations": []}', "expected ids >= 0 of 3 points, got 2"),
        ('{"point_annotations": [1, -2, 1], "annotations": []}', "expected ids >= 0"),
        ('{"point_annotations": [1, 2.5, 1], "annotations": []}', "expected a list of integers"),
        ('{"point_annotations": [1, 2, 1]}', "annotations: missing"),
        (
            '{"point_annotations": [1, 2, 1], "annotations": [{"id": 1, "attributes": {"name": 3}}]}',
            "expected a string, got 3",
        ),
        ('{"point_annotations": [1, 2, 1], "annotations": [{"attributes": {"name": "a"}}]}', "id: missing"),
        (
            '{"point_annotations": [1, 2, 1], "annotations": [{"id": 1, "attributes": {"name": "a"}}, '
            '{"id": 1, "attributes": {"name": "b"}}]}',
            "object 1 is there twice",
        ),
    ],
)
def test_what_is_wrong_is_named(tmp_path, content, message):
    (tmp_path / "a.json").write_text(content)
    with pytest.raises(ValueError, match=message):
        read_point_labels(tmp_path / "a.json", 3)


def test_other_files_have_no_labels(tmp_path):
    (tmp_path / "a.json").write_text('{"objects": []}')
    assert read_point_labels(tmp_path / "a.json", 3) is None
    assert read_point_labels(tmp_path / "boxes.txt", 3) is None
