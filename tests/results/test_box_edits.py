"""Boxes around things: out, edited in another program, and back."""

import csv
import json
import math
import tracemalloc
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from damage import CLEAR, damages
from hypothesis import given
from hypothesis import strategies as st

import torchjoint as tj
from torchjoint.datasets import load_cloud
from torchjoint.results import shared_edits as box_edits
from torchjoint.results.boxes import (
    Box,
    boxes_of,
    datumaro_record,
    labelcloud_classes,
    labelcloud_record,
    openpcdet_lines,
    read_boxes,
    segmentsai_label,
    upright_points,
)
from torchjoint.results.edits import Edit, Edits, read_edits, write_edits
from torchjoint.results.exports import SUFFIXES
from torchjoint.results.exports.boxes import (
    export_csv,
    export_cuboids,
    export_cvat,
    export_geojson,
    export_labelcloud,
    export_openpcdet,
    export_point_labels,
)
from torchjoint.results.folder import write_result
from torchjoint.results.parts import Parts

UP_X = torch.tensor([1.0, 0, 0])


def block(center, size, yaw, count=400, seed=0):
    """Points on the sides of a block, its corners among them."""
    random = np.random.default_rng(seed)
    own = random.uniform(-0.5, 0.5, (count, 3))
    own[np.arange(count), random.integers(0, 3, count)] = random.choice([-0.5, 0.5], count)
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    x, y, z = (np.concatenate([corners, own]) * size).T
    turned = np.stack([math.cos(yaw) * x - math.sin(yaw) * y, math.sin(yaw) * x + math.cos(yaw) * y, z], 1)
    return torch.from_numpy(turned + center).float()


def result_of(*blocks, names=None):
    points = torch.cat(blocks)
    labels = torch.repeat_interleave(torch.arange(len(blocks)), torch.tensor([len(one) for one in blocks]))
    return replace(tj.Result.of(tj.Segmentation(labels, ()), tj.Scene(points)), segment_names=names or {})


def edits_of_boxes(result, boxes, is_text=False):
    return box_edits.edits_of_boxes(result, boxes, result.points.numpy(), is_text)


def three():
    """A table, a block on it, and one beside it."""
    table, on_it = block((0, 0, 0.5), (2, 1, 1), 0.3), block((0.1, 0, 1.1), (0.2, 0.3, 0.2), 1.0)
    return result_of(table, on_it, block((3, 1, 0.2), (1, 0.5, 0.4), 0))


def test_a_box_is_that_of_the_block():
    first, _, third = boxes_of(three()).values()
    assert np.allclose(first.center, (0, 0, 0.5), atol=1e-5)
    assert np.allclose(first.size, (2, 1, 1), atol=1e-5)
    assert first.yaw == pytest.approx(0.3, abs=1e-5)
    assert np.allclose((*third.center, *third.size, third.yaw), (3, 1, 0.2, 1, 0.5, 0.4, 0), atol=1e-5)


def test_files_are_as_the_programs_read_them(tmp_path):
    result = result_of(block((3, 1, 0.2), (1, 0.5, 0.4), math.pi / 2), names={0: "a chair"})
    export_openpcdet(tmp_path / "boxes.txt", result)
    *numbers, name = (tmp_path / "boxes.txt").read_text().split()
    assert name == "a_chair"
    assert np.allclose([float(n) for n in numbers], (3, 1, 0.2, 1, 0.5, 0.4, math.pi / 2), atol=1e-4)
    export_labelcloud(tmp_path / "cloud.json", result)
    record = json.loads((tmp_path / "cloud.json").read_text())
    (box,) = record["objects"]
    assert box["name"] == "a chair"
    assert box["rotations"]["z"] == pytest.approx(90, abs=0.01)
    assert box["dimensions"] == pytest.approx({"length": 1, "width": 0.5, "height": 0.4}, abs=1e-4)
    export_cuboids(tmp_path / "label.json", result)
    label = json.loads((tmp_path / "label.json").read_text())
    (cuboid,) = label["annotations"]
    assert label["format_version"] == "0.2"
    assert {key: cuboid[key] for key in ("id", "category_id", "type", "attributes")} == {
        "id": 1,
        "category_id": 1,
        "type": "cuboid",
        "attributes": {"name": "a chair"},
    }
    assert cuboid["position"] == pytest.approx({"x": 3, "y": 1, "z": 0.2}, abs=1e-4)
    assert cuboid["dimensions"] == pytest.approx({"x": 1, "y": 0.5, "z": 0.4}, abs=1e-4)
    assert cuboid["yaw"] == pytest.approx(math.pi / 2, abs=1e-4)
    export_cvat(tmp_path / "cvat.json", result)
    record = json.loads((tmp_path / "cvat.json").read_text())
    (item,) = record["items"]
    (cuboid,) = item["annotations"]
    assert record["categories"]["label"]["labels"][cuboid["label_id"]]["name"] == "a chair"
    assert (cuboid["type"], item["attr"]) == ("cuboid_3d", {"frame": 0})
    assert cuboid["position"] == pytest.approx([3, 1, 0.2], abs=1e-4)
    assert cuboid["rotation"] == pytest.approx([0, 0, math.pi / 2], abs=1e-4)
    assert cuboid["scale"] == pytest.approx([1, 0.5, 0.4], abs=1e-4)


