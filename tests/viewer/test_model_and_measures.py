"""What the viewer shows, without a browser: levels, corrections and undo, colours, the table, clicks in the cloud."""

import json
from contextlib import suppress
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

import torchjoint as tj
from torchjoint.results.edits import Edit, Edits, place_to_split, read_edits, write_edits
from torchjoint.results.embeddings import Embeddings
from torchjoint.results.parts import Parts, edited
from torchjoint.results.render import Shading
from torchjoint.results.result import Result
from torchjoint.results.shared_edits import edits_of_names
from torchjoint.scene import Hierarchy, Scene, Segmentation
from torchjoint.viewer import cloud
from torchjoint.viewer.cloud import blocks_of, pick_point
from torchjoint.viewer.html import panel_html
from torchjoint.viewer.model import Model, export_selected
from torchjoint.viewer.painting import painted, point_colors
from torchjoint.viewer.shown import PARAMETERS

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def result(out):
    return tj.load_result(out, edits=False)


@pytest.fixture
def model(result):
    return Model(result, Edits(Parts(result).count), UP)


def largest(model, count=2):
    return [model.segment_of_hue(row.hue) for row in model.rows()[0][:count]]


def keys_of_points(model):
    return model.parts.keys[model.table][model.parts.of_point]


def test_ids_are_those_on_disk_and_stay_when_others_change(model, result):
    np.testing.assert_array_equal(keys_of_points(model), result.points)
    model.set_granularity(0.9)
    fine = keys_of_points(model)
    assert len(np.unique(fine)) == len(np.unique(model.table)) > result.num_point_segments
    model.set_granularity(0.2)
    assert set(keys_of_points(model)) <= set(range(result.num_point_segments))  # the ids of their first superpoints
    model.set_granularity(None)
    _, second = largest(model)
    before = keys_of_points(model)
    model.select((second,))
    model.split()
    others = model.result.points.numpy() != model.key(second)
    np.testing.assert_array_equal(keys_of_points(model)[others], before[others])


def test_join_split_name_and_undo(model):
    first, second = largest(model)
    start = model.table.copy()
    model.select((first, second))
    model.join()
    joined = min(first, second)
    assert model.selected == (joined,)
    assert (model.table[np.isin(start, (first, second))] == joined).all()
    model.name("table")
    assert model.row(joined).name == "table"
    model.select((joined,))
    model.split()
    assert len(np.unique(model.table)) == len(np.unique(start))
    assert model.undo() == "split"
    assert model.undo() == "name 'table'"
    assert model.names == {}
    assert model.undo() == "join"
    assert {*model.selected} == {first, second}
    np.testing.assert_array_equal(model.table, start)
    assert not model.undo()
    model.select((first,))
    model.name("n" * 200)
    with pytest.raises(ValueError, match="name: expected at most 200 characters, got 201"):
        model.name("n" * 201)
    for action in (model.join, model.split, lambda: model.name("x")):
        model.select(())
        with pytest.raises(ValueError, match="select"):
            action()


@pytest.mark.parametrize("kind", ["PLY", "PNG", "COCO"])
def test_long_names_of_segments_are_cut(model, tmp_path, kind):
    if kind == "COCO":
        pytest.importorskip("pycocotools", reason="COCO needs pycocotools")
    chosen = largest(model, 7)
    model.select(chosen)
    for segment in chosen:
        model.select((segment,))
        model.name("ü" * 120)
    model.select(chosen)
    name, content = export_selected(model, kind)
    (tmp_path / name).write_bytes(content)  # the browser can, too


def last_table(edits, table, hierarchy):
    return [*edits.tables(table, hierarchy)][-1]


def test_a_split_goes_down_the_tree():
    merges = torch.tensor([[0, 1], [2, 3], [1, 2], [3, 4]])
    hierarchy = Hierarchy(torch.arange(5), merges, torch.tensor([0.1, 0.2, 0.3, 0.9], dtype=torch.float64))
    table = np.array([0, 0, 0, 0, 4])
    assert last_table(Edits(5, None, (Edit("split", (1,)),)), table, hierarchy).tolist() == [0, 0, 2, 2, 4]
    twice = last_table(Edits(5, None, (Edit("split", (1,)), Edit("split", (3,)))), table, hierarchy)
    assert twice.tolist() == [0, 0, 2, 3, 4]
    apart = (Edit("join", (3, 4)), Edit("split", (4,)), Edit("split", (4,)))  # 3-4 merge last, so they part first
    assert last_table(Edits(5, None, apart[:2]), table, hierarchy).tolist() == [0, 0, 0, 0, 4]
    assert last_table(Edits(5, None, apart), table, hierarchy).tolist() == [0, 0, 0, 0, 4]  # of one superpoint
    with pytest.raises(ValueError, match="split: expected a segment of several superpoints, got 4"):
        place_to_split(table, 4, np.ones(5), hierarchy)
    with pytest.raises(ValueError, match="split: expected a hierarchy, got none"):
        last_table(Edits(5, None, apart[1:]), table, None)


