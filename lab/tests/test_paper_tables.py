"""torchjoint-lab paper-tables, end to end, on synthetic scenes in the very files of ScanNet, 3D-SIS and SceneCut."""

import csv
import shutil
from statistics import fmean

import numpy as np
import pytest
import torch
from scannet_files import (
    shots_of,
    write_exported,
    write_image_truth,
    write_intrinsics,
    write_mesh,
    write_point_truth,
    write_sens,
)
from scipy.io import savemat
from sis3d_files import boxes_of, world_to_grid, write_detections
from torchjoint_lab.evaluation.paper_tables import ROWS, Row, Scores, comparable, paper_table, score_points

import torchjoint as tj

SMALL = ["--set", "image_segments.min_size=20"]
SCANS = ("scene0011_00", "scene0025_01")


@pytest.fixture(scope="module")
def synthetic():
    return {scan: tj.synthetic.make_scene(seed=5 + i, num_views=3) for i, scan in enumerate(SCANS)}


@pytest.fixture(scope="module")
def data(tmp_path_factory, synthetic):
    """ScanNet's scans, one as a stream and one exported, and both baselines' results."""
    root = tmp_path_factory.mktemp("data")
    for scan, one in synthetic.items():
        folder = root / "scans" / scan
        intrinsics = one.scene.frames[0].intrinsics
        folder.mkdir(parents=True)
        if scan == SCANS[0]:
            write_sens(folder / f"{scan}.sens", shots_of(one.scene), intrinsics, intrinsics)
        else:
            write_exported(folder, shots_of(one.scene))
            write_intrinsics(folder, intrinsics, intrinsics)
        write_mesh(folder / f"{scan}_vh_clean_2.ply", one.scene.points, (one.scene.colors * 255).round())
        write_point_truth(folder, scan, one.point_labels)
        write_image_truth(folder, one.image_labels)
        write_baselines(root, scan, one)
    return root


def largest(synthetic, count=5):
    return synthetic.point_labels.bincount().argsort(descending=True)[:count].tolist()


def write_baselines(root, scan, one):
    """3D-SIS finds the five largest objects; SceneCut tells the image's halves apart."""
    boxes, masks = boxes_of(one.scene.points, one.point_labels, largest(one))
    write_detections(root / "3dsis" / scan, boxes, [3] * 5, [0.9] * 5, masks, protocol=3)
    np.savetxt(root / "3dsis" / scan / "world2grid.txt", world_to_grid(one.scene.points), fmt="%.9f")
    (root / "scenecut" / scan).mkdir(parents=True)
    halves = np.repeat([[7, 3]], 60, axis=0).repeat(40, axis=1)
    for name in "012":  # of half the resolution
        if name == "1":
            np.save(root / "scenecut" / scan / f"{name}.npy", halves.astype(np.uint16))
        else:
            savemat(root / "scenecut" / scan / f"{name}.mat", {"seg": halves}, do_compression=True)


def read_rows(file):
    rows = list(csv.DictReader(file.read_text().splitlines()))
    keys = [name for name in ("scene", "table", "method", "on") if name in rows[0]]
    return {tuple(row[key] for key in keys): {k: v for k, v in row.items() if k not in keys} for row in rows}


@pytest.fixture(scope="module")
def out(data, run_lab):
    baselines = ["--sis3d", data / "3dsis", "--scenecut", data / "scenecut"]
    run_lab("paper-tables", data, "-o", data / "out", *baselines, "--max-frames", 2, *SMALL)
    return data / "out"


def expected_scores(data, synthetic, scan):
    """Of each row, by the metrics' public functions alone."""
    one = synthetic[scan]
    scene = tj.load_scene(data / "scans" / scan).select_frames([0, 2])
    ours = tj.JointSegmenter(tj.Config().set(SMALL[1:]))(scene)
    truth = one.point_labels
    found = torch.full_like(truth, -1)
    rounded = world_to_grid(one.scene.points)
    voxels = torch.from_numpy(one.scene.points.double().numpy() @ rounded[:3, :3].T + rounded[:3, 3]).round()
    for k, instance in reversed(list(enumerate(largest(one)))):  # equally confident: the first one wins
        own = {tuple(voxel) for voxel in voxels[truth == instance].tolist()}
        found[torch.tensor([tuple(voxel) in own for voxel in voxels.tolist()])] = k
    only = torch.where(found >= 0, truth, -1)
    rows = {("I", "3D-SIS", "P"): (found, truth), ("I", "ours", "P"): (ours.points, truth)}
    rows |= {("I", "3D-SIS", "P_D"): (found, only), ("I", "ours", "P_D"): (ours.points, only)}
    rows = {row: scores_of(*pair) for row, pair in rows.items()}
    halves = torch.tensor([0, 1]).repeat_interleave(80).expand(120, -1)
    for method, images in (("initial", ours.initial_images), ("final", ours.images), ("SceneCut", [halves, halves])):
        scores = [scores_of(images[i], one.image_labels[k]) for i, k in enumerate((0, 2))]
        rows["II", method, "images"] = [fmean(values) for values in zip(*scores, strict=True)]
    return rows