@pytest.mark.parametrize("export", [export_labelcloud, export_cuboids, export_cvat, export_point_labels])
def test_names_come_back_from_programs_that_read_no_utf_8(tmp_path, export):
    """LabelCloud opens its files in the encoding of the system."""
    file = tmp_path / "a.json"
    export(file, result_of(block((3, 1, 0.2), (1, 0.5, 0.4), 0), names={0: "Tür"}))
    assert "Tür" in str(json.loads(file.read_text(encoding="cp1252")))


def test_classes_of_labelcloud_are_the_names():
    record = labelcloud_classes(["chair", "thing", "a door", "chair"])
    assert [(one["id"], one["name"]) for one in record["classes"]] == [(0, "thing"), (1, "a door"), (2, "chair")]
    assert len({one["color"] for one in record["classes"]}) == 3


def test_boxes_have_a_size(tmp_path):
    """A scan has things of one point, and flat ones: networks take the logarithm of a side."""
    few, flat = torch.tensor([[5.0, 5, 5]]).repeat(4, 1), block((3, 1, 0.2), (1, 0.5, 0), 0)
    result = result_of(few[:1], few, flat, few[:0], torch.cat([few, few[:1]]))
    for export in (export_openpcdet, export_labelcloud, export_cuboids, export_cvat):
        file = tmp_path / ("boxes.txt" if export is export_openpcdet else "boxes.json")
        with pytest.warns(UserWarning, match="segments of fewer than 5 points have no box: 2"):
            export(file, result)
        boxes = read_boxes(file)
        assert [box.size for box in boxes] == [pytest.approx(size, abs=1e-4) for size in ((1, 0.5, 0.01), (0.01,) * 3)]
        with pytest.warns(UserWarning, match="have no box"):  # what has none was not deleted
            assert edits_of_boxes(result, boxes) == ((), (), 0)


def footprint_of(points, tmp_path):
    result = tj.Result.of(tj.Segmentation(torch.zeros(len(points), dtype=torch.int64), ()), tj.Scene(points))
    export_geojson(tmp_path / "a.geojson", result, 25832)
    (feature,) = json.loads((tmp_path / "a.geojson").read_text())["features"]
    export_csv(tmp_path / "a.csv", result)
    (row,) = csv.DictReader((tmp_path / "a.csv").read_text().splitlines())
    assert float(row["area"]) == feature["properties"]["area"]
    return feature["geometry"], feature["properties"]["area"]


def test_footprints_of_an_l_and_of_two_parts(tmp_path):
    random = torch.Generator().manual_seed(0)
    places = torch.rand(8000, 3, generator=random, dtype=torch.float64) * torch.tensor([10, 10, 0.1])
    corner = torch.tensor([691_000.0, 5_334_000.0, 500.0], dtype=torch.float64)
    in_l = places[(places[:, 0] < 5) | (places[:, 1] < 4)]
    geometry, area = footprint_of(in_l + corner, tmp_path)
    (ring,) = geometry["coordinates"]
    assert geometry["type"] == "Polygon"
    assert len(ring) < 12  # corners that a surveyor would draw
    assert area == pytest.approx(70, rel=0.03)
    x, y = (np.array(ring) - ring[0]).T
    assert (x[:-1] * y[1:] - y[:-1] * x[1:]).sum() / 2 == pytest.approx(area, rel=0.01)  # counter-clockwise
    inside = cv2.pointPolygonTest(
        (np.array(ring) - corner[:2].numpy()).astype(np.float32), (5.5, 4.5), measureDist=True
    )
    assert inside < -0.3  # not in the convex hull alone
    apart = torch.cat([places, places + torch.tensor([20, 0, 0])])
    geometry, area = footprint_of(apart + corner, tmp_path)
    assert geometry["type"] == "MultiPolygon"
    assert len(geometry["coordinates"]) == 2
    assert area == pytest.approx(200, rel=0.03)
    assert footprint_of(places[:200], tmp_path)[1] == pytest.approx(cv2.contourArea(cv2.convexHull(
        places[:200, :2].float().numpy())), rel=1e-3)  # fmt: skip