def test_a_split_is_made_whatever_other_levels_have(model):
    """A name of the finest level, where the segment is one superpoint, forbade the split, but it was shown."""
    (segment,), merges = largest(model, 1), model.result.hierarchy.merges.numpy()
    inside = model.table == segment
    own = merges[inside[merges].all(axis=1)]
    middle = int(np.bincount(own.ravel()).argmax())  # without it, merges do not connect the others
    place = int(np.flatnonzero(inside & (np.arange(len(inside)) != middle))[0])
    steps = Edit("name", (place,), "a part", 1.0), Edit("gather", (middle,))
    model.take(replace(model.edits, steps=steps))
    model.select((place,))
    model.split()
    assert len(model.selected) == 2
    assert model.edits.steps == (*steps, Edit("split", (place,)))
    assert np.array_equal(model.table, model.parts.table(model.edits))
    model.set_granularity(1.0)  # where nothing is to be split
    assert np.array_equal(model.table, model.parts.table(model.edits))


@pytest.mark.parametrize("seed", range(20))
def test_what_is_shown_is_what_is_kept(model, seed):
    rng = np.random.default_rng(seed)
    for _ in range(12):
        segments = np.unique(model.table)
        model.select(tuple(rng.choice(segments, min(len(segments), 1 + seed % 2), replace=False).tolist()))
        action = rng.choice(["join", "split", "name", "click", "level", "undo"])
        with suppress(ValueError):  # which must change nothing
            if action == "name":
                model.name(rng.choice(["", "a", "b"]))
            elif action == "level":
                model.set_granularity(rng.choice([None, 0.0, 0.5, 1.0]))
            elif action == "click":
                model.click(int(rng.integers(len(model.parts.of_point))))
                model.keep()
            else:
                getattr(model, action)()
        assert np.array_equal(model.table, model.parts.table(model.edits))
        assert model.names == model.parts.names(model.edits)


def test_a_split_leaves_crumbs_where_they_are():
    # Superpoints of 50, 40 and 1 points; the crumb is merged last, with the superpoint of 50.
    merges, heights = torch.tensor([[0, 1], [0, 2]]), torch.tensor([0.3, 0.7], dtype=torch.float64)
    hierarchy = Hierarchy(torch.arange(3), merges, heights)
    table, sizes = np.zeros(3, dtype=np.int64), np.array([50, 40, 1])
    assert place_to_split(table, 1, sizes, hierarchy) == (1, 0, 1)
    step = Edit("split", (1, 0, 1))
    assert last_table(Edits(3, None, (step,)), table, hierarchy).tolist() == [0, 1, 0]
    finer = np.arange(3)  # has it already
    assert last_table(Edits(3, None, (step,)), finer, hierarchy).tolist() == [0, 1, 2]
    assert place_to_split(table, 0, np.array([50, 4, 1]), hierarchy) == (0, 0, 1)  # of 55, 4 are enough
    assert place_to_split(table, 0, np.array([500, 4, 1]), hierarchy) == (0, 0, 2)  # crumbs only: the last merge
    with pytest.raises(ValueError, match=r"split: expected a merge of the hierarchy, got superpoints \(1, 2"):
        last_table(Edits(3, None, (Edit("split", (0, 1, 2)),)), table, hierarchy)


def test_both_parts_of_a_split_are_selected_and_written(model, tmp_path):
    (segment,) = largest(model, 1)
    model.select((segment,))
    model.split()
    parts = [model.row(part).points for part in model.selected]
    assert len(parts) == 2
    assert min(parts) >= 0.05 * sum(parts)
    write_edits(tmp_path, model.edits)
    assert read_edits(tmp_path, model.parts.count) == model.edits
    assert model.undo()
    assert model.selected == (segment,)


def test_the_selection_as_coco(model):
    pytest.importorskip("pycocotools", reason="COCO needs pycocotools")
    (segment,) = largest(model, 1)
    model.select((segment,))
    model.split()
    keys = {model.key(part) for part in model.selected}
    assert max(keys) >= model.result.num_point_segments  # one of both is new
    first, second = model.selected
    model.select((first,))
    model.name('"seat"')
    model.select((first, second))
    name, content = export_selected(model, "COCO")
    assert name == f"{model.key(first)}-_seat_-{model.key(second)}.json"  # as Windows takes it
    found = json.loads(content)["annotations"]
    assert {one["segment_id"] for one in found} == keys
    assert {one.get("segment_name") for one in found if one["segment_id"] == model.key(first)} == {'"seat"'}
    assert not any("segment_name" in one for one in found if one["segment_id"] != model.key(first))
    assert all(one["in_cloud"] for one in found)
    sure = {model.key(part): round(model.row(part).sure, 4) for part in model.selected}
    assert {one["segment_id"]: one.get("score") for one in found} == sure


