"""Predictions as ScanNet's benchmark reads them, both ways, and which true instances a benchmark counts."""

import json

import numpy as np
import pytest
import samples
import torch
from scannet_files import write_mesh, write_point_truth
from torchjoint_lab.evaluation.instances import Instances, painted, read_instances
from torchjoint_lab.evaluation.protocols import PROTOCOLS, counted, find_table

import torchjoint as tj
from torchjoint.results.exports.masks import export_masks, export_scannet

SCAN = "scene0011_00"
#: Raw category, id (ScanNet200), nyu40id: a keyboard is only in ScanNet200, a shampoo bottle and a wall in neither.
ROWS = [("chair", 2, 5), ("keyboard", 47, 40), ("wall", 1, 1), ("shampoo bottle", 3000, 40), ("table", 4, 7)]


@pytest.fixture
def scans(tmp_path, scene_of):
    """Two scans in the layout of the data set, without frames; each object has a category of ROWS."""
    made = scene_of(2)
    for name in (SCAN, "scene0011_01"):
        folder = tmp_path / "data" / "scans" / name
        folder.mkdir(parents=True)
        colors = np.zeros((len(made.scene.points), 3), np.uint8)
        write_mesh(folder / f"{name}_vh_clean_2.ply", made.scene.points.numpy(), colors)
        write_point_truth(folder, name, made.point_labels)
        file = folder / f"{name}.aggregation.json"
        record = json.loads(file.read_text())
        for group in record["segGroups"]:
            group["label"] = ROWS[group["objectId"] % len(ROWS)][0]
        file.write_text(json.dumps(record))
    lines = ["id\traw_category\tcount\tnyu40id", *(f"{id}\t{raw}\t9\t{nyu}" for raw, id, nyu in ROWS)]
    (tmp_path / "data" / "scannetv2-labels.combined.tsv").write_text("\n".join(lines) + "\n")
    return tmp_path / "data"


def some_instances(labels, seed=0):
    """Overlapping masks: the true instances, each with some points more and fewer, and a score."""
    random = torch.Generator().manual_seed(seed)
    masks = torch.stack([labels == one for one in labels[labels >= 0].unique()])
    masks ^= torch.rand(masks.shape, generator=random) < 0.1 * torch.rand(len(masks), 1, generator=random)
    return masks, torch.rand(len(masks), generator=random).double()


def write_listing(folder, scan, masks, scores):
    (folder / "predicted_masks").mkdir(exist_ok=True)
    lines = []
    for index, (mask, score) in enumerate(zip(masks, scores.tolist(), strict=True)):
        np.savetxt(folder / "predicted_masks" / f"{scan}_{index}.txt", mask.numpy(), fmt="%d")
        lines.append(f"predicted_masks/{scan}_{index}.txt 5 {score!r}")
    (folder / f"{scan}.txt").write_text("\n".join(lines) + "\n")


def test_help_names_the_protocols_alone(run_lab, capsys):
    with pytest.raises(SystemExit):
        run_lab("evaluate", "--help")
    assert "--protocol {scannetv2,scannet200,scannetpp}" in capsys.readouterr().out


@pytest.mark.parametrize("protocol", [None, "scannetv2", "scannet200"])
def test_a_data_set(scans, scene_of, run_lab, tmp_path, capsys, protocol):
    labels, predictions = scene_of(2).point_labels, tmp_path / "predictions"
    predictions.mkdir()
    metric = tj.metrics.ScannetAveragePrecisionMetric()
    wanted = {None: ROWS, "scannetv2": [ROWS[0], ROWS[4]], "scannet200": [ROWS[0], ROWS[1], ROWS[4]]}[protocol]
    kept = [one for one in labels[labels >= 0].unique().tolist() if ROWS[one % len(ROWS)] in wanted]
    truth = torch.where(torch.isin(labels, torch.tensor(kept)), labels, -1)
    for seed, scan in enumerate((SCAN, "scene0011_01")):
        masks, scores = some_instances(labels, seed)
        if seed:
            arrays = {"pred_masks": masks.T.numpy(), "pred_score": scores.numpy(), "pred_classes": np.ones(len(masks))}
            np.savez_compressed(predictions / f"{scan}.npz", **arrays)
        else:
            write_listing(predictions, scan, masks, scores)
        metric.update(masks, truth, scores)
    run_lab("evaluate", predictions, scans, *([] if protocol is None else ["--protocol", protocol]))
    ap, ap50, ap25 = metric.compute()
    assert 0 < ap < 1
    assert f"AP {ap:.3f}, AP50 {ap50:.3f}, AP25 {ap25:.3f}" in capsys.readouterr().out


