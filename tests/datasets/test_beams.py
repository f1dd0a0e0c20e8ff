"""Beams without return, which drivers write as (0, 0, 0), are no points: they are told, left out, and have label -1."""

import numpy as np
import pytest
import torch

import torchjoint as tj
from torchjoint.datasets.files.clouds import read_cloud_file, read_scan
from torchjoint.results.labelled_file import nearest_labels

POINTS = np.random.default_rng(0).uniform(1, 3, (300, 3)).astype(np.float32)
SCAN = np.zeros((400, 3), np.float32)
RETURNED = np.arange(400) % 4 < 3
SCAN[RETURNED] = POINTS
TOLD = r"100 of 400 points are \(0, 0, 0\), beams without return; they are left out"


@pytest.mark.parametrize("suffix", [".npy", ".bin", ".xyz"])
def test_files(tmp_path, suffix):
    path = tmp_path / f"scan{suffix}"
    if suffix == ".bin":
        np.c_[SCAN, SCAN[:, :1]].astype("<f4").tofile(path)
    else:
        np.save(path, SCAN) if suffix == ".npy" else np.savetxt(path, SCAN, "%.9g")
    with pytest.warns(UserWarning, match=rf"scan\.\w+: {TOLD}"):
        assert np.array_equal(read_cloud_file(path).points.float(), POINTS)
    assert len(read_cloud_file(path, invalid="keep").points) == 400


def test_scans_of_an_e57(tmp_path):
    """Each scan has its own place of the sensor."""
    pye57 = pytest.importorskip("pye57")
    data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), SCAN.astype(float).T.copy(), strict=True))
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        for height in (0.0, 5.0):
            file.write_scan_raw(data, translation=np.array([0.0, 0.0, height]))
    with pytest.warns(UserWarning, match=rf"a\.e57: scan [01]: {TOLD}"):
        points = read_cloud_file(tmp_path / "a.e57").points
    np.testing.assert_allclose(points, np.r_[POINTS, POINTS + np.float32([0, 0, 5])], atol=1e-5)


def test_a_scan_of_kitti_has_no_point_at_its_sensor(tmp_path):
    np.c_[SCAN[:5], SCAN[:5, :1]].astype("<f4").tofile(tmp_path / "000000.bin")
    with pytest.warns(UserWarning, match=r"1 of 5 points are \(0, 0, 0\)"):
        assert len(read_scan(tmp_path / "000000.bin", 4)) == 4


def test_superpoints_and_labels():
    with pytest.warns(UserWarning, match=f"points: {TOLD}"):
        labels = tj.superpoints(torch.from_numpy(SCAN), min_size=5)
    assert (labels[~RETURNED] == -1).all()
    assert torch.equal(labels[RETURNED], tj.superpoints(torch.from_numpy(POINTS), min_size=5))
    result = tj.Result.of(tj.Segmentation(labels[RETURNED], ()), tj.Scene(torch.from_numpy(POINTS)))
    assert torch.equal(nearest_labels(result, torch.from_numpy(SCAN)), labels)


def test_a_few_points_at_the_origin_are_points(tmp_path):
    points = torch.from_numpy(np.r_[POINTS, np.zeros((9, 3), np.float32)])
    assert int(tj.superpoints(points, min_size=1).min()) == 0
    np.save(tmp_path / "a.npy", points.numpy())
    assert len(read_cloud_file(tmp_path / "a.npy").points) == 309