def tree():
    """A result of five superpoints that merge one after the other, the last two only near the root."""
    merges = torch.tensor([[0, 1], [2, 3], [1, 2], [3, 4]])
    hierarchy = Hierarchy(torch.arange(5), merges, torch.tensor([0.1, 0.2, 0.3, 0.9], dtype=torch.float64))
    return tj.Result.of(
        tj.Segmentation(torch.tensor([0, 0, 1, 1, 2]), (), hierarchy=hierarchy), tj.Scene(torch.rand(5, 3))
    )


def levels_of(parts):
    """A granularity for each level of `tree`, from fine to coarse."""
    found = {len(np.unique(parts.level(step / 100))): step / 100 for step in range(101)}
    return [found[count] for count in (5, 4, 3, 2, 1)]


def test_a_name_stays_with_its_segment_and_finer_ones():
    model = Model(tree(), Edits(5), UP)
    finest, _, fine, coarse, whole = levels_of(model.parts)
    model.set_granularity(fine)
    model.select((2,))
    model.name("chair")
    assert model.names == {2: "chair"}
    for level, names in ((coarse, {}), (whole, {}), (finest, {2: "chair", 3: "chair"}), (None, {2: "chair"})):
        model.set_granularity(level)
        assert model.names == names
    # The name of a part counts more than that of the whole, whichever came first; "" takes a name away.
    model.set_granularity(finest)
    model.select((3,))
    model.name("seat")
    model.set_granularity(coarse)
    model.select((0,))
    model.name("furniture")
    model.set_granularity(finest)
    assert model.names == {0: "furniture", 1: "furniture", 2: "chair", 3: "seat"}
    model.select((3,))
    model.name("")
    assert model.names == {0: "furniture", 1: "furniture", 2: "chair"}


def test_a_name_and_the_selection_stay_with_most_points():
    merges, heights = torch.tensor([[1, 2], [0, 1]]), torch.tensor([0.2, 0.4], dtype=torch.float64)
    hierarchy = Hierarchy(torch.tensor([0, 1, 1, 1, 2, 2]), merges, heights)
    segmentation = tj.Segmentation(torch.zeros(6, dtype=torch.int64), (), hierarchy=hierarchy)
    result = tj.Result.of(segmentation, tj.Scene(torch.rand(6, 3)))
    model = Model(result, Edits(3), UP)
    model.select((0,))
    for level, segment in ((1.0, 1), (None, 0)):
        model.set_granularity(level)
        assert model.selected == (segment,)
    model.name("box")
    model.split()
    assert model.names == {1: "box"}
    assert model.table.tolist() == [0, 1, 1]  # the first superpoint is the smallest
    assert edits_of_names(result, {0: "box"}, model.parts.of_point) == (Edit("name", (1,), "box"),)
    older = Edits(3, None, (Edit("name", (0,), "box"), model.edits.steps[-1]))
    assert model.parts.names(older) == {0: "box"}


def test_a_join_takes_the_name_along_and_a_level_is_kept(tmp_path):
    model = Model(tree(), Edits(5), UP)
    fine = levels_of(model.parts)[2]
    model.set_granularity(fine)
    model.select((0,))
    model.name("table")
    model.select((0, 4))
    model.join()
    assert model.names == {0: "table"}
    model.set_granularity(0.0)
    write_edits(tmp_path, model.edits)
    assert read_edits(tmp_path, 5) == model.edits
    assert edited(model.result, replace(model.edits, granularity=fine)).segment_names == {0: "table"}


def test_a_later_correction_leaves_the_ids_of_earlier_ones(model, result):
    large = largest(model)
    model.select((max(large),))
    model.split()
    of_first = keys_of_points_on_disk(model)
    model.select((min(large),))
    model.split()
    of_both = keys_of_points_on_disk(model)
    new = result.num_point_segments
    np.testing.assert_array_equal(of_first == new, of_both == new)
    assert (of_both == new + 1).any()
    np.testing.assert_array_equal(of_both, model.measures.ids[model.parts.of_point])


def keys_of_points_on_disk(model):
    return edited(model.result, model.edits).points.numpy()


@pytest.fixture
def picked():
    """A model of six superpoints, one point each: ((0 1) .2, (2 3) .4) .6, (4 5) .3, and all at .9."""
    merges = torch.tensor([[0, 1], [2, 3], [1, 2], [4, 5], [0, 5]])
    hierarchy = Hierarchy(torch.arange(6), merges, torch.tensor([0.2, 0.4, 0.6, 0.3, 0.9], dtype=torch.float64))
    points = torch.arange(6.0)[:, None] * torch.tensor([1.0, 0, 0])
    vectors = Embeddings(torch.eye(3), hierarchy.at())
    segmentation = tj.Segmentation(hierarchy.at(), (), hierarchy=hierarchy)
    result = replace(tj.Result.of(segmentation, tj.Scene(points)), saved_embeddings=vectors)
    return Model(result, Edits(6), UP)


