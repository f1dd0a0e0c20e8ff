"""Results against truth: what is read, what is scored, and the tables."""

import csv
import math

import numpy as np
import pytest
import torch
from folder_files import write_folder, write_truth
from PIL import Image
from torchjoint_lab.benchmark.tables import method_table, paired_difference, summary_table
from torchjoint_lab.evaluation.evaluate import evaluate
from torchjoint_lab.evaluation.kinds import best_iou_by_kind
from torchjoint_lab.evaluation.predictions import Prediction, read_prediction
from torchjoint_lab.evaluation.scores import Scores, mean_scores, score, score_images
from torchjoint_lab.evaluation.table import Row, markdown, standard_error, summarize, write_csv, write_plot

import torchjoint as tj
from torchjoint.results.edits import Edit, Edits, write_edits
from torchjoint.scene import Truth


def scores(f, best_iou=0.5):
    return Scores(0.1, 0.2, 0.3, f, best_iou)


class TestScores:
    def test_they_are_the_measures(self):
        pred, target = torch.tensor([0, 0, 0, 1, 1, 2]), torch.tensor([3, 3, -1, 3, 4, 4])
        got = score(pred, target)
        assert got.covering == tj.metrics.segmentation_covering(pred, target).symmetric
        assert got[1:4] == tj.metrics.objects_and_parts(pred, target)
        assert got.best_iou == tj.metrics.mean_best_iou(pred, target)

    def test_images_without_truth_do_not_count(self):
        good, void = torch.tensor([[0, 1]]), torch.tensor([[-1, -1]])
        assert score_images([good, good], [good, void]) == score(good, good)
        assert score_images([good], [void]) is None

    def test_as_many_images_as_truths(self):
        with pytest.raises(ValueError, match="images: expected 2, one for each truth, got 1"):
            score_images([torch.zeros(1, 1).long()], [torch.zeros(1, 1).long()] * 2)

    def test_images_of_another_size(self):
        with pytest.raises(ValueError, match=r"image 1: expected the size of its truth, \[1, 2\], got \[1, 1\]"):
            score_images([torch.zeros(1, 2).long(), torch.zeros(1, 1).long()], [torch.zeros(1, 2).long()] * 2)

    def test_the_mean_of_f_is_that_of_the_samples(self):
        assert mean_scores([scores(0.2), scores(0.6)]).f == pytest.approx(0.4)


def test_a_truth_in_another_order_is_told():
    points = torch.rand(2000, 3, generator=torch.Generator().manual_seed(0))
    labels = (points * 2).long() @ torch.tensor([1, 2, 4])
    prediction = Prediction(labels, torch.arange(2000), (), ())
    assert evaluate(prediction, tj.Scene(points, truth=Truth(labels)), "cubes")[0].scores.f == 1
    mixed = tj.Scene(points, truth=Truth(labels[torch.randperm(2000, generator=torch.Generator().manual_seed(1))]))
    with pytest.warns(UserWarning, match="cubes: neighbours rarely have one truth: is it in the order of the points"):
        evaluate(prediction, mixed, "cubes")


KINDS = {9: "flat", 2: "concave", 5: "flat", 4: "flat", 1: "concave"}


class TestKinds:
    #: 40 points of instance 5, 20 of 2, 30 of 7, 19 of 9, 30 of 4, and 6 of nothing known.
    TRUTH = torch.tensor([5] * 40 + [-1] * 6 + [2] * 20 + [7] * 30 + [9] * 19 + [4] * 30)

    def test_by_hand(self):
        pred = torch.tensor([0] * 30 + [1] * 10 + [0] * 6 + [2] * 50 + [3] * 19 + [4] * 30)
        # Flat: 5 is found by 30 of 40, 4 by all, 9 has too few points. Concave: 2 shares a segment with 7; 1 is unseen.
        found = best_iou_by_kind(pred, Truth(self.TRUTH, kinds=KINDS))
        assert found == {"concave": pytest.approx(20 / 50), "flat": pytest.approx((0.75 + 1) / 2)}

    def test_they_are_those_of_mean_best_iou(self):
        random = torch.Generator().manual_seed(0)
        truth, pred = (torch.randint(low, 6, (4000,), generator=random) for low in (-1, 0))
        everything = best_iou_by_kind(pred, Truth(truth, kinds=dict.fromkeys(range(6), "any")))
        assert everything == {"any": pytest.approx(tj.metrics.mean_best_iou(pred, truth))}
        shuffled = torch.randperm(4000, generator=random)
        one = best_iou_by_kind(pred, Truth(truth, kinds={3: "three"}))
        assert one == best_iou_by_kind(pred[shuffled], Truth(truth[shuffled], kinds={3: "three"}))

    def test_a_kind_without_instances_is_left_out(self):
        assert best_iou_by_kind(self.TRUTH, Truth(self.TRUTH, kinds={9: "flat", 5: "concave"})) == {"concave": 1.0}

    @pytest.mark.parametrize("truth", [Truth(TRUTH), Truth(kinds=KINDS), Truth(-torch.ones_like(TRUTH), kinds=KINDS)])
    def test_nothing_known(self, truth):
        assert best_iou_by_kind(self.TRUTH, truth) == {}