def edges_that_meet(geometry):
    """Pairs of edges of a written shape that meet without a common corner; rings are closed."""
    parts = geometry["coordinates"] if geometry["type"] == "MultiPolygon" else [geometry["coordinates"]]
    rings = [np.array(ring) for (ring,) in parts]
    assert all((ring[0] == ring[-1]).all() and len(np.unique(ring, axis=0)) == len(ring) - 1 > 2 for ring in rings)
    start, end = (np.concatenate([ring[part] for ring in rings]) for part in (slice(-1), slice(1, None)))
    a, b, c, d = start[:, None], end[:, None], start[None], end[None]

    def turn(p, q, r):
        return np.sign((q - p)[..., 0] * (r - p)[..., 1] - (q - p)[..., 1] * (r - p)[..., 0])

    meet = (turn(a, b, c) * turn(a, b, d) <= 0) & (turn(c, d, a) * turn(c, d, b) <= 0)
    meet &= ((np.minimum(a, b) <= np.maximum(c, d)) & (np.minimum(c, d) <= np.maximum(a, b))).all(2)
    return int((meet & np.logical_and.reduce([(p != q).any(2) for p in (a, b) for q in (c, d)])).sum()) // 2


def test_footprints_are_simple_and_have_the_told_area(tmp_path):
    for seed in range(30):  # thin walls, crossing each other, and clumps that touch
        random = np.random.default_rng(seed)
        ends, along = random.uniform(0, 10, (2, 8, 2)), random.uniform(0, 1, (3000, 1))
        wall = random.integers(0, 8, 3000)
        walls = (1 - along) * ends[0][wall] + along * ends[1][wall] + random.normal(0, 0.05, (3000, 2))
        walk = random.normal(0, 1, (60, 2)).cumsum(0)[random.integers(0, 60, 2000)] + random.normal(0, 0.5, (2000, 2))
        for places in (walls, walk):
            geometry, area = footprint_of(torch.from_numpy(np.pad(places, ((0, 0), (0, 1)))), tmp_path)
            parts = geometry["coordinates"] if geometry["type"] == "MultiPolygon" else [geometry["coordinates"]]
            assert edges_that_meet(geometry) == 0
            rings = [(np.array(ring) - ring[0]).T for (ring,) in parts]
            written = sum((x[:-1] * y[1:] - y[:-1] * x[1:]).sum() / 2 for x, y in rings)  # counter-clockwise, too
            assert area == pytest.approx(written, abs=1e-3)
    turn = torch.linspace(0, 2 * math.pi, 2001, dtype=torch.float64)[1:]
    mast = torch.stack([0.2 * turn.cos() + 691_000, 0.2 * turn.sin() + 5_334_000, turn], 1)  # corners nearer than 1 mm
    assert edges_that_meet(footprint_of(mast, tmp_path)[0]) == 0
    line = torch.tensor([[0.0, 0, 0], [1, 1, 0], [2, 2, 0]], dtype=torch.float64)
    assert footprint_of(line, tmp_path)[0]["type"] == "Point"  # without area


def test_footprints_of_a_tilted_scene_are_told(tmp_path):
    result = tj.Result.of(tj.Segmentation(torch.zeros(9, dtype=torch.int64), ()), tj.Scene(torch.rand(9, 3), up=UP_X))
    with (
        pytest.warns(UserWarning, match="footprints are seen along z, `area` along up, .* 90 degrees away"),
        pytest.warns(UserWarning, match=r"a\.geojson: no EPSG code .*: programs will take the metres for degrees"),
    ):
        export_geojson(tmp_path / "a.geojson", result)


def test_boxes_of_a_tilted_scene_stand_upright():
    """They are those of the same things in a scene whose z is up."""
    upright = three()
    tilted = replace(upright, scene=tj.Scene(upright.scene.points[:, [2, 0, 1]], up=UP_X))
    turned = upright_points(tilted.scene)
    assert np.allclose(turned[:, 2], upright.scene.points[:, 2])
    for one, other in zip(boxes_of(tilted).values(), boxes_of(upright).values(), strict=True):
        assert np.allclose(one.size, other.size, atol=1e-4)
        assert one.center[2] == pytest.approx(other.center[2], abs=1e-5)
    for segment, box in boxes_of(tilted).items():
        assert box.holds(turned[tilted.points.numpy() == segment]).all()


def test_a_leaning_floor_turns_no_cloud_alone(tmp_path):
    """A survey's ground may slope: z is up, to the last digit, and the table of segments says the same as the boxes."""
    slope = block((0, 0, 0), (20, 20, 0.01), 0.3, 4000)
    slope[:, 2] += 0.1 * slope[:, 0]
    result = result_of(slope, block((3, 1, 2), (1, 0.5, 0.4), 0))
    export_csv(tmp_path / "a.csv", result)
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    for row, box in zip(rows, boxes_of(result).values(), strict=True):
        assert [float(row[name]) for name in ("x", "y", "z")] == pytest.approx(box.center, abs=1e-3)
        assert [float(row[f"size_{axis}"]) for axis in "xyz"] == pytest.approx(box.size, abs=1e-3)
        low, high = box.center[2] - box.size[2] / 2, box.center[2] + box.size[2] / 2
        assert [float(row["bottom"]), float(row["top"])] == pytest.approx([low, high], abs=1e-3)
    assert float(rows[1]["area"]) == pytest.approx(0.5, abs=1e-3)  # of the block, 1 m by 0.5 m


