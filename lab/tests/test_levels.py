"""Scores of all levels: by hand, and what evaluate reports of them."""

import csv
import shutil
from pathlib import Path

import pytest
import torch
from folder_files import write_folder, write_truth
from torchjoint_lab.evaluation.levels import GRANULARITIES, best_levels, level_table, score_levels
from torchjoint_lab.evaluation.scores import score

import torchjoint as tj
from torchjoint.results.folder import read_result
from torchjoint.scene import Hierarchy

LEARNED = ["--set", "boundary.detector=gradient"]
#: Four superpoints of two points. 0 and 1 merge at .4, 2 and 3 at .6, all at .8.
HIERARCHY = Hierarchy(
    torch.arange(4).repeat_interleave(2),
    torch.tensor([[0, 1], [2, 3], [0, 2]]),
    torch.tensor([0.4, 0.6, 0.8], dtype=torch.float64),
)


def scores_by_granularity(truth):
    return dict(zip(GRANULARITIES, score_levels(HIERARCHY, torch.tensor(truth)), strict=True))


def test_the_grid():
    assert len(GRANULARITIES) == 21
    assert GRANULARITIES[0] == 0
    assert GRANULARITIES[10] == 0.5
    assert GRANULARITIES[-1] == 1


def test_levels_by_hand():
    halves = scores_by_granularity([0, 0, 0, 0, 1, 1, 1, 1])
    assert halves[0.0].best_iou == 0.5  # one segment
    assert halves[0.3].best_iou == 1  # two
    assert halves[0.3].f == 1
    assert halves[0.5].best_iou == pytest.approx((1 + 0.5) / 2)  # three
    assert halves[1.0].best_iou == 0.5  # four
    quarters = scores_by_granularity([0, 0, 1, 1, 2, 2, -1, -1])
    assert quarters[1.0].best_iou == 1
    assert quarters[0.5].best_iou == pytest.approx((0.5 + 0.5 + 1) / 3)
    for granularity, scores in quarters.items():
        assert scores == score(HIERARCHY.at(granularity), torch.tensor([0, 0, 1, 1, 2, 2, -1, -1]))


def test_best_levels_by_hand():
    best = best_levels([[0.1, 0.4, 0.7], [0.9, 0.5, 0.3]], [0.25, 0.5, 0.75])
    assert best == (pytest.approx(0.45), pytest.approx(0.5), 0.25, pytest.approx(0.8))
    assert best_levels([[0.3, 0.2, 0.3]], [0.75, 0.5, 0.25]).granularity == 0.25  # of equals the coarsest
    one = best_levels([[0.1, 0.4, 0.7]], [0.25, 0.5, 0.75])
    assert one == (0.4, 0.7, 0.75, 0.7)


def test_best_levels_of_what_does_not_fit():
    with pytest.raises(ValueError, match="values: expected 2 for each scene, got"):
        best_levels([], [0.5, 1.0])
    with pytest.raises(ValueError, match="values: expected 2 for each scene, got"):
        best_levels([[0.1, 0.2], [0.1]], [0.5, 1.0])
    with pytest.raises(ValueError, match=r"granularities: expected 0\.5 among them, got \[0\.1, 1\.0\]"):
        best_levels([[0.1, 0.2]], [0.1, 1.0])


def test_the_table():
    scenes = {
        "a": score_levels(HIERARCHY, torch.tensor([0, 0, 0, 0, 1, 1, 1, 1])),
        "b": score_levels(HIERARCHY, torch.tensor([0, 0, 1, 1, 2, 2, 3, 3])),
    }
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in level_table(scenes).splitlines()]
    assert rows[0] == [
        "3D, all levels", "default", "best level of the data set", "granularity", "best level of each scene",
    ]  # fmt: skip
    # Best IoU of a and b: .5 .25 (one segment), 1 .5 (two), .75 .625 (three), .5 1 (four).
    assert rows[4] == ["best IoU", f"{(0.75 + 0.75) / 2:.3f}", "0.750", "0.25", "1.000"]
    assert [row[0] for row in rows[2:]] == ["covering", "F", "best IoU"]
    alone = [[cell.strip() for cell in line.split("|")[1:-1]] for line in level_table({"a": scenes["a"]}).splitlines()]
    assert alone[0] == ["3D, all levels", "default", "best level", "granularity"]
    assert alone[4] == ["best IoU", "0.750", "1.000", "0.25"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory, scene_of):
    folder = write_folder(tmp_path_factory.mktemp("levels") / "recording", scene_of(4))
    write_truth(folder, scene_of(4))
    return folder