def test_an_export_comes_back(scans, scene_of, run, tmp_path):
    labels = scene_of(2).point_labels.clamp(min=0)
    scan = tj.load_scene(scans / "scans" / SCAN)
    result = tj.Result.of(tj.Segmentation(labels.unique(return_inverse=True)[1], ()), scan)
    export_scannet(tmp_path / "out", result)
    export_masks(tmp_path / "out.npz", result)
    for file in (tmp_path / "out" / f"{SCAN}.txt", tmp_path / "out.npz"):
        read = read_instances(file, len(labels))
        assert torch.equal(painted(read, len(labels)), result.points)
        assert read.scores.tolist() == [1.0] * result.num_point_segments
    first = (tmp_path / "out" / f"{SCAN}.txt").read_text().split()[:3]
    assert first == [f"predicted_masks/{SCAN}_000.txt", "1", "1.0000"]
    assert np.array_equal(np.loadtxt(tmp_path / "out" / first[0]), (result.points == 0).numpy())


def test_the_best_score_is_on_top():
    found = Instances([torch.tensor([0, 1]), torch.tensor([1, 2]), torch.tensor([2, 3])], torch.tensor([0.5, 0.9, 0.9]))
    assert painted(found, 5).tolist() == [0, 1, 1, 2, -1]


def test_the_classes_of_the_benchmarks():
    assert len(PROTOCOLS["scannetv2"].classes) == 18
    assert len(PROTOCOLS["scannet200"].classes) == 198
    assert not {1, 3} & PROTOCOLS["scannet200"].classes  # wall and floor
    assert not {1, 2} & PROTOCOLS["scannetv2"].classes


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("predicted_masks/a.txt 5 0.5\n../b.txt 5 0.5", r"line 2: expected a file below .*, got '\.\./b\.txt'"),
        ("predicted_masks/a.txt 5 0.5\n/etc/b.txt 5 0.5", "line 2: expected a file below"),
        ("predicted_masks/a.txt 5 much", "line 1: expected a number as score, got 'much'"),
        ("predicted_masks/a.txt 5 nan", "expected a finite score for each of 1 masks"),
        ("predicted_masks/a.txt 5 0.5\npredicted_masks/a.txt", "line 2: expected at most 100000 masks, as"),
        ("predicted_masks/few.txt 5 0.5", r"few\.txt: expected 0 or 1 for each of 4 points, got 2 numbers"),
        ("predicted_masks/no.txt 5 0.5", r"no\.txt: expected 0 or 1 for each point"),
        ("predicted_masks/p.txt 5 0.5", r"p\.txt: expected booleans, or numbers 0 and 1, got .* from 0 to 0\.9"),
        ("predicted_masks/long.txt 5 0.5", r"long\.txt: expected 0 or 1 for each of 4 points, got 1000 bytes"),
        ("predicted_masks/none.txt 5 0.5", r"none\.txt: missing; expected a mask"),
    ],
)
def test_damaged_listings(tmp_path, content, message):
    (tmp_path / "predicted_masks").mkdir()
    for name, text in (("a", "0 1 1 0"), ("few", "0 1"), ("no", "0 x 1 0"), ("long", "0 " * 500), ("p", "0.1 0 0 0.9")):
        (tmp_path / "predicted_masks" / f"{name}.txt").write_text(text)
    (tmp_path / "scene.txt").write_text(content)
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        read_instances(tmp_path / "scene.txt", 4)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"pred_score": np.ones(2)}, "expected arrays pred_masks and pred_score, got pred_score"),
        ({"pred_masks": np.ones((2, 4), bool), "pred_score": np.ones(2)}, r"expected shape \[4, K\], got \[2, 4\]"),
        ({"pred_masks": -np.ones((4, 2)), "pred_score": np.ones(2)}, "expected booleans, or numbers 0 and 1, got"),
        ({"pred_masks": np.ones((4, 2), bool), "pred_score": np.ones(3)}, "expected a finite score for each of 2"),
    ],
)
def test_damaged_archives(tmp_path, arrays, message):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ValueError, match=message):
        read_instances(tmp_path / "a.npz", 4)


def test_a_protocol_needs_its_table_and_its_truth(scans, run_lab, tmp_path, scene_of):
    predictions = tmp_path / "predictions"
    predictions.mkdir()
    scan = scans / "scans" / SCAN
    np.save(tmp_path / "a.npy", scene_of(2).point_labels.numpy())
    table = scans / "scannetv2-labels.combined.tsv"
    table.rename(tmp_path / "labels.tsv")
    with pytest.raises(SystemExit, match=r"labels\.combined\.tsv: missing, also in the two folders above"):
        run_lab("evaluate", tmp_path / "a.npy", scan, "--protocol", "scannet200")
    run_lab("evaluate", tmp_path / "a.npy", scan, "--protocol", "scannet200", "--label-table", tmp_path / "labels.tsv")
    with pytest.raises(SystemExit, match="--label-table: expected a --protocol"):
        run_lab("evaluate", tmp_path / "a.npy", scan, "--label-table", tmp_path / "labels.tsv")
    file = scan / f"{SCAN}.aggregation.json"
    groups = json.loads(file.read_text())["segGroups"]
    file.write_text(json.dumps({"segGroups": [*groups, groups[0]]}))  # the same one again, as in a scan of ScanNet
    counted(scene_of(2).point_labels, scan, "scannet200", tmp_path / "labels.tsv")
    file.write_text(json.dumps({"segGroups": [*groups, groups[0] | {"label": "wall"}]}))
    with pytest.raises(ValueError, match=r"aggregation\.json: objectId with two categories: 0 is there twice"):
        counted(scene_of(2).point_labels, scan, "scannet200", tmp_path / "labels.tsv")
    file.write_text(json.dumps({"segGroups": groups}))
    table.write_text("id\traw_category\n1\twall\n")
    with pytest.raises(SystemExit, match="expected columns raw_category and nyu40id; missing: nyu40id"):
        run_lab("evaluate", tmp_path / "a.npy", scan, "--protocol", "scannetv2")
    table.write_text("id\traw_category\tnyu40id\n1\twall\tone\n")
    with pytest.raises(ValueError, match="nyu40id: expected whole numbers"):
        counted(scene_of(2).point_labels, scan, "scannetv2", table)


