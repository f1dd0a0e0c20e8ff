"""torchjoint-lab train-boundary-model: labelled scenes in, a model out; an interrupted run goes on."""

from __future__ import annotations

from pathlib import Path

import pytest
from torchjoint_lab import training
from torchjoint_lab.cli import train_boundary_model as command
from torchjoint_lab.training import boundary_examples

from torchjoint.segments.learned.boundary_model import load_boundary_model


@pytest.fixture
def small_scenes(scene_of, monkeypatch):
    """Generated scenes are small rooms; returns the seeds of those that were made."""
    made = []

    def make(domain, seed, models):
        made.append(seed)
        return scene_of(seed)

    monkeypatch.setattr("torchjoint_lab.synthetic.make_domain_scene", make)
    return made


@pytest.mark.slow
def test_an_interrupted_run_goes_on(small_scenes, tmp_path, run_lab, capsys, monkeypatch):
    out = tmp_path / "model.npz"
    options = ["--domains", "room", "--seeds", 0, 1, 4, 5, "--varied", 0, 0.5, "--trees", 2, "--members", 2, "-o", out]
    arguments = ["train-boundary-model", *options]
    fit = training.fit_boundary_model
    monkeypatch.setattr(training, "fit_boundary_model", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run_lab(*arguments)
    assert small_scenes == [0, 4, 0, 4]  # as they are, and varied
    monkeypatch.setattr(training, "fit_boundary_model", fit)
    run_lab(*arguments)
    assert small_scenes == [0, 4, 0, 4]  # the evidence was on disk
    printed = capsys.readouterr().out
    assert "merging up to 0.15: " in printed
    assert "4 models of 4 rounds from 2 scenes in " in printed
    assert list(tmp_path.iterdir()) == [out]
    assert len(load_boundary_model(out).thresholds) == len(boundary_examples.BoundaryModelOptions().thresholds)
    with pytest.raises(SystemExit, match=r"model\.npz: exists already"):
        run_lab(*arguments)


def test_evidence_of_other_scenes_is_deleted(tmp_path):
    def folder(*keys):
        return command._folder(tmp_path / "a.npz", [command._Source(key, "", key, lambda: None) for key in keys], [0.5])

    (folder("a", "b") / "scene-0-00000.pt").touch()
    assert (folder("a", "b") / "scene-0-00000.pt").exists()
    assert not (folder("a", "c") / "scene-0-00000.pt").exists()
    (tmp_path / "a.npz.partial" / "source.txt").rename(tmp_path / "a.npz.partial" / "mine.txt")
    with pytest.raises(FileExistsError, match=r"a\.npz\.partial: expected the folder of an earlier run"):
        folder("a", "c")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "scenes: expected at least two, in SCENES or by --domains, got 0"),
        (["nowhere"], "scenes: nowhere does not exist"),
        (["--domains", "street"], "--domains: expected some of table, .*, got 'street'"),
        (["--domains", "table", "--seeds", "3", "3"], "--seeds: expected ascending pairs 0 <= first < end, got 3 3"),
        (["--domains", "table", "--seeds", "0", "2", "5"], "--seeds: expected ascending pairs"),
        (["--domains", "table", "--folds", "1"], "folds: expected a whole number >= 2, got 1"),
        (["--domains", "table", "--varied", "2"], "--varied: expected numbers from 0 to 1, got 2"),
        (["--domains", "table", "--thin", "0"], "--thin: expected more than 0 metres, got 0"),
        (["--domains", "table", "-o", "model.zip"], r"-o: expected a name that ends in \.npz, got model\.zip"),
        (["--domains", "table", "-o", "no/model.npz"], "-o: no is no folder"),
    ],
)
def test_errors_are_one_line(tmp_path, monkeypatch, arguments, message, run_lab):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match=message) as error:
        run_lab("train-boundary-model", *arguments)
    assert "\n" not in str(error.value)
    assert not list(Path().iterdir())