@pytest.fixture(scope="module")
def out(recording, run):
    run("segment", recording, "-o", recording.parent / "out", *LEARNED, "--granularity", 0.7)
    return recording.parent / "out"


class TestCommands:
    def test_segment_writes_the_level_and_all_others(self, out, recording):
        config = tj.Config().set(["boundary.detector=gradient"])
        expected = tj.JointSegmenter(config)(tj.load_scene(recording))
        read = read_result(out)
        assert torch.equal(read.points, expected.at(0.7).points)
        for got, image in zip(read.images, expected.at(0.7).images, strict=True):
            assert torch.equal(got, image)
        assert torch.equal(read.at().points, expected.points)
        assert "granularity: 0.7" in (out / "run.yaml").read_text()

    def test_show_makes_a_page_of_another_level(self, out, run, monkeypatch, tmp_path):
        shown = []
        monkeypatch.setattr(
            "torchjoint.viewer.shared_page.write_page",
            lambda path, result, edits: shown.append((result.points, edits.granularity)) or path.write_text(""),
        )
        result = read_result(out)
        run("show", out, "--static", tmp_path / "page.html")
        run("show", out, "--static", tmp_path / "page.html", "--granularity", 0.2, "--overwrite")
        assert [level for _, level in shown] == [None, 0.2]
        assert all(torch.equal(points, result.points) for points, _ in shown)
        with pytest.raises(SystemExit, match="--granularity: expected a number from 0"):
            run("show", out, "--granularity", 2)

    def test_evaluate_scores_all_levels(self, out, recording, scene_of, run_lab, tmp_path, capsys):
        run_lab("evaluate", out, recording, "-o", tmp_path / "scores")
        printed = capsys.readouterr().out
        levels = score_levels(read_result(out).hierarchy, scene_of(4).point_labels)
        assert f"| best IoU       |   {levels[10].best_iou:.3f} |" in printed
        with (tmp_path / "scores" / "levels.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert [float(row["granularity"]) for row in rows] == pytest.approx(GRANULARITIES)
        assert [float(row["f"]) for row in rows] == pytest.approx([scores.f for scores in levels], abs=1e-6)

    def test_evaluate_of_a_data_set(self, out, recording, scene_of, run_lab, tmp_path, capsys):
        data, results = tmp_path / "data", tmp_path / "results"
        for folder, link in ((data, recording), (results, out)):
            folder.mkdir()
            for name in ("first", "second"):
                (folder / name).symlink_to(link)
        run_lab("evaluate", results, data)
        assert "best level of each scene" in capsys.readouterr().out
        (results / "second").unlink()
        (results / "second").mkdir()
        (results / "second" / "points.npz").symlink_to(out / "points.npz")
        run_lab("evaluate", results, data)
        printed = capsys.readouterr().out
        assert "best level" not in printed
        assert "only 1 of 2 results have levels: no scores of all levels" in printed

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (
                ["--granularity", 0.5, "--preset", "paper"],
                r"--granularity: expected a method with levels, .* got paper",
            ),
            (["--granularity", -0.1], r"--granularity: expected a number from 0 \(coarse\)"),
        ],
    )
    def test_segment_refuses_before_it_runs(self, recording, run, tmp_path, arguments, message):
        with pytest.raises(SystemExit, match=message):
            run("segment", recording, "-o", tmp_path / "out", *arguments)
        assert list(tmp_path.iterdir()) == []

    def test_show_of_a_result_with_one_level(self, run, tmp_path):
        out = shutil.copytree(Path(__file__).parents[2] / "tests" / "samples" / "result-0.1.0", tmp_path / "out")
        (out / "hierarchy.npz").unlink()
        with pytest.raises(SystemExit, match=r"--granularity: expected a result with levels"):
            run("show", out, "--granularity", 0.2)
