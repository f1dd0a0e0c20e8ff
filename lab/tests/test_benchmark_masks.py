"""The suite "masks": its table by hand, and the command, which goes on where it was."""

from __future__ import annotations

import json

import pytest
from torchjoint_lab.benchmark import masks
from torchjoint_lab.cli.benchmark import benchmark


def record(f, best_iou, images=None):
    found = {"seconds": 2.0, "3D": [0.5, f, best_iou]}
    return found if images is None else found | {"2D": [0.5, *images]}


def test_differences_are_paired_after_a_mean_over_seeds():
    results = [
        (masks.Run("room", 10, 0, "hard"), {"ours": record(0.5, 0.9, (0.7, 0.8)), "sai3d": record(0.2, 0.8)}),
        (masks.Run("room", 10, 1, "hard"), {"ours": record(0.5, 0.7, (0.7, 0.8)), "sai3d": record(0.4, 0.8)}),
        (masks.Run("room", 11, 0, "hard"), {"ours": record(0.7, 0.5, (0.5, 0.6)), "sai3d": record(0.6, 0.6)}),
        (masks.Run("room", 11, 1, "hard"), {"ours": record(0.9, 0.3, (0.5, 0.6)), "sai3d": record(0.8, 0.6)}),
    ]
    ours, theirs = (line.split("|") for line in masks.report(results, "tuning").splitlines()[-2:])
    assert [cell.strip() for cell in ours[1:-1]] == [
        "room, hard", "joint", "0.500 ± 0.000 / 0.650 ± 0.071 / 0.600 ± 0.141", "", "",
        "0.600 ± 0.000 / 0.700 ± 0.000", "2.0",
    ]  # fmt: skip
    assert [cell.strip() for cell in theirs[2:-1]] == [
        "SAI3D", "0.500 ± 0.000 / 0.500 ± 0.141 / 0.700 ± 0.000", "**+0.150 ± 0.050**", "-0.100 ± 0.100", "", "2.0"
    ]  # fmt: skip


def test_every_seed_has_all_levels_of_a_scene():
    todo = masks.runs("checking", 2, 3, ("table",))
    levels = ("perfect", "sam-like", "hard")
    assert todo == [
        masks.Run("table", 100 + scene, seed, level) for scene in (0, 1) for seed in range(3) for level in levels
    ]


@pytest.mark.slow
def test_the_command_measures_once(tmp_path, monkeypatch, scene_of, capsys):
    made = []

    def make(domain, seed, **_):
        made.append((domain, seed))
        return scene_of(2, num_views=2, num_points=1500, height=60, width=80)

    monkeypatch.setattr(masks, "make_domain_scene", make)
    chosen = {"domains": ("table",), "scenes": 1, "noise_seeds": 1, "out": tmp_path}
    benchmark("masks", **chosen, methods=("sai3d", "vote"))
    assert made == [("table", 100)]
    file = tmp_path / "runs" / "table-100-0-perfect.json"
    found = json.loads(file.read_text())
    assert set(found) == {"sai3d", "vote"}
    assert found["vote"]["2D"][1:] == [1.0, 1.0]  # perfect masks
    file.write_text(json.dumps(found | {"vote": record(0.123, 0.4)}))
    benchmark("masks", **chosen, methods=("sai3d", "vote", "sam3d", "mask_clustering", "ours"))
    assert made == [("table", 100)] * 2
    assert "0.500 / 0.123 / 0.400" in (tmp_path / "table.md").read_text()
    assert "MaskClustering" in capsys.readouterr().out
    assert set(json.loads(file.read_text())) == set(masks.TITLES)


def test_bad_arguments_are_named(tmp_path):
    with pytest.raises(ValueError, match=r"--methods: expected some of ours, .*, got 'theirs'"):
        benchmark("masks", out=tmp_path, methods=("theirs",))
    with pytest.raises(ValueError, match=r"--domains: expected some of room, table, shelf, got 'attic'"):
        benchmark("masks", out=tmp_path, domains=("attic",))
    with pytest.raises(ValueError, match=r"--noise-seeds: expected at least 1, got 0"):
        benchmark("masks", out=tmp_path, noise_seeds=0)
    with pytest.raises(ValueError, match=r"--tuning: suite masks has none"):
        benchmark("masks", out=tmp_path, tuning=(1, 1))
    (tmp_path / "table.md").write_text("mine")
    with pytest.raises(FileExistsError, match=r"table.md: exists already; choose another name with -o, or --overwrite"):
        benchmark("masks", out=tmp_path)


def test_what_comes_to_the_folder_meanwhile_stays(tmp_path, monkeypatch, scene_of):
    def make(*_, **__):
        (tmp_path / "table.md").write_text("mine")
        return scene_of(2, num_views=2, num_points=1500, height=60, width=80)

    monkeypatch.setattr(masks, "make_domain_scene", make)
    chosen = {"domains": ("table",), "scenes": 1, "noise_seeds": 1, "out": tmp_path, "methods": ("vote",)}
    with pytest.raises(FileExistsError, match=r"table.md: was made or changed while this run worked"):
        benchmark("masks", **chosen)
    assert (tmp_path / "table.md").read_text() == "mine"
    benchmark("masks", **chosen)  # of an earlier start now
    assert (tmp_path / "table.md").read_text() != "mine"
