"""BSDS500: a tiny data set of the same form, what is wrong with others, and the real one where it is there."""

import re

import numpy as np
import pytest
import torch
from bsds_files import write_bsds
from scipy.io import savemat
from torchjoint_lab.datasets.bsds import bsds_images

HALVES = np.repeat([[1, 2]], 4, 0).repeat(3, 1)


@pytest.fixture
def folder(tmp_path):
    thirds = np.repeat([[1, 2, 3]], 4, 0).repeat(2, 1)
    return write_bsds(tmp_path / "bsds", {"b": [HALVES, thirds], "a": [np.zeros((5, 3), int)]})


def test_what_is_read(folder):
    a, b = bsds_images(folder, "val")
    assert (a.name, b.name) == ("a", "b")
    assert b.image.shape == (3, 4, 6)
    assert b.image.dtype == torch.float32
    assert 0.3 < float(b.image.min()) < float(b.image.max()) <= 1
    assert [one.tolist()[0] for one in b.segmentations] == [[0, 0, 0, 1, 1, 1], [0, 0, 1, 1, 2, 2]]
    assert [one.tolist()[3] for one in b.boundaries] == [[0, 0, 1, 0, 0, 0], [0, 1, 0, 1, 0, 0]]
    assert {one.dtype for one in b.boundaries} == {torch.bool}
    assert torch.equal(a.segmentations[0], torch.full((5, 3), -1))


@pytest.mark.parametrize("inside", ["data", "BSDS500/data", "BSR/BSDS500/data"])
def test_the_original_layout(tmp_path, inside):
    write_bsds(tmp_path / inside, {"a": [HALVES]})
    assert [record.name for record in bsds_images(str(tmp_path), "val")] == ["a"]


def test_missing_folders_and_files(folder, tmp_path):
    with pytest.raises(ValueError, match="split: expected train, val, test, got 'Val'"):
        bsds_images(folder, "Val")
    with pytest.raises(FileNotFoundError, match=re.escape(f"{tmp_path / 'no'}: no such folder")):
        bsds_images(tmp_path / "no", "val")
    with pytest.raises(FileNotFoundError, match=re.escape(f"{tmp_path}: expected images/ and groundTruth/")):
        bsds_images(tmp_path, "val")
    with pytest.raises(FileNotFoundError, match=re.escape(f"{folder / 'images' / 'test'}: missing")):
        bsds_images(folder, "test")
    (folder / "groundTruth" / "val" / "b.mat").unlink()
    with pytest.raises(FileNotFoundError, match=r"b\.mat: missing; expected the ground truth of .*b\.jpg"):
        bsds_images(folder, "val")
    for file in (folder / "images" / "val").iterdir():
        file.unlink()
    with pytest.raises(FileNotFoundError, match=r"val: expected images NAME\.jpg, found none"):
        bsds_images(folder, "val")


@pytest.mark.parametrize("keep", [0, 60, 130, -20])
def test_a_truncated_truth(folder, keep):
    record = bsds_images(folder, "val")[0]
    record.truth_file.write_bytes(record.truth_file.read_bytes()[:keep])
    with pytest.raises(ValueError, match=r"a\.mat: not a whole \.mat file|a\.mat: expected groundTruth"):
        _ = record.boundaries


@pytest.mark.parametrize(
    "content",
    [
        {"other": np.ones((3, 3))},
        {"groundTruth": np.ones((3, 3))},
        {"groundTruth": "text"},
        {"groundTruth": np.array([[{"Segmentation": np.ones((3, 3), np.uint16)}]], dtype=object)},
        {"groundTruth": np.array([[{"Boundaries": np.ones((3, 3))}]], dtype=object)},
        {"groundTruth": np.empty((1, 0), dtype=object)},
    ],
)
def test_a_foreign_truth(folder, content):
    record = bsds_images(folder, "val")[0]
    savemat(record.truth_file, content)
    with pytest.raises(ValueError, match=r"a\.mat: expected groundTruth\{1, k\}\.Boundaries, an integer map"):
        _ = record.boundaries


def test_a_broken_image(folder):
    record = bsds_images(folder, "val")[0]
    record.image_file.write_bytes(record.image_file.read_bytes()[:200])
    with pytest.raises(ValueError, match=r"a\.jpg: not a whole image"):
        _ = record.image


def test_the_real_data_set(shared):
    for split, count in (("train", 200), ("val", 100)):
        records = bsds_images(shared / "data" / "bsds500", split)
        assert len(records) == count
        record = records[0]
        size = record.image.shape[1:]
        assert sorted(size) == [321, 481]
        assert 4 <= len(record.boundaries) == len(record.segmentations) <= 9
        for boundary, segmentation in zip(record.boundaries, record.segmentations, strict=True):
            assert boundary.shape == segmentation.shape == size
            assert 0.001 < boundary.float().mean() < 0.1
            assert int(segmentation.min()) == 0