def test_clicks_walk_the_tree(picked, tmp_path):
    before = picked.table.tolist()
    assert before == [0, 0, 2, 2, 4, 4]
    for click, expected in (
        ((0, True), [0, 0, 2, 2, 4, 4]),  # the segment of the level
        ((3, True), [0, 0, 0, 0, 4, 4]),  # the smallest with both
        ((1, False), [0, 1, 0, 0, 4, 4]),
    ):
        picked.click(*click)
        assert picked.table.tolist() == expected
        assert picked.selected == (0,)
    assert picked.row(0).points == 3
    assert picked.edits.steps == ()
    picked.unclick()
    assert picked.table.tolist() == [0, 0, 0, 0, 4, 4]
    with pytest.raises(ValueError, match="negative: expected points apart from the chosen ones"):
        picked.click(3, False)
    assert picked.clicks == ((0, True), (3, True))
    picked.select((4,))  # something else: nothing was corrected
    assert (picked.table.tolist(), picked.clicks, picked.selected) == (before, (), (4,))
    with pytest.raises(ValueError, match="one thing: expected clicks on a thing, got none"):
        picked.keep()
    with pytest.raises(ValueError, match="expected at least one point"):
        picked.click(0, False)


def test_what_was_clicked_becomes_one_thing(picked, tmp_path):
    def click():
        for one in ((0, True), (3, True), (1, False)):
            picked.click(*one)

    click()
    picked.keep()
    assert picked.clicks == ()
    assert picked.edits.steps == (Edit("gather", (0, 2, 3)),)
    write_edits(tmp_path, picked.edits)
    assert read_edits(tmp_path, 6) == picked.edits
    assert edited(picked.result, picked.edits).points.tolist() == [0, 3, 0, 0, 2, 2]
    assert picked.measures.ids[picked.parts.of_point].tolist() == [0, 3, 0, 0, 2, 2]  # the page says the same
    for level, expected in ((1.0, [0, 1, 0, 0, 4, 5]), (0.0, [0, 1, 0, 0, 1, 1])):
        picked.set_granularity(level)
        assert picked.table.tolist() == expected
    picked.set_granularity(None)
    assert picked.undo()
    click()
    picked.name("chair")  # keeps it, too
    assert picked.names == {0: "chair"}
    assert [step.kind for step in picked.edits.steps] == ["gather", "name"]
    assert picked.undo()
    assert picked.table.tolist() == [0, 0, 2, 2, 4, 4]


def test_clicks_begin_at_the_shown_level(picked):
    picked.set_granularity(0.0)
    for point in (0, 1):  # they are in one segment of the stored level, too
        picked.click(point)
        assert picked.table.tolist() == [0] * 6
    picked.click(5, False)
    assert picked.table.tolist() == [0, 0, 0, 0, 4, 4]
    picked.set_granularity(1.0)
    picked.click(0)
    assert picked.table.tolist() == [0, 1, 2, 3, 4, 5]
    picked.select((0, 1))
    picked.join()
    picked.click(1)
    assert picked.selected == (0,)  # with its corrections
    assert picked.table.tolist() == [0, 0, 2, 3, 4, 5]
    picked.select((0, 4))
    picked.join()
    for point in (1, 4):
        picked.click(point)
        assert picked.table.tolist() == [0, 0, 2, 3, 0, 5]


def test_words_find_segments_of_any_level(picked):
    assert picked.find(torch.tensor([0, 0, 1.0]), 1) == [(4, 1.0)]
    picked.set_granularity(0.3)  # the first two are one
    ((segment, cosine), _) = picked.find(torch.tensor([1.0, 0, 0]))
    assert segment == 0
    assert cosine == pytest.approx(0.5**0.5)
    picked.result = replace(picked.result, saved_embeddings=None)
    assert picked.find(torch.tensor([1.0, 0, 0])) == []


def test_names_of_an_older_file(tmp_path):
    parts = Parts(tree())
    fine, coarse = levels_of(parts)[2:4]
    text = '{"pieces": 5, "granularity": %s, "edits": [{"kind": "name", "pieces": [2], "name": "chair"}]}'
    (tmp_path / "edits.json").write_text(text % fine)
    edits = read_edits(tmp_path, 5)
    assert parts.names(edits) == {2: "chair"}
    assert parts.names(replace(edits, granularity=coarse)) == {}