@pytest.mark.parametrize("export", [export_openpcdet, export_labelcloud, export_cuboids, export_cvat])
def test_what_nobody_edited_changes_nothing(tmp_path, export):
    result = replace(three(), segment_names={1: "a red block"})
    file = tmp_path / ("boxes.txt" if export is export_openpcdet else "boxes.json")
    export(file, result)
    assert edits_of_boxes(result, read_boxes(file)[::-1], export is export_openpcdet) == ((), (), 0)


@pytest.mark.parametrize("name", ["thing", " thing ", "  a chair ", "\u2028a", "\r", "x\ny"])
def test_a_name_that_files_hold_in_another_way_is_not_edited(name):
    result = replace(three(), segment_names={0: name})
    for is_text, read in enumerate((lambda one: one.strip(), lambda one: "_".join(one.split()) or "thing")):
        boxes = [box._replace(name=read(box.name)) for box in boxes_of(result).values()]
        assert edits_of_boxes(result, boxes, bool(is_text)).steps == ()


@pytest.mark.slow
def test_many_boxes_of_a_large_cloud_take_little_memory():
    result = result_of(*(block((column, 0, 0), (0.5, 0.5, 0.5), 0, 200) for column in range(400)))
    boxes = [*boxes_of(result).values()]
    tracemalloc.start()
    assert edits_of_boxes(result, boxes).steps == ()
    assert tracemalloc.get_traced_memory()[1] < 20e6  # two tables of all points in all boxes: 66 MB
    tracemalloc.stop()


def test_cuboids_without_names_leave_the_names(tmp_path):
    """An editor may drop the attribute, or leave it empty."""
    result = replace(three(), segment_names={1: "a red block"})
    label = segmentsai_label(boxes_of(result))
    for one in label["annotations"]:
        del one["attributes"]
    (tmp_path / "a.json").write_text(json.dumps({"label_status": "LABELED", "attributes": label}))
    with pytest.warns(UserWarning, match="1 empty names change nothing; the viewer removes names"):
        assert edits_of_boxes(result, read_boxes(tmp_path / "a.json")) == ((), (), 0)
    label["annotations"][1]["attributes"] = {"name": ""}
    (tmp_path / "a.json").write_text(json.dumps(label))
    with pytest.warns(UserWarning, match="1 empty names change nothing; the viewer removes names"):
        assert edits_of_boxes(result, read_boxes(tmp_path / "a.json")) == ((), (), 0)


def test_a_deleted_box_joins_and_a_name_is_taken():
    result = three()
    table, block_on_it, beside = boxes_of(result).values()
    larger = table._replace(center=(0, 0, 0.6), size=(2, 1, 1.2), name="desk")
    changes = edits_of_boxes(result, [beside, larger])
    assert [(step.kind, step.superpoints, step.name) for step in changes.steps] == [
        ("join", (0, 1), ""),
        ("name", (0,), "desk"),
    ]
    assert ([one.kind for one in changes.steps], changes.empty) == (["join", "name"], ())
    far = Box("new", (9, 9, 9), (1, 1, 1), 0.0)
    assert edits_of_boxes(result, [table, block_on_it, beside, far]).empty == (3,)
    # Deleted without another box around it: it stays as it is.
    assert edits_of_boxes(result, [table, block_on_it]).steps == ()
    assert edits_of_boxes(result, []) == ((), (), 3)


@pytest.mark.parametrize(("name", "other"), [("a red chair", "a_red_chair"), ("a_red_chair", "a red chair")])
def test_a_file_without_names_takes_none_away(name, other):
    """It may have been exported before the things were named. But other spaces are another name: it was lost."""
    result = result_of(block((3, 1, 0.2), (1, 0.5, 0.4), 0), names={0: name})
    (box,) = boxes_of(result).values()
    assert edits_of_boxes(result, [box]).steps == ()
    for without in ("thing", ""):
        with pytest.warns(UserWarning, match="1 empty names change nothing; the viewer removes names"):
            assert edits_of_boxes(result, [box._replace(name=without)]).steps == ()
    assert [step.name for step in edits_of_boxes(result, [box._replace(name=other)]).steps] == [other]


