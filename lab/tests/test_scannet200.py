"""From ScanNet's layout and masks of MaskClustering to a row of a table, on two small scans."""

import json

import numpy as np
import pytest
from PIL import Image
from scannet_files import shots_of, write_mesh, write_point_truth, write_sens
from torchjoint_lab.cli.scannet200 import scannet200

import torchjoint as tj


@pytest.fixture
def data(tmp_path, scene_of):
    made = scene_of(0)
    scene, camera = made.scene, made.scene.frames[0].intrinsics
    for index in range(2):
        name = f"scene0000_0{index}"
        scan = tmp_path / "data" / "scans" / name
        scan.mkdir(parents=True)
        write_sens(scan / f"{name}.sens", shots_of(scene), camera, camera)
        write_mesh(scan / f"{name}_vh_clean_2.ply", scene.points.numpy(), (scene.colors * 255).int().numpy())
        write_point_truth(scan, name, made.point_labels)
        masks = tmp_path / "published" / name / "output" / "mask"
        masks.mkdir(parents=True)
        for frame in (0, 2, 4):  # networks take some frames only
            labels = (made.image_labels[frame].numpy() + 1).astype(np.uint8)
            Image.fromarray(labels).save(masks / f"{frame}.png")
    lines = ["id\traw_category\tnyu40id", "2\tchair\t5"]
    (tmp_path / "data" / "scannetv2-labels.combined.tsv").write_text("\n".join(lines) + "\n")
    return tmp_path


def test_a_row_and_on_where_it_was(data, capsys):
    out = data / "out"
    scannet200(data / "data", out, data / "published")
    first = (out / "table.md").read_text()
    assert "| torchjoint, masks of published |" in first
    assert "this run, 2 scans, scannet200" in first
    assert "CDIS" in first
    ours = [float(cell) for cell in first.splitlines()[2].split("|")[2:5]]
    assert 20 < ours[0] <= ours[1] <= ours[2] <= 100  # the masks are the true ones
    expected = tj.metrics.ScannetAveragePrecisionMetric()
    for name in ("scene0000_00", "scene0000_01"):
        scene, result = tj.load_scene(data / "data" / "scans" / name), tj.load_result(out / name)
        expected.update(result.points, scene.truth.points, result.confidence)
    assert ours == pytest.approx([100 * one for one in expected.compute()], abs=0.051)
    times = {file: file.stat().st_mtime_ns for file in out.glob("*/points.npz")}
    capsys.readouterr()
    scannet200(data / "data", out, data / "published")
    assert (out / "table.md").read_text() == first
    assert {file: file.stat().st_mtime_ns for file in out.glob("*/points.npz")} == times


@pytest.mark.parametrize("name", ["table.md", "arguments.txt"])
def test_files_of_no_earlier_start_stay(data, name):
    (data / "out").mkdir()
    (data / "out" / name).write_text("mine")
    with pytest.raises((FileExistsError, ValueError), match=r"exists already; choose|is of a run with mine"):
        scannet200(data / "data", data / "out")
    assert (data / "out" / name).read_text() == "mine"


def test_results_with_other_masks_are_not_mixed(data):
    with pytest.raises(ValueError, match=r"no scan was scored; the first error: .*missing; expected masks"):
        scannet200(data / "data", data / "out", data / "publised")
    scannet200(data / "data", data / "out", data / "published")  # nothing is of the run before
    with pytest.raises(ValueError, match=r"out is of a run with --masks .*published .*; got --masks None"):
        scannet200(data / "data", data / "out")


def test_a_scan_that_fails_stops_no_other(data):
    broken = data / "data" / "scans" / "scene0000_00" / "scene0000_00.aggregation.json"
    record = json.loads(broken.read_text())
    record["segGroups"][0]["objectId"] = "x"
    broken.write_text(json.dumps(record))
    scannet200(data / "data", data / "out", data / "published", protocol="scannetv2")
    text = (data / "out" / "table.md").read_text()
    assert "this run, 1 scans, scannetv2" in text
    assert "scene0000_00 failed:" in text
    assert "CDIS" not in text
