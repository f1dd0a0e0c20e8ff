"""The studies of lab/studies/: they start, and what they change by name is there. Their runs take minutes to hours."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from torchjoint_lab.benchmark.disturbances import moved
from torchjoint_lab.benchmark.robustness_scenes import NamedScene
from torchjoint_lab.evaluation.scores import score
from torchjoint_lab.synthetic import make_domain_scene

import torchjoint as tj

STUDIES = Path(__file__).parents[1] / "studies"
HELPERS = ("domain_tables", "report", "streets")
#: Draw pictures of the documents; have no arguments, so each start is a run.
WITHOUT_ARGUMENTS = ("pictures", "viewer")


@pytest.fixture
def study(monkeypatch):
    """Imports a study: `study("domains")`."""
    monkeypatch.syspath_prepend(STUDIES)
    return import_module


def run(module, monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", [module.__name__, *map(str, arguments)])
    module.main()


@pytest.mark.parametrize("name", sorted({path.stem for path in STUDIES.glob("*.py")} - {*HELPERS, *WITHOUT_ARGUMENTS}))
def test_a_study_starts(name, study, monkeypatch, capsys):
    module = study(name)
    with pytest.raises(SystemExit) as ended:
        run(module, monkeypatch, "--help")
    assert ended.value.code == 0
    assert "usage: " in capsys.readouterr().out


def test_a_table_replaces_that_of_the_page_only_when_told(study, tmp_path, monkeypatch, capsys):
    report, page = study("report"), tmp_path / "README.md"
    page.write_text("<!-- strides -->\nmeasured\n<!-- end strides -->\n")
    monkeypatch.setattr(report.write_part, "__defaults__", (page,))
    report.show("strides", "tried", write=False)
    assert "measured" in page.read_text()
    report.show("strides", "new", write=True)
    assert page.read_text() == "<!-- strides -->\nnew\n<!-- end strides -->\n"
    assert capsys.readouterr().out == "tried\nnew\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seeds", 0], "--seeds: expected at least 1, got 0"),
        (["--scenes", 0], "--scenes: expected at least 1, got 0"),
        (["--kinds", "table", "shelf"], "--kinds: expected at least three that are trained on, got table, shelf"),
        (["--kinds", "table", "shelf", "mosd", "ycb"], "--kinds: ycb is scored by the models without desks; add desk"),
        ([], "--data: expected a folder with "),
    ],
)
def test_domains_says_what_is_wrong(study, tmp_path, monkeypatch, capsys, arguments, message):
    with pytest.raises(SystemExit):
        run(study("domains"), monkeypatch, tmp_path / "work", "--data", tmp_path, *arguments)
    assert message in capsys.readouterr().err
    assert not (tmp_path / "work").exists()


def test_domains_keeps_results_of_other_scenes_apart(study, tmp_path, monkeypatch, capsys):
    arguments = [tmp_path, "--data", tmp_path, "--part", "tables", "--kinds", "table", "shelf", "desk", "--scenes"]
    run(study("domains"), monkeypatch, *arguments, 1)
    run(study("domains"), monkeypatch, *arguments, 1)
    with pytest.raises(SystemExit):
        run(study("domains"), monkeypatch, *arguments, 2)
    assert "has results of other arguments" in capsys.readouterr().err


@pytest.mark.slow  # that they start is tested above
def test_steps_are_scored_on_the_same_evidence(study, tmp_path, monkeypatch, capsys):
    steps, scene = study("steps"), make_domain_scene("desk", 3, num_views=2).scene
    monkeypatch.setattr(steps, "find_scenes", lambda *_: [NamedScene("desk", "desk-3", lambda: scene)])
    some = {name: steps.STEPS[name] for name in ("default", "one tree, not fifteen", "no colours")}
    monkeypatch.setattr(steps, "STEPS", some)
    run(steps, monkeypatch, tmp_path, "--runs", 1)
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert rows[0][0] == "generated, 1"
    assert [row[0] for row in rows[2:]] == list(steps.STEPS)
    points = moved(scene.points, steps.NOISE, torch.Generator().manual_seed(0))
    judged = score(tj.JointSegmenter()(replace(scene, points=points)).points, scene.truth.points)
    found = json.loads((tmp_path / "desk-3.0.json").read_text())
    assert found["default"] == [judged.f, judged.best_iou]
    assert found["no colours"] != found["default"]


@pytest.mark.slow  # that they start is tested above
def test_the_best_of_superpoints_and_tree_is_no_worse(study, monkeypatch, capsys):
    limits, scene = study("limits"), make_domain_scene("desk", 3, num_views=2).scene
    monkeypatch.setattr(limits, "find_scenes", lambda *_: [NamedScene("desk", "desk-3", lambda: scene)])
    run(limits, monkeypatch, "--runs", 1)
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    superpoints, tree, default = map(float, rows[-1][-3:])
    assert 1 > superpoints >= tree >= default > 0.2
    assert sum(int(row[1]) for row in rows[2:-1]) == len(scene.truth.points[scene.truth.points >= 0].unique())
    truth = torch.tensor([0, 0, 1, 1, -1])
    assert limits.best_ious(torch.tensor([5, 5, 5, 7, 7]), truth).tolist() == [2 / 3, 0.5]


@pytest.mark.slow  # that they start is tested above
def test_live_scores_and_lasting_ids(study, tmp_path, monkeypatch, capsys):
    live = study("live")
    monkeypatch.setattr(live, "NOISES", (0.0, 0.1))
    monkeypatch.setattr(live, "VOXEL", 0.08)
    monkeypatch.setattr(live, "EVERY_DENSE", 2)
    monkeypatch.setattr(live, "SETTLED", 2)
    run(live, monkeypatch, tmp_path, "--kinds", "desk", "--scenes", 1, "--views", 4, "--runs", 1, "--dense", 6)
    *rows, last = [line.split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| desk")]
    assert last[1] == "6"  # far apart: all are keyframes
    assert float(last[4]) == 1
    assert all(0 < float(share.rstrip(" |")) <= 1 for share in last[5:])
    assert [row[1] for row in rows] == ["0%", "10%"]
    assert all(0 < float(value) <= 1 for row in rows for value in row[2].split(" / "))
    assert len(list(tmp_path.glob("*.json"))) == 4


def test_superpoints_are_compared_at_equal_numbers(study):
    superpoints = study("superpoints")
    runs = [superpoints.Run(4.0, 10, 0.4, 0.2, 0.8, 1.0), superpoints.Run(1.0, 40, 0.8, 0.1, 0.9, 2.0)]
    assert superpoints.at(runs, 20) == pytest.approx([0.6, 0.15, 0.85, 1.5])
    assert all(map(math.isnan, superpoints.at(runs, 5)))


@pytest.mark.slow  # that they start is tested above
def test_superpoints_of_all_methods_but_cut_pursuit(study, tmp_path, monkeypatch, capsys):
    superpoints, scene = study("superpoints"), make_domain_scene("desk", 3, num_views=2).scene
    monkeypatch.setattr(superpoints, "find_scenes", lambda *_: [NamedScene("room", "room-3", lambda: scene)])
    for _ in range(2):  # the second time from the disk
        run(superpoints, monkeypatch, tmp_path)
        lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
        rows = {row[0]: row[1:] for row in (line.strip("| ").split(" | ") for line in lines[2:])}
        assert list(rows) == list(superpoints.methods(None))
        for cells in rows.values():
            recall, error, accuracy = map(float, cells[2].split(" / "))
            assert recall > 0.3
            assert error < 0.5
            assert accuracy > 0.7
    assert len(json.loads((tmp_path / "room-3.json").read_text())) == len(rows) + 2


def test_an_id_lasts_if_the_thing_had_it_since_it_was_whole(study):
    live = study("live")
    place = torch.tensor([[0.05, 0, 0], [0.15, 0, 0], [0.25, 0, 0], [0.35, 0, 0]])

    def result(labels):
        cloud = tj.Cloud(place[: len(labels)])
        return SimpleNamespace(cloud=cloud, labels=torch.tensor(labels))

    # 7 was 5 as long as half of it was seen, which does not count; 8 was 6 when it was whole.
    assert live.lasting([result([5]), result([7, 7, 6, 6]), result([7, 7, 8, 8])]) == (0.5, 0.5, 0.5)
    # The first result in which 8 was whole does not count; 9 was whole in no other.
    results = [result([8, 8]), result([6, 6]), result([8, 8, 9, 9]), result([8, 8, 9, 9])]
    assert live.lasting(results, 2) == (1.0, 1.0, 1.0)
    assert live.lasting(results, 1) == (0.5, 0.5, 0.5)
    assert live.cubes_of(result([1, 2])) == {(0, 0, 0): 1, (1, 0, 0): 2}