@given(
    st.lists(
        st.builds(
            Box,
            st.sampled_from(["thing", "chair", "tür"]),
            st.tuples(*[st.floats(-50, 50)] * 3),
            st.tuples(*[st.floats(0, 20)] * 3),
            st.floats(-3, 3),
        ),
        max_size=5,
    )
)
def test_any_boxes_come_back(tmp_path_factory, boxes):
    folder = tmp_path_factory.mktemp("boxes")
    (folder / "a.txt").write_text(openpcdet_lines(boxes), encoding="utf-8")
    (folder / "a.json").write_text(json.dumps(labelcloud_record(boxes)), encoding="utf-8")
    (folder / "b.json").write_text(json.dumps(segmentsai_label(dict(enumerate(boxes)))), encoding="utf-8")
    (folder / "c.json").write_text(json.dumps(datumaro_record(boxes)), encoding="utf-8")
    for file in ("a.txt", "a.json", "b.json", "c.json"):
        found = read_boxes(folder / file)
        assert [box.name for box in found] == [box.name for box in boxes]
        for one, other in zip(found, boxes, strict=True):
            assert np.allclose([*one.center, *one.size], [*other.center, *other.size], atol=1e-3)
            assert math.cos(one.yaw - other.yaw) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.txt", "1 2 3 4 5 6 0.1", r"line 1: expected x y z dx dy dz heading name"),
        ("a.txt", "\n1 2 3 4 5 six 0.1 chair", r"line 2: expected seven numbers"),
        ("a.txt", "1 2 3 4 -5 6 0.1 chair", r"line 1: expected finite numbers and sizes of at least 0"),
        ("a.txt", "1 2 nan 4 5 6 0.1 chair", r"line 1: expected finite numbers"),
        (
            "a.json",
            '{"images": [], "categories": []}',
            "expected boxes, got COCO's masks of images; they go into a new",
        ),
        ("a.geojson", "{}", r"a\.geojson: expected boxes or labels, \.json or \.txt, or a \.csv of `export`"),
        ("a.json", '{"type": "a", "features": []}', r"or names, in a \.csv\): got type, features$"),
        ("a.json", "[1]", "expected boxes: `objects` of labelCloud, `annotations` of Segments.ai"),
        ("a.json", '{"objects": 3}', "objects is int"),
        ("a.json", '{"objects": [{"name": "a"}]}', "object 0: expected name, centroid"),
        ("a.json", '{"annotations": 3}', "annotations is int"),
        ("a.json", '{"annotations": [{"type": "polygon", "points": []}]}', "object 0: expected a cuboid with position"),
        ("a.json", '{"items": [{"annotations": [{}]}]}', "or `items` of CVAT .*categories"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(ValueError, match=message):
        read_boxes(tmp_path / name)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"label_id": -1}, "object 1: expected x y z dx dy dz heading name, got .*None"),
        ({"label_id": []}, "unhashable"),
        ({"type": "label", "position": None}, "object 1: expected a cuboid_3d with position"),
        ({"rotation": [0.02, 0, 0]}, "object 1: expected a box that turns about z alone"),
        ({"rotation": []}, "object 1: expected a cuboid_3d with position"),
        ({"scale": [1, 2, -3]}, "object 1: expected finite numbers and sizes of at least 0"),
    ],
)
def test_what_is_wrong_with_a_box_of_cvat(tmp_path, change, message):
    record = datumaro_record([Box("a", (0, 0, 0), (1, 1, 1), 0.0)] * 2)
    record["items"][0]["annotations"][1] |= change
    (tmp_path / "a.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match=message):
        read_boxes(tmp_path / "a.json")


def test_boxes_of_cvat_are_those_of_one_cloud(tmp_path):
    """A task of several clouds has an item for each, whether it has boxes or not."""
    record = datumaro_record([Box("a", (0, 0, 0), (1, 1, 1), 0.0)])
    record["items"].append({"id": "other", "annotations": []})
    (tmp_path / "a.json").write_text(json.dumps(record))
    assert read_boxes(tmp_path / "a.json") == [Box("a", (0, 0, 0), (1, 1, 1), 0.0)]
    record["items"][1]["annotations"] = record["items"][0]["annotations"]
    (tmp_path / "a.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match="got boxes of 2 clouds, expected those of one"):
        read_boxes(tmp_path / "a.json")


def with_one_changed(value, new):
    """The JSON value, each time with another of its parts replaced."""
    yield new
    keys = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        for changed in with_one_changed(value[key], new):
            copy = value.copy()
            copy[key] = changed
            yield copy


@pytest.mark.parametrize("name", ["a.txt", "a.json", "b.json", "c.json"])
def test_damaged_files_are_named(tmp_path, name):
    boxes, file = [Box("tür", (1.0, 2, 3), (1.0, 1, 2), 0.5)] * 2, tmp_path / name
    record = {"a.json": labelcloud_record(boxes), "b.json": segmentsai_label(dict(enumerate(boxes)))}
    record = record.get(name, datumaro_record(boxes))

    def read():
        try:
            found = read_boxes(file)
        except CLEAR as error:
            assert name in str(error)  # noqa: PT017
        else:
            assert np.isfinite([[*one.center, *one.size, one.yaw] for one in found]).all()

    file.write_text(openpcdet_lines(boxes) if name == "a.txt" else json.dumps(record), encoding="utf-8")
    for _ in damages(tmp_path, 200):
        read()
    for new in [] if name == "a.txt" else (None, -1, 1e999, 10**400, "a", [], {}, [[]], True):
        for changed in with_one_changed(record, new):
            file.write_text(json.dumps(changed))
            read()


def test_a_tilted_box_is_refused(tmp_path):
    record = labelcloud_record([Box("a", (0, 0, 0), (1, 1, 1), 0.0)])
    label = segmentsai_label({0: Box("a", (0, 0, 0), (1, 1, 1), 0.63)})
    label["annotations"][0]["rotation"] = {"qx": 0, "qy": 0.0491566, "qz": 0.3096865, "qw": 0.9495672}
    for turn in (20, -20):
        record["objects"][0]["rotations"]["x"] = turn
        for tilted in (record, label):
            (tmp_path / "a.json").write_text(json.dumps(tilted))
            with pytest.raises(ValueError, match="object 0: expected a box that turns about z alone"):
                read_boxes(tmp_path / "a.json")
    label["annotations"][0]["rotation"] |= {"qy": 0}
    (tmp_path / "a.json").write_text(json.dumps(label))
    assert read_boxes(tmp_path / "a.json")[0].yaw == 0.63


def test_overwrite_keeps_a_cloud_named_as_the_turned_one(run, scene_of, tmp_path):
    """`-o room.json --overwrite` replaced room.ply, a user's own."""
    config = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])
    scene = replace(scene_of(3).scene, up=torch.tensor([0.0, -1.0, 0.0]))
    (tmp_path / "out").mkdir()
    write_result(tmp_path / "out", scene, tj.JointSegmenter(config)(scene), config, "test")
    command = ("export", tmp_path / "out", "--format", "cvat", "-o", tmp_path / "room.json", "--overwrite")
    (tmp_path / "room.ply").write_text("mine")
    with pytest.raises(SystemExit, match=r"room\.ply: exists already; choose another name"):
        run(*command)
    assert (tmp_path / "room.ply").read_text() == "mine"
    assert not (tmp_path / "room.json").exists()
    (tmp_path / "room.ply").unlink()
    run(*command)
    run(*command)  # replaces both
    assert len(load_cloud(tmp_path / "room.ply").points) == len(scene.points)