@pytest.mark.parametrize(
    ("then", "names"),
    [
        ([0] * 60 + [2] * 10 + [1] * 30, {0: "table", 60: "lamp"}),
        ([0] * 70 + [1] * 30, {0: "table"}),  # the lamp's is not that of the rest, which nobody has named
        ([0] * 68 + [1] * 22 + [2] * 10, {0: "table"}),  # nor that of something with two of its points
        ([0] * 64 + [1] * 6 + [2] * 30, {0: "table", 64: "lamp"}),
    ],
)
def test_names_of_a_run_wait_for_their_things(then, names):
    """A thing that another took for a while lost its name, or gave it to something else; names of masks came first."""
    scene, up = Scene(torch.rand(100, 3)), np.array([0.0, 0.0, 1.0])
    model = Model(Result.of(Segmentation(torch.tensor([0] * 60 + [1] * 10 + [2] * 30), ()), scene), Edits(3), up)
    for segment, name in enumerate(("table", "lamp")):
        model.select((segment,))
        model.name(name)
    for labels in ([0] * 70 + [1] * 30, then):  # the table takes the lamp
        before = model
        shown = Result.of(Segmentation(torch.tensor(labels), ()), scene)
        model = before.of_result(replace(shown, segment_names={0: "of a mask"}))
        model.take_names(before, False)
    first = {int(np.flatnonzero(model.parts.of_point == one)[0]): name for one, name in model.names.items()}
    assert first == names
    assert [name for name, *_ in model.waiting] == ([] if "lamp" in names.values() else ["lamp"])


def test_what_one_click_did_is_undone_at_once(model):
    segments = largest(model, 3)
    start = model.table.copy()
    model.select(tuple(segments))
    model.join()
    for name in ("b", "be", "bed"):  # as it is typed
        model.name(name)
    assert model.undo()
    assert model.names == {}
    assert model.undo()
    np.testing.assert_array_equal(model.table, start)
    assert not model.undo()


def test_corrections_lie_on_top_of_the_labels(out, result, model, tmp_path):
    first, second = largest(model)
    edits = Edits(model.parts.count, None, (Edit("join", (first, second)), Edit("name", (first,), "Tisch <ö>")))
    for name in ("points.npz", "run.yaml", "hierarchy.npz", "cameras.json", "manifest.json"):
        (tmp_path / name).write_bytes((out / name).read_bytes())
    for name in ("images", "pieces", "inputs"):
        (tmp_path / name).symlink_to(out / name)
    write_edits(tmp_path, edits)
    assert read_edits(tmp_path, model.parts.count).steps == edits.steps
    read = tj.load_result(tmp_path)
    assert len(read.points.unique()) == result.num_point_segments - 1
    alone = ~np.isin(result.points, [model.key(first), model.key(second)])
    np.testing.assert_array_equal(read.points[alone], result.points[alone])  # other segments keep their ids
    (segment,) = read.segment_names
    assert read.segment_names[segment] == "Tisch <ö>"
    both = np.isin(result.points, [model.key(first), model.key(second)])
    np.testing.assert_array_equal(read.points == segment, both)
    for got, stored in zip(read.images, result.images, strict=True):
        np.testing.assert_array_equal(got == segment, np.isin(stored, [model.key(first), model.key(second)]))
    assert torch.equal(tj.load_result(tmp_path, edits=False).points, result.points)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[", "not a list of edits"),
        ('{"pieces": 5, "granularity": null, "edits": []}', r"expected edits of \d+ superpoints, got 5"),
        (
            '{"pieces": PIECES, "granularity": null, "edits": [{"kind": "burn", "pieces": [1]}]}',
            "expected an edit, got",
        ),
        (
            '{"pieces": PIECES, "granularity": null, "edits": [{"kind": "join", "pieces": [1]}]}',
            "expected an edit, got",
        ),
        (
            '{"pieces": PIECES, "granularity": null, "edits": [{"kind": "split", "pieces": [-1]}]}',
            "expected superpoints below",
        ),
        (
            '{"pieces": PIECES, "granularity": null, "edits": [{"kind": "split", "pieces": [0, 1]}]}',
            "expected an edit, got",
        ),
        (
            '{"pieces": PIECES, "granularity": null, "edits": [{"kind": "gather", "pieces": []}]}',
            "expected an edit, got",
        ),
        *(
            (
                f'{{"pieces": PIECES, "granularity": null, "edits": [{{"kind": "name", "pieces": [{superpoint}]}}]}}',
                message,
            )
            for superpoint, message in (
                ("true", "superpoints: expected an integer, got True"),
                ("1.9", "superpoints: expected an integer, got 1.9"),
                ('"12"', "superpoints: expected an integer, got '12'"),
                ("Infinity", "superpoints: expected an integer, got inf"),
            )
        ),
        (
            '{"pieces": PIECES, "granularity": null, "edits": [{"kind": "name", "pieces": [0], "name": 5}]}',
            "name: expe",
        ),
        (
            '{"pieces": PIECES, "granularity": null, "edits": [{"kind": "name", "pieces": [0], "name": "\\ud800"}]}',
            "name: expected a text",
        ),
        ('{"pieces": Infinity, "granularity": null, "edits": []}', "superpoints: expected an integer, got inf"),
        ('{"pieces": "PIECES", "granularity": null, "edits": []}', "superpoints: expected an integer, got '"),
        ('{"pieces": true, "granularity": null, "edits": []}', "superpoints: expected an integer, got True"),
        ('{"pieces": PIECES, "granularity": Infinity, "edits": []}', "granularity: expected a number from 0"),
        ('{"pieces": PIECES, "granularity": NaN, "edits": []}', "granularity: expected a number from 0"),
        ('{"pieces": PIECES, "granularity": true, "edits": []}', "granularity: expected a number from 0"),
        ('{"pieces": PIECES, "granularity": "0.5", "edits": []}', "granularity: expected a number from 0"),
        (
            '{"pieces": PIECES, "granularity": 0, "edits": [{"kind": "name", "pieces": [0], "granularity": 2}]}',
            "granularity: expected a number from 0",
        ),
    ],
)
def test_damaged_corrections(model, tmp_path, text, message):
    (tmp_path / "edits.json").write_text(text.replace("PIECES", str(model.parts.count)))
    with pytest.raises(ValueError, match=rf"edits\.json: .*{message}"):
        read_edits(tmp_path, model.parts.count)