def scores_of(pred, target):
    covering = tj.metrics.segmentation_covering(pred, target)
    parts = tj.metrics.objects_and_parts(pred, target)
    aps = [tj.metrics.average_precision_objects(pred, target), tj.metrics.average_precision_parts(pred, target)]
    return [*parts, *covering, *aps]


@pytest.mark.slow
def test_every_row_is_what_the_metrics_say(data, out, synthetic):
    single, means = read_rows(out / "scenes.csv"), read_rows(out / "tables.csv")
    expected = {scan: expected_scores(data, synthetic, scan) for scan in SCANS}
    assert list(means) == [tuple(row) for row in ROWS]
    for row in means:
        for scan in SCANS:
            values = [float(value) for value in single[scan, *row].values()]
            assert values == pytest.approx(expected[scan][row], abs=2e-6), (scan, row)
        mean = np.mean([expected[scan][row] for scan in SCANS], axis=0)
        assert means[row].pop("scenes") == "2"
        assert [float(value) for value in means[row].values()] == pytest.approx(mean.tolist(), abs=2e-6)
    assert float(means["I", "3D-SIS", "P_D"]["f"]) > 0.8  # it is right where it found something
    assert float(means["I", "3D-SIS", "P"]["recall"]) < float(means["I", "3D-SIS", "P_D"]["recall"])


@pytest.mark.slow
def test_the_page(out):
    page = (out / "tables.md").read_text()
    tables = [line for line in page.splitlines() if line.startswith("|")]
    assert len(tables) == 2 * 2 + len(ROWS)
    assert {line.count("|") for line in tables} == {len(Scores._fields) + 3}
    assert "| 3D-SIS, P_D |      2 |" in page
    assert {file.name for file in out.iterdir()} == {"tables.md", "tables.csv", "scenes.csv"}


@pytest.mark.slow
def test_results_that_are_there_already(data, out, run, run_lab, tmp_path):
    """The same rows from the folders that `segment` wrote, the initial segmentation included."""
    for scan in SCANS:
        source = data / "scans" / scan
        run("segment", source, "-o", tmp_path / "results" / scan, "--max-frames", 2, *SMALL)
    baselines = ["--sis3d", data / "3dsis", "--scenecut", data / "scenecut"]
    run_lab("paper-tables", data, "-o", tmp_path / "out", *baselines, "--results", tmp_path / "results")
    assert (tmp_path / "out" / "tables.csv").read_text() == (out / "tables.csv").read_text()
    (tmp_path / "results" / SCANS[0] / "images" / "9.png").write_bytes(b"")
    shutil.copytree(tmp_path / "results" / SCANS[1], tmp_path / "wrong" / SCANS[0])
    for folder, message in (
        ("results", r"9\.png: the scene has no frame of that name"),
        ("wrong", r"points\.npz: expected points of the scene, got one"),
    ):
        arguments = [data / "scans" / SCANS[0], "-o", tmp_path / "x", "--results", tmp_path / folder]
        with pytest.raises(SystemExit, match=message):
            run_lab("paper-tables", *arguments)
    assert not (tmp_path / "x").exists()


@pytest.mark.slow
def test_rows_of_baselines_that_are_missing(data, run_lab, tmp_path, capsys):
    scan = data / "scans" / SCANS[0]
    run_lab("paper-tables", scan, "-o", tmp_path / "out", "--max-frames", 1, *SMALL)
    assert list(read_rows(tmp_path / "out" / "tables.csv")) == [
        ("I", "ours", "P"), ("II", "initial", "images"), ("II", "final", "images"),
    ]  # fmt: skip
    printed = capsys.readouterr().out
    assert "scene 1 of 1: scene0011_00" in printed
    assert "3D-SIS on P: nothing to score; the row is left out" in printed
    assert "SceneCut on images: nothing to score; the row is left out" in printed
    (tmp_path / "empty").mkdir()
    baselines = ["--sis3d", tmp_path / "empty", "--scenecut", tmp_path / "empty", "--max-frames", 1]
    run_lab("paper-tables", scan, "-o", tmp_path / "out", *baselines, *SMALL, "--overwrite")
    assert "scene0011_00: no result of 3D-SIS" in capsys.readouterr().out