class TestTable:
    ROWS = (
        Row("a", "ours", "3D", scores(0.9)),
        Row("a", "theirs", "3D", scores(0.5)),
        Row("b", "ours", "3D", scores(0.7)),
        Row("b", "theirs", "3D", scores(0.6)),
        Row("b", "ours", "2D", scores(0.3)),
    )

    def test_summaries_by_hand(self):
        ours, theirs = summarize(self.ROWS, "3D")
        assert (ours.method, ours.num_scenes, theirs.method) == ("ours", 2, "theirs")
        assert ours.mean.f == pytest.approx(0.8)
        assert ours.error.f == pytest.approx(0.1)  # stdev of .9 and .7 over the root of 2
        assert summarize(self.ROWS, "2D")[0].num_scenes == 1

    def test_paired_differences_by_hand(self):
        gain = paired_difference(self.ROWS, "3D", "ours", "theirs")["F"]
        assert gain.mean == pytest.approx((0.4 + 0.1) / 2)
        assert gain.error == pytest.approx(np.std([0.4, 0.1], ddof=1) / math.sqrt(2))
        assert math.isnan(paired_difference(self.ROWS, "2D", "ours", "theirs")["F"].mean)

    def test_one_value_has_no_error(self):
        assert math.isnan(standard_error([0.3]))

    def test_markdown(self):
        assert markdown(["x", "F"], [["long", "1"]]) == "| x    |   F |\n| ---- | --: |\n| long |   1 |"

    def test_a_line_a_method(self):
        lines = summary_table(self.ROWS, "3D", str.upper).splitlines()
        assert len(lines) == 4
        assert lines[2].startswith("| OURS")
        assert "0.800" in lines[2]

    def test_kinds(self, tmp_path):
        rows = [
            Row("a", "ours", "3D", scores(0.9), {"flat": 0.25, "concave": 0.5}),
            Row("b", "ours", "3D", scores(0.7), {"flat": 0.75}),
            Row("b", "theirs", "3D", scores(0.7)),
            Row("a", "ours", "2D", scores(0.9)),
        ]
        head, _, ours, theirs = summary_table(rows, "3D").splitlines()
        assert [cell.strip() for cell in head.split("|")][-3:-1] == ["concave IoU", "flat IoU"]
        assert [cell.strip() for cell in ours.split("|")][-3:-1] == ["0.500", "0.500"]
        assert [cell.strip() for cell in theirs.split("|")][-3:-1] == ["", ""]
        assert "flat" not in summary_table(rows, "2D")
        write_csv(tmp_path / "scores.csv", rows)
        with (tmp_path / "scores.csv").open() as file:
            read = list(csv.DictReader(file))
        assert [(row["concave_iou"], row["flat_iou"]) for row in read[:2]] == [
            ("0.500000", "0.250000"),
            ("", "0.750000"),
        ]
        write_csv(tmp_path / "scores.csv", rows[2:])
        assert "iou" not in (tmp_path / "scores.csv").read_text().replace("best_iou", "")

    def test_a_line_a_scene(self):
        rows = method_table(self.ROWS, "3D").splitlines()
        assert [cell.strip() for cell in rows[0].split("|")] == ["", "3D, F / best IoU", "ours", "theirs", ""]
        assert [cell.strip() for cell in rows[3].split("|")] == ["", "b", "0.700 / 0.500", "0.600 / 0.500", ""]

    def test_csv(self, tmp_path):
        write_csv(tmp_path / "scores.csv", self.ROWS)
        with (tmp_path / "scores.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == 5
        assert rows[0]["scene"] == "a"
        assert float(rows[0]["f"]) == 0.9
        assert [path.name for path in tmp_path.iterdir()] == ["scores.csv"]

    @pytest.mark.parametrize("rows", [ROWS, ROWS[:1]], ids=["methods", "scenes"])
    def test_picture(self, tmp_path, rows):
        write_plot(tmp_path / "scores.png", rows)
        with Image.open(tmp_path / "scores.png") as picture:
            assert picture.width > 300
        assert [path.name for path in tmp_path.iterdir()] == ["scores.png"]


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(2)


@pytest.fixture(scope="module")
def recording(tmp_path_factory, synthetic):
    folder = write_folder(tmp_path_factory.mktemp("evaluate") / "recording", synthetic)
    write_truth(folder, synthetic)
    return folder


class TestPredictions:
    def test_labels_of_points(self, tmp_path, synthetic):
        labels = synthetic.point_labels.numpy()
        np.save(tmp_path / "a.npy", labels.astype(np.uint16))
        np.savetxt(tmp_path / "a.txt", labels, fmt="%d")
        for name in ("a.npy", "a.txt"):
            read = read_prediction(tmp_path / name, synthetic.scene)
            assert torch.equal(read.points, synthetic.point_labels)
            assert evaluate(read, synthetic.scene, "a")[0].scores == Scores(1, 1, 1, 1, 1)

    @pytest.mark.parametrize(
        ("name", "content", "message"),
        [
            ("a.txt", "1 2 3", r"a\.txt: expected shape \[3000\], got \[3\]"),
            ("a.txt", "1 x", r"a\.txt: expected a whole number for each point"),
            ("a.npy", "no", r"a\.npy: not a whole \.npy array"),
            ("a.csv", "1", r"a\.csv: expected labels of points, \.npy or \.txt"),
        ],
    )
    def test_files_that_do_not_fit(self, tmp_path, synthetic, name, content, message):
        (tmp_path / name).write_text(content)
        with pytest.raises(ValueError, match=message):
            read_prediction(tmp_path / name, synthetic.scene)

    def test_images_are_found_by_name(self, tmp_path, synthetic):
        (tmp_path / "images").mkdir()
        for index in (4, 1):
            labels = synthetic.image_labels[index].numpy() + 1
            Image.fromarray(labels.astype(np.uint16)).save(tmp_path / "images" / f"frame-{index:06d}.png")
        read = read_prediction(tmp_path, synthetic.scene)
        assert read.points is None
        assert list(read.of_frames) == [1, 4]
        rows = evaluate(read, synthetic.scene, "a")
        assert [row.space for row in rows] == ["2D"]
        assert rows[0].scores.f == 1
        Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "images" / "other.png")
        with pytest.raises(ValueError, match=r"other\.png: the scene has no frame of that name"):
            read_prediction(tmp_path, synthetic.scene)

    def test_corrections_that_are_not_scored_are_told(self, tmp_path, synthetic):
        arrays = {"points": synthetic.scene.points.numpy(), "labels": synthetic.point_labels.numpy()}
        np.savez(tmp_path / "points.npz", **arrays)
        write_edits(tmp_path, Edits(3000, None, (Edit("join", (0, 1)),)))
        with pytest.warns(UserWarning, match=r"edits\.json: scores leave corrections by hand out"):
            read = read_prediction(tmp_path, synthetic.scene)
        assert torch.equal(read.points, synthetic.point_labels)

    def test_results_of_some_points_in_any_order(self, tmp_path, synthetic):
        some = torch.randperm(3000, generator=torch.Generator().manual_seed(0))[:500]
        points, labels = synthetic.scene.points[some], synthetic.point_labels[some]
        np.savez(tmp_path / "points.npz", points=points.numpy(), labels=labels.numpy())
        read = read_prediction(tmp_path, synthetic.scene)
        assert torch.equal(synthetic.scene.points[read.of_points], points)
        assert evaluate(read, synthetic.scene, "a")[0].scores.f == 1
        np.savez(tmp_path / "points.npz", points=points.numpy() + 1, labels=labels.numpy())
        with pytest.raises(ValueError, match=r"points\.npz: expected points of the scene, got one that is"):
            read_prediction(tmp_path, synthetic.scene)

    def test_nothing_there(self, tmp_path, synthetic):
        with pytest.raises(FileNotFoundError, match=r"nope: missing"):
            read_prediction(tmp_path / "nope", synthetic.scene)
        with pytest.raises(FileNotFoundError, match=r"has neither points\.npz nor images"):
            read_prediction(tmp_path, synthetic.scene)

    def test_scenes_without_truth(self, synthetic):
        points = synthetic.scene.points
        everything = Prediction(torch.zeros(len(points)).long(), torch.arange(len(points)), (), ())
        with pytest.raises(ValueError, match="expected a scene with ground truth"):
            evaluate(everything, tj.Scene(points), "a")
        only_images = tj.Scene(points, synthetic.scene.frames, truth=Truth(images=synthetic.image_labels))
        with pytest.raises(ValueError, match="expected ground truth for the predicted points or images"):
            evaluate(everything, only_images, "a")


