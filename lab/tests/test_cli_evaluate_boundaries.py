"""torchjoint-lab evaluate-boundaries: a detector or a folder of predictions in, scores, a curve and a picture out."""

import csv

import numpy as np
import pytest
from bsds_files import borders, write_bsds
from PIL import Image

HALVES = (np.arange(60) >= 30).repeat(40).reshape(60, 40).T.astype(int) + 1
EDGE = borders(HALVES)


@pytest.fixture
def bsds(tmp_path):
    return write_bsds(tmp_path / "bsds", {"a": [HALVES], "b": [HALVES, HALVES], "c": [HALVES.copy()]})


@pytest.fixture
def predictions(tmp_path):
    folder = tmp_path / "predictions"
    folder.mkdir()
    Image.fromarray((EDGE * 200).astype(np.uint8)).save(folder / "a.png")
    Image.fromarray((EDGE * 50000).astype(np.uint16)).save(folder / "b.png")
    np.save(folder / "c.npy", EDGE * 0.5)
    return folder


def test_a_detector(bsds, tmp_path, run_lab, capsys):
    out = tmp_path / "scores"
    run_lab("evaluate-boundaries", "gradient", bsds, "-o", out, "--thresholds", 9)
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].split() == ["boundaries", "ODS", "at", "precision", "recall", "OIS", "AP"]
    assert printed[1].split()[0] == "1.000"
    assert [line.split()[0] for line in printed[2:5]] == ["regions", "with", "without"]
    assert {file.name for file in out.iterdir()} == {"boundaries.csv", "precision_recall.png"}
    assert min(np.array(Image.open(out / "precision_recall.png")).shape[:2]) > 400
    rows = list(csv.DictReader((out / "boundaries.csv").read_text().splitlines()))
    assert [float(row["threshold"]) for row in rows] == pytest.approx([k / 10 for k in range(1, 10)])
    assert max(float(row["f"]) for row in rows) == 1


def test_a_folder_of_predictions(bsds, predictions, tmp_path, run_lab, capsys):
    run_lab(
        "evaluate-boundaries",
        predictions,
        bsds,
        "-o",
        tmp_path / "scores",
        "--thresholds",
        9,
        "--no-regions",
        "--no-nms",
    )
    assert "regions" not in capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "scores" / "boundaries.csv").read_text().splitlines()))
    # 200 / 255, 50000 / 65535 and 0.5: the last is gone above 0.5, all above 0.8; b's line counts for two annotators.
    assert [float(row["recall"]) for row in rows] == pytest.approx([1] * 5 + [0.75] * 2 + [0] * 2)
    assert [float(row["precision"]) for row in rows] == [1] * 7 + [0] * 2


def test_nothing_is_overwritten(bsds, tmp_path, run_lab):
    out = tmp_path / "scores"
    out.mkdir()
    (out / "boundaries.csv").write_text("precious")
    with pytest.raises(SystemExit, match=r"boundaries\.csv: exists already; choose another name with -o"):
        run_lab("evaluate-boundaries", "gradient", bsds, "-o", out)
    run_lab("evaluate-boundaries", "gradient", bsds, "-o", out, "--overwrite", "--thresholds", 1, "--no-regions")
    assert (out / "boundaries.csv").read_text() != "precious"


def break_size(file):
    np.save(file, np.zeros((60, 40)))


def break_range(file):
    np.save(file, EDGE * 2.0)


def break_nan(file):
    np.save(file, np.where(EDGE, np.nan, 0))


def break_dtype(file):
    np.save(file, EDGE)


def truncate(file):
    file.write_bytes(file.read_bytes()[:150])


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda file: file.unlink(), r"c\.png: missing \(and so is c\.npy\); expected a boundary map"),
        (break_size, r"c\.npy: expected the image's size, \[40, 60\] \(rows, columns\), got \[60, 40\]"),
        (break_range, r"c\.npy: expected numbers in \[0, 1\], got 2 and 39 others"),
        (break_nan, r"c\.npy: expected numbers in \[0, 1\], got nan and 39 others"),
        (break_dtype, r"c\.npy: expected floating numbers of shape \[H, W\], got bool \[40, 60\]"),
        (truncate, r"c\.npy: not a whole \.npy file"),
        (lambda file: file.with_suffix(".png").touch(), r"holds both c\.png and c\.npy; remove one"),
    ],
)
def test_wrong_predictions(bsds, predictions, tmp_path, run_lab, damage, message):
    damage(predictions / "c.npy")
    with pytest.raises(SystemExit, match="torchjoint-lab: error: .*" + message):
        run_lab("evaluate-boundaries", predictions, bsds, "-o", tmp_path / "scores", "--thresholds", 1)
    assert not (tmp_path / "scores").exists()


def test_wrong_arguments(bsds, predictions, tmp_path, monkeypatch, run_lab):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        SystemExit, match=r"nothing: neither a folder of predictions, nor a forest, nor a detector: .*gradient"
    ):
        run_lab("evaluate-boundaries", "nothing", bsds)
    with pytest.raises(SystemExit, match=r"nothing\.yml\.gz: missing; expected a structured forest"):
        run_lab("evaluate-boundaries", "nothing.yml.gz", bsds)
    with pytest.raises(SystemExit, match="--multi-scale: only for structured forests, got gradient"):
        run_lab("evaluate-boundaries", "gradient", bsds, "--multi-scale")
    with pytest.raises(SystemExit, match="no such folder; expected the BSDS500 data set"):
        run_lab("evaluate-boundaries", "gradient", tmp_path / "nowhere")
    with pytest.raises(SystemExit, match="thresholds: expected a whole number >= 1, got 0"):
        run_lab("evaluate-boundaries", "gradient", bsds, "--thresholds", 0)
    with pytest.raises(SystemExit, match="test: missing; expected the folder of the split 'test'"):
        run_lab("evaluate-boundaries", "gradient", bsds, "--split", "test")
    Image.new("RGB", (60, 40)).save(predictions / "a.png")
    with pytest.raises(SystemExit, match=r"a\.png: expected a grey image of 8 or 16 bits, got mode RGB"):
        run_lab("evaluate-boundaries", predictions, bsds)
    assert not (tmp_path / "boundary-scores").exists()