def test_what_is_wrong_is_told_before_the_work(data, monkeypatch, tmp_path, run_lab):
    scan = data / "scans" / SCANS[0]

    def fails(message, *arguments):
        with pytest.raises(SystemExit, match=message):
            run_lab("paper-tables", scan, "-o", tmp_path / "out", *arguments)
        assert not (tmp_path / "out").exists()

    monkeypatch.setattr(tj.JointSegmenter, "forward", lambda *_, **__: pytest.fail("it was segmented"))
    fails("nowhere: no such folder; expected results in it", "--sis3d", tmp_path / "nowhere")
    fails("--max-frames: expected >= 0, got -1", "--max-frames", -1)
    for name, file in (("3dsis", "world2grid.txt"), ("3dsis", "pred_mask"), ("scenecut", "2.mat")):
        shutil.copytree(data / name, tmp_path / "copy")
        (tmp_path / "copy" / SCANS[0] / file).unlink()
        fails(rf"{file}: missing", "--sis3d" if name == "3dsis" else "--scenecut", tmp_path / "copy")
        shutil.rmtree(tmp_path / "copy")


def test_nothing_is_overwritten(data, run_lab, tmp_path):
    (tmp_path / "tables.csv").write_text("precious")
    with pytest.raises(SystemExit, match=r"tables\.csv: exists already; choose another name with -o"):
        run_lab("paper-tables", data, "-o", tmp_path)


def test_a_map_of_another_shape(data, run_lab, tmp_path):
    shutil.copytree(data / "scenecut", tmp_path / "maps")
    np.save(tmp_path / "maps" / SCANS[0] / "1.npy", np.ones((80, 60)))
    arguments = ["--scenecut", tmp_path / "maps", "--max-frames", 3, *SMALL]
    with pytest.raises(SystemExit, match=r"1\.npy: expected a map of the image's shape, 120 x 160 .*, got 80 x 60"):
        run_lab("paper-tables", data / "scans" / SCANS[0], "-o", tmp_path / "out", *arguments)


def test_scenes_without_truth(data, run_lab, tmp_path):
    scan = tmp_path / "scene0700_00"
    scan.mkdir()
    write_mesh(scan / "scene0700_00_vh_clean_2.ply", np.eye(3), np.zeros((3, 3)))
    with pytest.raises(SystemExit, match="none of its 1 scenes has a truth to compare with"):
        run_lab("paper-tables", scan, "-o", tmp_path / "out")


def test_where_nothing_was_detected_there_is_no_p_d():
    truth = torch.tensor([0, 0, 1, 1, -1])
    rows = score_points(torch.tensor([0, 0, 1, 1, 1]), truth, torch.full((5,), -1))
    assert list(rows) == [Row("I", "3D-SIS", "P"), Row("I", "ours", "P")]
    assert rows[Row("I", "ours", "P")] == Scores(1, 1, 1, 1, 1, 1, 1, 1)
    void_only = score_points(torch.zeros(5, dtype=torch.int64), truth, torch.tensor([-1, -1, -1, -1, 0]))
    assert len(void_only) == 2
    detected = score_points(torch.tensor([0, 0, 1, 1, 1]), truth, torch.tensor([5, 5, -1, -1, -1]))
    assert detected[Row("I", "3D-SIS", "P_D")].f == 1
    assert detected[Row("I", "ours", "P_D")].f == 1


def test_a_table_of_one_row():
    rows = {Row("I", "ours", "P"): [Scores(*[0.5] * 8), Scores(*[1.0] * 8)]}
    head, _, line = paper_table(rows, "I").splitlines()
    assert head.split("|")[1].strip() == "table I"
    assert [cell.strip() for cell in line.split("|")] == ["", "ours, P", "2", *["0.750"] * 8, ""]
    assert paper_table(rows, "II") == ""


def test_means_are_of_the_same_scenes():
    one, two, three = (Scores(*[value] * len(Scores._fields)) for value in (0.1, 0.2, 0.3))
    initial, final, baseline, points = ROWS[4], ROWS[5], ROWS[6], ROWS[1]
    found = {
        "a": {initial: one, final: one, baseline: one, points: one},
        "b": {initial: two, final: two, points: two},
        "c": {initial: three, final: three, baseline: three},
    }
    rows = comparable(found)
    assert rows == {points: [one, two], initial: [one, three], final: [one, three], baseline: [one, three]}
    assert comparable({"a": {initial: one}, "b": {final: two}}) == {initial: [one], final: [two]}