def test_a_scan_of_which_nothing_counts_is_left_out(scans, scene_of, run_lab, tmp_path, capsys):
    file = scans / "scans" / SCAN / f"{SCAN}.aggregation.json"
    groups = json.loads(file.read_text())["segGroups"]
    file.write_text(json.dumps({"segGroups": [group | {"label": "wall"} for group in groups]}))
    (tmp_path / "labels").mkdir()
    for name in (SCAN, "scene0011_01"):
        np.save(tmp_path / "labels" / f"{name}.npy", scene_of(2).point_labels.numpy())
    run_lab("evaluate", tmp_path / "labels", scans, "--protocol", "scannetv2")
    printed = capsys.readouterr().out
    assert f"{SCAN}: has no ground truth and is left out" in printed
    assert "| scene0011_01 |" in printed


@pytest.fixture
def scannetpp(tmp_path):
    """A scene of 40 vertices: object 3 has 20 to 30, 1 has 0 to 20, and within it 2 has 5 to 10 and 4 has 12 to 14."""
    scene = samples.write("scannetpp", tmp_path / "set")
    file = scene / "scans" / "segments_anno.json"
    groups = json.loads(file.read_text())["segGroups"]
    groups.append({"id": 4, "objectId": 4, "segments": [12, 13], "label": "dust"})
    for group, label in zip(groups, ("book on desk", "desks", "wall", "dust"), strict=True):
        group["label"] = label
    file.write_text(json.dumps({"segGroups": groups}))
    metadata = tmp_path / "set" / "metadata" / "semantic_benchmark"
    metadata.mkdir(parents=True)
    rows = ["class,count,semantic_map_to,instance_map_to", "desks,3,table,", "book on desk,1,None,book", "wall,9,,wall"]
    (metadata / "map_benchmark.csv").write_text("\n".join([*rows, "dust,1,dust,dust"]) + "\n")
    (metadata / "top100.txt").write_text("wall\ntable\nbook\n")
    (metadata / "top100_instance.txt").write_text("table\nbook\n")
    return scene


def test_scannetpp_counts_what_its_toolkit_counts(scannetpp):
    table = find_table(scannetpp, "scannetpp")
    truth = tj.load_scene(scannetpp).truth.points
    # Objects without a class of the benchmark take no vertices from the table; walls are void.
    assert counted(truth, scannetpp, "scannetpp", table).tolist() == [1] * 20 + [-1] * 20
    table.write_text(table.read_text().replace("None,book", "book,"))
    assert counted(truth, scannetpp / "dslr", "scannetpp", table).tolist() == [1] * 5 + [2] * 5 + [1] * 10 + [-1] * 20
    # A class without another one in the table is a class itself.
    table.with_name("top100_instance.txt").write_text("wall\n")
    assert counted(truth, scannetpp, "scannetpp", table).tolist() == [-1] * 20 + [3] * 10 + [-1] * 10


def test_scannetpp_needs_its_lists(scannetpp, run_lab, tmp_path, capsys):
    np.save(tmp_path / "a.npy", np.repeat([0, 1], 20))
    arguments = ("evaluate", tmp_path / "a.npy", scannetpp, "--protocol", "scannetpp")
    row = "| 1ada7a0617 |    3D |    1.000 |     1.000 |  1.000 | 1.000 |    1.000 |"
    run_lab(*arguments[:3])
    assert row not in capsys.readouterr().out
    run_lab(*arguments)
    assert row in capsys.readouterr().out
    table = find_table(scannetpp, "scannetpp")
    table.with_name("top100.txt").unlink()
    with pytest.raises(SystemExit, match=r"top100\.txt: missing; expected the benchmark's classes"):
        run_lab(*arguments)
    table.write_text("class\nwall\n")
    with pytest.raises(SystemExit, match="expected columns class and semantic_map_to; missing: semantic_map_to"):
        run_lab(*arguments)
    table.unlink()
    with pytest.raises(SystemExit, match=r"map_benchmark\.csv: missing, also in the two folders above"):
        run_lab(*arguments)