def test_radians_of_labelcloud_are_no_degrees(tmp_path):
    """Its format centroid_rel has the same keys; taken for degrees, boxes were turned, and things joined others."""
    record = labelcloud_record([Box("a", (0, 0, 0), (3, 1, 1), 0.5)])
    record["objects"][0]["rotations"]["z"] = -0.5
    (tmp_path / "a.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match=r"a\.json, object 0: .*angles of centroid_rel"):
        read_boxes(tmp_path / "a.json")


@pytest.mark.parametrize("up", [(0, 0, 1), (0, -1, 0)])
def test_the_round_trip_of_the_command_line(run, scene_of, tmp_path, capsys, up):
    """If z is not up, the boxes are those of a turned cloud, which is written beside them."""
    config = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])
    scene = replace(scene_of(3).scene, up=torch.tensor(up).float())
    out = tmp_path / "out"
    out.mkdir()
    write_result(out, scene, tj.JointSegmenter(config)(scene), config, "test")
    run("export", out, "--format", "labelcloud", "-o", tmp_path / "boxes.json")
    if up[2]:
        assert not (tmp_path / "boxes.ply").exists()
    else:
        assert torch.equal(load_cloud(tmp_path / "boxes.ply").points[:, 2], -scene.points[:, 1])
    run("edits", "import", out, tmp_path / "boxes.json")
    assert "joined to others: 0, names changed: 0" in capsys.readouterr().out
    assert not (out / "edits.json").exists()
    record = json.loads((tmp_path / "boxes.json").read_text())
    before = tj.load_result(out)
    largest = int(torch.bincount(before.points).argmax())
    record["objects"][largest]["name"] = "floor"
    inside = boxes_of(before)[largest].holds(upright_points(before.scene))
    within = [inside[(before.points == number).numpy()].mean() for number in range(before.num_point_segments)]
    gone = next(number for number, share in enumerate(within) if number != largest and share > 0.9)
    del record["objects"][gone]
    (tmp_path / "edited.json").write_text(json.dumps(record))
    run("edits", "import", out, tmp_path / "edited.json")
    assert "joined to others: 1, names changed: 1" in capsys.readouterr().out
    after = tj.load_result(out)
    assert len(after.points.unique()) == before.num_point_segments - 1
    assert "floor" in after.segment_names.values()
    one = record["objects"][largest]
    other = min(record["objects"], key=lambda box: np.prod([*box["dimensions"].values()]))
    record["objects"] = [one, one | {"name": "none"}]
    one["dimensions"] = dict.fromkeys(one["dimensions"], 1e-3)
    record["objects"][1]["dimensions"] = one["dimensions"]
    (tmp_path / "none.json").write_text(json.dumps(record))
    with pytest.raises(SystemExit, match=r"none\.json: is it of another result than .*\? 2 of 2 boxes are those of no"):
        run("edits", "import", out, tmp_path / "none.json")
    record["objects"][1] = other
    (tmp_path / "two.json").write_text(json.dumps(record))
    run("edits", "import", out, tmp_path / "two.json")
    assert f"had left them out): {len(after.points.unique()) - 1}" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="no-such"):
        run("edits", "import", out, tmp_path / "no-such.json")