def test_a_result_without_levels_can_be_joined(result):
    flat = tj.Result.of(tj.Segmentation(result.points, list(result.images), names=result.names), result.scene)
    after = edited(flat, Edits(flat.num_point_segments, None, (Edit("join", (0, 2)),)))
    np.testing.assert_array_equal(after.points == 0, np.isin(result.points, [0, 2]))
    np.testing.assert_array_equal(after.images[0] == 0, np.isin(result.images[0], [0, 2]))
    private = result.images[0] >= result.num_point_segments
    np.testing.assert_array_equal(after.images[0][private] + 1, result.images[0][private])


def test_what_is_selected_is_lit_and_the_rest_fades(model):
    first, _ = largest(model)
    before = point_colors(model).astype(int)
    model.select((first,))
    after = point_colors(model).astype(int)
    lit = model.table[model.parts.of_point] == first
    np.testing.assert_array_equal(after[lit], before[lit])
    assert after[~lit].min() > 190
    index = max(range(6), key=lambda i: (model.parts.image(i) >= 0).sum())
    seen = np.isin(model.parts.image(index), np.nonzero(model.table == first)[0])
    plain = model.result.scene.frames[index].image.permute(1, 2, 0).numpy() * 255
    changed = np.abs(painted(model, index, 0.5).astype(int) - plain).max(2) > 1
    assert changed[seen].mean() > 0.9


def test_light_shows_walls_and_floor_and_edges_are_dark():
    steps = torch.linspace(0, 1, 30)
    u, v = (one.flatten() for one in torch.meshgrid(steps, steps, indexing="ij"))
    zero = torch.zeros_like(u)
    faces = [torch.stack(face, 1) for face in ((u, v, zero), (u, zero - 1, v + 1), (zero - 1, u, v + 1))]
    shading = Shading(torch.cat(faces), UP)
    flat = shading.of(np.zeros(2700, dtype=np.int64)).reshape(3, 900)
    assert flat.std(1).max() < 0.01
    assert np.diff(np.sort(flat.mean(1))).min() > 0.05  # three shades
    labels = (u.repeat(3) > 0.5).numpy().astype(np.int64)
    changed = shading.of(labels).reshape(3, 900) < 0.8 * flat
    near = (u - 0.5).abs().numpy() < 0.02  # the two rows at the edge
    assert changed[:, near].all()
    assert not changed[:, (u - 0.5).abs().numpy() > 0.1].any()


def test_the_size_of_a_selected_segment_names_no_unit(model):
    """A survey may be in feet."""
    row = model.row(largest(model)[0])
    size = " × ".join(f"{value:.2f}" for value in row.size)
    assert f"{row.points} points, {size}, " in panel_html([row], [])


def test_another_thread_asks_while_edges_are_found(monkeypatch):
    shading, where, found = Shading(torch.rand(200, 3), UP), np.where, []
    labels = np.arange(200) % 2

    def asks_meanwhile(*arguments):
        if not found:
            found.append(None)
            found[0] = shading.of(labels)
        return where(*arguments)

    monkeypatch.setattr(np, "where", asks_meanwhile)
    np.testing.assert_array_equal(shading.of(labels), found[0])