class TestCommand:
    def test_a_result(self, recording, synthetic, run, run_lab, tmp_path, capsys):
        run("segment", recording, "-o", tmp_path / "result")
        run_lab("evaluate", tmp_path / "result", recording, "-o", tmp_path / "scores")
        printed = capsys.readouterr().out
        with (tmp_path / "scores" / "scores.csv").open() as file:
            in_3d, in_2d = csv.DictReader(file)
        result = tj.JointSegmenter()(tj.load_scene(recording))
        expected = score(result.points, synthetic.point_labels)
        assert float(in_3d["f"]) == pytest.approx(expected.f, abs=1e-6)
        assert f"{expected.f:.3f}" in printed
        ap = tj.metrics.scannet_average_precision(result.points, synthetic.point_labels, result.confidence)
        assert f"AP {ap.ap:.3f}, AP50 {ap.ap50:.3f}, AP25 {ap.ap25:.3f}" in printed
        assert float(in_2d["f"]) == pytest.approx(score_images(result.images, synthetic.image_labels).f, abs=1e-6)
        assert (tmp_path / "scores" / "scores.png").is_file()

    @pytest.mark.slow
    def test_a_fused_cloud_is_found_in_the_result(self, synthetic, run, run_lab, tmp_path, capsys):
        recording = write_folder(tmp_path / "recording", synthetic, cloud=False)
        for index, labels in enumerate(synthetic.image_labels):
            Image.fromarray((labels.numpy() + 1).astype(np.uint16)).save(recording / f"frame-{index * 5:06d}.truth.png")
        run("segment", recording, "-o", tmp_path / "result", "--voxel-size", 0.05)
        run_lab("evaluate", tmp_path / "result", recording, "--voxel-size", 0.05)
        assert "2D" in capsys.readouterr().out

    def test_a_data_set(self, recording, synthetic, run_lab, tmp_path, capsys):
        data, results = tmp_path / "data", tmp_path / "results"
        data.mkdir()
        results.mkdir()
        for name in ("first", "second"):
            (data / name).symlink_to(recording)
            np.save(results / f"{name}.npy", synthetic.point_labels.numpy())
        run_lab("evaluate", results, data)
        lines = capsys.readouterr().out.splitlines()
        assert [line.split("|")[1].strip() for line in lines[2:5]] == ["first", "second", "mean"]
        (results / "second.txt").write_text("0\n" * 3000)
        with pytest.raises(SystemExit, match=r"expected one prediction of second, got second\.npy, second\.txt"):
            run_lab("evaluate", results, data)
        (results / "second.txt").unlink()
        (results / "second.npy").unlink()
        with pytest.raises(SystemExit, match=r"second: missing; expected a result"):
            run_lab("evaluate", results, data)

    def test_what_is_left_out_is_told(self, recording, synthetic, run_lab, tmp_path, capsys):
        keep = synthetic.scene.points[:, 0] > synthetic.scene.points[:, 0].median()
        points, labels = synthetic.scene.points[keep], synthetic.point_labels[keep]
        np.savez(tmp_path / "points.npz", points=points.numpy(), labels=labels.numpy())
        run_lab("evaluate", tmp_path, recording)
        assert f"recording: the result has only {len(points)} of 3000 points" in capsys.readouterr().out

    def test_scenes_before_a_bad_one_are_not_lost(self, recording, synthetic, run_lab, tmp_path, capsys):
        data, results = tmp_path / "data", tmp_path / "results"
        data.mkdir()
        results.mkdir()
        for name in ("first", "second", "without"):
            (data / name).symlink_to(recording)
            np.save(results / f"{name}.npy", synthetic.point_labels.numpy())
        (data / "without").unlink()
        write_folder(data / "without", synthetic)
        run_lab("evaluate", results, data, "-o", tmp_path / "scores")
        printed = capsys.readouterr().out
        assert "without: has no ground truth and is left out" in printed
        np.save(results / "second.npy", np.zeros(3, int))
        with pytest.raises(SystemExit, match="exists already"):
            run_lab("evaluate", results, data, "-o", tmp_path / "scores")
        with pytest.raises(SystemExit, match=r"second\.npy: expected shape \[3000\]"):
            run_lab("evaluate", results, data, "-o", tmp_path / "scores", "--overwrite")
        assert "| first" in capsys.readouterr().out
        assert len((tmp_path / "scores" / "scores.csv").read_text().splitlines()) == 2

    def test_only_points_in_view(self, synthetic, run, tmp_path):
        recording = write_folder(tmp_path / "recording", synthetic)
        run("segment", recording, "-o", tmp_path / "result", "--max-frames", "1", "--in-view")
        with np.load(tmp_path / "result" / "points.npz") as arrays:
            kept = torch.from_numpy(arrays["points"])
        frame = synthetic.scene.frames[0]
        camera = (frame.world_to_camera[:3, :3] @ synthetic.scene.points.double().T).T + frame.world_to_camera[:3, 3]
        u, v, w = (frame.intrinsics @ camera.T).unbind()
        inside = (camera[:, 2] > 0.05) & (u / w > -0.5) & (u / w < 159.5) & (v / w > -0.5) & (v / w < 119.5)
        assert 0 < inside.sum() < len(inside)
        assert torch.equal(kept, synthetic.scene.points[inside])
