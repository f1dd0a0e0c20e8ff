"""torchjoint-lab train-forest: annotated images in, a forest out that the detector and the evaluation take."""

import csv

import numpy as np
import pytest
import torch
from bsds_files import write_bsds

from torchjoint.images.forest import StructuredForestBoundary

ROWS, COLUMNS = np.mgrid[:64, :96]
TRUTHS = {
    "a": [(COLUMNS > 40).astype(int)],
    "b": [(ROWS > 30).astype(int), (ROWS > 31).astype(int)],
    "c": [(np.hypot(ROWS - 30, COLUMNS - 50) < 20).astype(int)],
}


@pytest.fixture(scope="module")
def bsds(tmp_path_factory):
    return write_bsds(tmp_path_factory.mktemp("bsds"), TRUTHS, "train")


@pytest.mark.slow
def test_from_images_to_scores(bsds, tmp_path, run_lab, capsys):
    forest = tmp_path / "small.yml.gz"
    quick = ["--splits", "train", "--trees", 2, "--samples", 1000]
    run_lab("train-forest", bsds, "-o", forest, *quick)
    assert capsys.readouterr().out.startswith("2 trees of up to ")
    assert list(tmp_path.iterdir()) == [forest]
    left = torch.zeros(1, 3, 50, 70)
    left[..., 30:] = 0.6
    strength = StructuredForestBoundary(forest)(left)[0, 25]
    assert abs(int(strength.argmax()) - 29.5) < 2
    assert strength[:20].max() < strength.max() / 2
    run_lab("evaluate-boundaries", forest, bsds, "-o", tmp_path / "scores", "--split", "train", "--no-regions")
    rows = list(csv.DictReader((tmp_path / "scores" / "boundaries.csv").read_text().splitlines()))
    assert max(float(row["f"]) for row in rows) > 0.6
    before = forest.read_bytes()
    with pytest.raises(SystemExit, match=r"small\.yml\.gz: exists already; choose another name"):
        run_lab("train-forest", bsds, "-o", forest, *quick, "--seed", 1)
    assert forest.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere: no such folder; expected the BSDS500 data set"),
        (["BSDS"], "val: missing"),
        (["BSDS", "--splits", "training"], "--splits: expected some of train, val, test, got training"),
        (["BSDS", "--splits", "train", "-o", "no/a.yml.gz"], "-o: no is no folder"),
        (["BSDS", "--splits", "train", "-o", "a.npz"], r"expected a name that ends in \.yml\.gz, got a\.npz"),
        (["BSDS", "--splits", "train", "--trees", "0"], "trees: expected a whole number >= 1, got 0"),
        (["BSDS", "--splits", "train", "--workers", "0"], "workers: expected a whole number >= 1, got 0"),
        (["BSDS", "--splits", "train", "--min-child", "0"], "min_child: expected a whole number >= 1, got 0"),
        (["BSDS", "--splits", "train", "--samples", "10"], "samples: expected a whole number >= 1000, got 10"),
    ],
)
def test_errors_are_one_line(bsds, tmp_path, monkeypatch, arguments, message, run_lab):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match=message) as error:
        run_lab("train-forest", *(bsds if part == "BSDS" else part for part in arguments))
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())