def test_only_labels_are_shaded(model):
    flat = point_colors(model).astype(float)
    model.shading = Shading(model.result.scene.points, UP)
    shaded = point_colors(model)
    factor = shaded / np.maximum(flat, 1)
    assert (shaded.max(1) < flat.max(1)).mean() > 0.9
    assert np.ptp(np.where(flat > 60, factor, np.nan), axis=1)[(flat > 60).all(1)].max() < 0.03  # the hue stays
    model.mode = "colours"
    own = model.result.scene.colors.numpy() * 255
    np.testing.assert_array_equal(point_colors(model), own.round().astype(np.uint8))


@pytest.mark.parametrize("mode", ["segments", "colours", "confidence", "initial"])
def test_every_mode_has_colours(model, mode):
    assert mode in model.modes
    assert "truth" not in model.modes
    model.mode = mode
    assert point_colors(model).shape == (6000, 3)
    assert painted(model, 0, 0.5).shape == (120, 160, 3)


def test_the_table_sorts_and_searches(model, result):
    rows, count = model.rows()
    assert count == result.num_point_segments
    assert [row.points for row in rows] == sorted((row.points for row in rows), reverse=True)
    assert sum(row.points for row in rows) == 6000
    assert [row.key for row in model.rows(order="id")[0]] == list(range(count))
    assert rows[0].frames is None
    model.measures.read_frames()
    seen = [row.frames for row in model.rows(order="frames")[0]]
    assert seen == sorted(seen, reverse=True)
    assert seen[0] == max(sum(bool((i == k).any()) for i in result.images) for k in range(count))
    model.select((model.segment_of_hue(2),))
    model.name("Mug")
    assert [row.key for row in model.rows("mug")[0]] == [2]
    assert model.rows(order="name")[0][0].key == 2
    assert model.rows("2")[0][0].key == 2
    assert model.rows(most=3)[1] == count


def test_a_click_takes_the_surface_in_front():
    wall = np.array([[x / 10, y / 10, 2.0] for x in range(-5, 6) for y in range(-5, 6)])
    points = np.concatenate([wall + np.array([0, 0, 1]), wall])
    hit = pick_point(points, np.zeros(3), np.array([0.0, 0.0, 3.0]), 0.05)
    assert points[hit].tolist() == [0, 0, 2]
    assert pick_point(points, np.zeros(3), np.array([0.0, 0.0, -1.0]), 0.05) is None
    assert pick_point(points, np.zeros(3), np.array([1.0, 0.0, 0.1]), 0.05) is None


def test_blocks_hold_every_point_once():
    points = np.random.default_rng(0).normal(size=(1000, 3)).astype(np.float32)
    points[:400] = 0  # equal points cannot be cut apart by position
    blocks = blocks_of(points, 64)
    assert max(map(len, blocks)) <= 64
    assert sorted(np.concatenate(blocks).tolist()) == list(range(1000))


def test_points_of_a_thinned_survey_leave_no_gaps(monkeypatch):
    """Neither those of the sample nor all points, which are spread at random."""
    monkeypatch.setattr(cloud, "SAMPLE", 2000)
    points = np.random.default_rng(0).random((20_000, 3)) * [1, 1, 0]
    view = cloud.CloudView(mock.MagicMock(), points, np.zeros_like(points, dtype=np.uint8))
    places = np.random.default_rng(1).uniform(0.1, 0.9, (20_000, 3)) * [1, 1, 0]
    for parts, radii in ((view._parts[::2], view._sparse), (view._parts, view._whole)):
        away, _ = cKDTree(points[np.concatenate(parts)]).query(places)
        assert (away > np.median(radii)).mean() < 0.0005