def test_segments_without_points_have_no_box(tmp_path):
    result = three()
    masked = replace(result, points=torch.where(result.points == 1, -1, result.points))
    export_openpcdet(tmp_path / "boxes.txt", masked)
    assert len(read_boxes(tmp_path / "boxes.txt")) == 2
    assert edits_of_boxes(masked, read_boxes(tmp_path / "boxes.txt")) == ((), (), 0)


def test_a_second_import_goes_on_from_the_first(run, tmp_path):
    """Without a hierarchy, superpoints are the segments on disk, and not those after corrections."""
    table, on_it = block((0, 0, 0.5), (2, 1, 1), 0.3), block((0.1, 0, 1.1), (0.2, 0.3, 0.2), 1.0)
    result = result_of(table, on_it, block((3, 1, 0.2), (1, 0.5, 0.4), 0), block((5, 5, 1), (1, 1, 1), 0))
    out = tmp_path / "out"
    out.mkdir()
    write_result(out, result.scene, result, tj.Config(), "test")
    boxes = boxes_of(result)
    larger = boxes[0]._replace(center=(0, 0, 0.6), size=(2, 1, 1.2))
    for chosen in ([larger, boxes[2], boxes[3]], [larger, boxes[2]._replace(name="chair"), boxes[3]]):
        (tmp_path / "boxes.txt").write_text(openpcdet_lines(chosen), encoding="utf-8")
        run("edits", "import", out, tmp_path / "boxes.txt")
    after = tj.load_result(out)
    assert after.points.unique().tolist() == [0, 2, 3]
    (named,) = after.segment_names
    assert after.segment_names == {named: "chair"}
    assert torch.equal(after.points == named, result.points == 2)


@pytest.mark.parametrize("format", ["labelcloud", "cvat", "segmentsai-cuboids", "openpcdet", "csv", "segmentsai"])
def test_a_file_takes_no_later_corrections_back(run, tmp_path, capsys, format):
    """The file was exported before them; what was edited in it comes back, or the file is refused."""
    table, on_it = block((0, 0, 0.5), (2, 1, 1), 0.3), block((0.1, 0, 1.1), (0.2, 0.3, 0.2), 1.0)
    result = result_of(table, on_it, *(block((3 * place, 4, 1), (1, 1, 1), 0) for place in range(5)))
    out, file = tmp_path / "out", tmp_path / f"file{SUFFIXES[format]}"
    out.mkdir()
    write_result(out, result.scene, result, tj.Config(), "test")
    parts = Parts(result)
    names = [Edit("name", (place,), name) for place, name in ((2, "old tree"), (3, "car"), (6, "house"))]
    exported = Edits(parts.count, None, (Edit("join", (0, 1)), *names))
    write_edits(out, exported)
    run("export", out, "--format", format, "-o", file)
    later = (Edit("name", (2,), "oak"), Edit("name", (3,), ""), Edit("gather", (1,)), Edit("join", (4, 5)))
    write_edits(out, before := replace(exported, steps=exported.steps + later))
    file.write_text(file.read_text().replace("house", "shop"))
    kept = (out / "edits.json").read_bytes()
    if format == "segmentsai":
        with pytest.raises(SystemExit, match=r"those before the last joins or splits by hand \(2\); export"):
            run("edits", "import", out, file)
        assert (out / "edits.json").read_bytes() == kept
        return
    with pytest.warns(UserWarning, match="which stay .*: ('car', 'old.tree'|'car', 'old.tree', a join)$"):
        run("edits", "import", out, file)
    assert "joined to others: 0, names changed: 1\nnames that were replaced: 'house'\n" in capsys.readouterr().out
    after = read_edits(out, parts.count)
    assert after.steps == (*before.steps, Edit("name", (6,), "shop"))
    run("export", out, "--format", format, "-o", file, "--overwrite")
    file.write_text(file.read_text().replace("shop", "house"))  # a name of before, in a file of now
    with pytest.warns(UserWarning, match="which stay .*: 'house'$"):
        run("edits", "import", out, file)


def test_what_was_made_by_hand_joins_nothing(tmp_path):
    """An older file has boxes of its parts only, and it lies in the box of another thing."""
    parts = Parts(result_of(*(block((3 * place, 0, 1), (1, 1, 1), 0) for place in range(4))))
    by_hand = Edits(parts.count, None, (Edit("join", (1, 2)),))
    steps = Edit("join", (0, 3)), Edit("join", (0, 1))
    with pytest.warns(UserWarning, match="as before later corrections, which stay .*: a join$"):
        assert box_edits.without_older(steps, parts, by_hand, tmp_path / "boxes.json") == steps[:1]