def test_a_static_page_is_whole_and_upright(out, run, tmp_path, capsys):
    run("show", out, "--static", tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert text.count("data:image/jpeg;base64,") == 6
    assert "<script src=" not in text  # needs no network
    assert len(text) < 600_000
    assert "6000 points" in text
    assert str(tmp_path / "page.html") in capsys.readouterr().out
    assert json.loads((out / "segments.json").read_text())["up"][2] > 0.99


def test_a_run_in_memory_is_computed_again(scene_of):
    from torchjoint.viewer.shown import LiveRun

    scene = scene_of(3, num_points=6000).scene
    segmenter = tj.JointSegmenter(tj.Config().set(["point_segments.method=paper", "boundary.detector=gradient"]))
    before = segmenter(scene)
    run = LiveRun(segmenter, scene)
    assert tuple(run.parameters) == PARAMETERS["paper"]
    assert torch.equal(run.compute(run.parameters).points, before.points)
    values = run.parameters | {"paper.scale": 2.0, "paper.min_size": 30.0}
    config = segmenter.config.set(["paper.scale=2", "paper.min_size=30"])
    again = run.compute(values)
    assert again.config == config
    assert torch.equal(again.points, segmenter.compute(images=False, config=config).points)
    assert not torch.equal(again.points, before.points)
    with pytest.raises(ValueError, match=r"paper\.min_size: expected"):
        run.compute({"paper.min_size": -5.0})


@pytest.mark.parametrize("method", PARAMETERS)
def test_live_parameters_need_no_frames_again(method):
    config = tj.Config().set([f"point_segments.method={method}"])
    for name in PARAMETERS[method]:
        stage, _, parameter = name.partition(".")
        value = getattr(getattr(config, stage), parameter)
        changed = config.replace({stage: {parameter: value + (1 if isinstance(value, int) else 0.01)}})
        assert tj.config.evidence_differences(config, changed) == []


@pytest.mark.slow
def test_labels_so_far_change_nothing(scene_of):
    pytest.importorskip("viser")
    from torchjoint.viewer.live import labels_so_far

    scene, config = scene_of(3, num_points=6000).scene, tj.Config().set(["boundary.detector=gradient"])
    segmenter = tj.JointSegmenter(config)
    looks = [labels_so_far(segmenter, scene) for _ in segmenter.steps(scene, batch_size=3)]
    watched, plain = segmenter.compute(), tj.JointSegmenter(config)(scene)
    assert torch.equal(watched.points, plain.points)
    assert all(torch.equal(one, other) for one, other in zip(watched.images, plain.images, strict=True))
    first, second, last = looks  # before the first frame, after three, after all
    assert bool((first.images[0] == -1).all())
    assert bool((second.images[0] >= 0).any())
    assert bool((second.images[3] == -1).all())
    # The last look is the result; pixels of image segments without points have no label.
    assert torch.equal(last.points, plain.points)
    image = plain.images[4]
    of_cloud = image < plain.num_point_segments
    assert torch.equal(last.images[4][of_cloud], image[of_cloud])
    assert bool((last.images[4][~of_cloud] == -1).all())


def test_segments_keep_their_numbers():
    from torchjoint.viewer.measures import kept_numbers

    before = np.array([7, 7, 7, 2, 2, 4])

    def kept(*segment):
        return kept_numbers(np.array(segment), before, np.full(6, 9)).tolist()

    assert kept(2, 2, 2, 0, 0, 1) == [2, 4, 7, 9, 9, 9]
    # 0 and 1 share two points each with 7 and 2; 2 is what 4 was; 3 is new and gets the lowest number that is free.
    assert kept(0, 0, 1, 1, 1, 2) == [7, 2, 4, 9, 9, 9]
    assert kept(0, 0, 3, 1, 1, 2) == [7, 2, 4, 0, 9, 9]


def test_colours_stay_when_another_result_is_shown():
    labels = torch.tensor([0, 0, 0, 1, 1, 2])
    scene = Scene(torch.rand(6, 3))
    first = Model(Result.of(Segmentation(labels, ()), scene), Edits(3), UP)
    second = first.of_result(Result.of(Segmentation(torch.tensor([1, 1, 1, 0, 2, 3]), ()), scene), Edits(4))
    one, other = point_colors(first), point_colors(second)
    assert (one == other).all(1).tolist() == [True, True, True, True, False, True]
    assert [row.hue for row in second.rows()[0]] != [row.key for row in second.rows()[0]]
    assert len(np.unique(other, axis=0)) == 4


def test_looking_at_a_run_takes_a_bounded_share_of_its_time(monkeypatch):
    pytest.importorskip("viser")
    from types import SimpleNamespace

    from torchjoint.viewer import live

    clock, looks = [0.0], []

    class Look(live.LiveView):
        def _show(self, segmenter, scene):
            looks.append(clock[0])
            clock[0] += 2.0
            self.viewer = SimpleNamespace(tell=lambda note: None)

    monkeypatch.setattr(live.time, "monotonic", lambda: clock[0])
    view, segmenter = Look(), SimpleNamespace(state=SimpleNamespace(observations=()))
    for _ in range(60):
        view(segmenter, tj.Scene(torch.rand(3, 3)))
        clock[0] += 1.0
    assert looks == [0, 3, 23, 43, 63]  # the page; the first labels of images; then 2 of each 20 seconds


def test_lines_show_the_relations_of_what_is_selected():
    from torchjoint.results.relations import Relation
    from torchjoint.viewer.painting import COLORS, lines

    found = (Relation("stands on", 1, 0, 0.1, 1.0), Relation("touches", 0, 2, 0.1, 1.0))
    points = np.array([[0, 0, 0], [2, 0, 0], [1, 0, 4], [9, 9, 9]], dtype=np.float32)
    labels = np.array([0, 0, 1, 2])
    ends, colors = lines(found, points, labels, ())
    assert ends.tolist() == [[[1, 0, 4], [1, 0, 0]]]
    assert colors.tolist() == [[[*COLORS["stands on"]]] * 2]
    ends, colors = lines(found, points, labels, (2,))
    assert ends.tolist() == [[[1, 0, 0], [9, 9, 9]]]
    assert lines(found, points, labels, (7,))[0].shape == (0, 2, 3)