@pytest.mark.parametrize("delimiter", [",", ";"])
def test_names_come_back_from_the_table(run, scene_of, tmp_path, capsys, delimiter):
    """A table as spreadsheets write it: rows left out and sorted, another delimiter, a byte order mark."""
    config = tj.Config().set(["point_segments.method=learned"])
    scene, out, table = replace(scene_of(3).scene, frames=()), tmp_path / "out", tmp_path / "names.csv"
    out.mkdir()
    write_result(out, scene, tj.JointSegmenter(config)(scene), config, "test")
    run("export", out, "--format", "csv", "-o", table)
    before = table.read_bytes()
    run("edits", "import", out, table)
    assert "names changed: 0" in capsys.readouterr().out
    rows = list(csv.DictReader(before.decode().splitlines()))
    rows[0]["name"], rows[2]["name"] = "house;-1, old", "-5 garage"

    def write(rows):
        with table.open("w", encoding="utf-8-sig", newline="") as file:
            writer = csv.DictWriter(file, ["points", "name", "id"], extrasaction="ignore", delimiter=delimiter)
            writer.writeheader()
            writer.writerows(rows)

    write([rows[2], rows[0]])
    run("edits", "import", out, table)
    assert tj.load_result(out).segment_names == {0: "house;-1, old", 2: "-5 garage"}
    table.unlink()
    run("export", out, "--format", "csv", "-o", table)  # "-5 garage" got an apostrophe, which is no change
    edits = (out / "edits.json").read_bytes()
    run("edits", "import", out, table)
    assert (out / "edits.json").read_bytes() == edits
    write([rows[0] | {"name": "", "points": "3"}, rows[2] | {"name": "-5_garage"}])  # an old table of one more name
    with pytest.warns(UserWarning, match="1 empty names change nothing"):
        run("edits", "import", out, table)
    assert tj.load_result(out).segment_names == {0: "house;-1, old", 2: "-5_garage"}
    write([rows[0], rows[2] | {"name": ""}])  # a table from before that name
    with pytest.warns(UserWarning, match="1 empty names change nothing; the viewer removes names"):
        run("edits", "import", out, table)
    assert tj.load_result(out).segment_names == {0: "house;-1, old", 2: "-5_garage"}
    write([rows[2] | {"name": "shed", "id": "2.0", "points": rows[2]["points"] + ".0"}])  # of pandas
    run("edits", "import", out, table)
    assert tj.load_result(out).segment_names[2] == "shed"
    write([rows[2] | {"name": "'n Ding"}])  # an apostrophe of its own
    run("edits", "import", out, table)
    assert tj.load_result(out).segment_names[2] == "'n Ding"
    for wrong, told in (
        ({"points": "3"}, "the table says 3"),
        ({"points": "3.0"}, "the table says 3;"),
        ({"id": "9999", "points": "0"}, "segment 9999: expected the id"),
        ({"id": "-1", "points": "0"}, "segment -1: expected the id"),
        ({"id": "x"}, "expected the id of a segment"),
        ({"id": "9" * 5000}, "expected the id of a segment"),
        ({"name": "shed" * 40_000}, "field larger than field limit"),
    ):
        write([rows[0] | {"name": "hut"} | wrong])
        with pytest.raises(SystemExit, match=rf"names\.csv: (row 2: 'hut': )?.*{told}"):
            run("edits", "import", out, table)
    table.write_bytes("id,name,points\n0,Gebäude,1\n".encode("cp1252"))
    with pytest.raises(SystemExit, match=r"names\.csv: expected a table of segments \(save it as CSV UTF-8\) as text"):
        run("edits", "import", out, table)
    table.unlink()
    with pytest.raises(
        SystemExit, match=r"names\.csv: missing; expected a table of segments \(save it as CSV UTF-8\)$"
    ):
        run("edits", "import", out, table)
    table.write_text("id,name\n1,a\n")
    with pytest.raises(SystemExit, match="expected id, name and points of `export`, got id, name"):
        run("edits", "import", out, table)
    outlines = tmp_path / "outlines.geojson"
    with pytest.warns(UserWarning, match="no EPSG code of the cloud is known"):
        run("export", out, "--format", "geojson", "-o", outlines)
    features = json.loads(outlines.read_text())
    for feature, name in zip(features["features"], ("barn", None), strict=False):  # QGIS writes null for no name
        feature["properties"]["name"] = name
    outlines.write_text(json.dumps(features))
    run("edits", "import", out, outlines)
    assert tj.load_result(out).segment_names == {0: "barn", 2: "'n Ding"}
    features["features"][0]["properties"]["name"] = 0  # a column of integers
    outlines.write_text(json.dumps(features))
    run("edits", "import", out, outlines)
    assert tj.load_result(out).segment_names == {0: "0", 2: "'n Ding"}
    features["features"][2]["properties"] |= {"name": "hut", "points": 3}
    outlines.write_text(json.dumps(features))
    with pytest.raises(SystemExit, match=r"outlines\.geojson: row 3: 'hut': segment 2: .*the table says 3"):
        run("edits", "import", out, outlines)
