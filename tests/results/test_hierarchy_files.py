"""Levels on disk: whatever is read gives the levels that were written; equal bytes; files that are damaged."""

import numpy as np
import pytest
import torch
from PIL import Image

import torchjoint as tj
from torchjoint.results.folder import read_result, write_result
from torchjoint.results.manifest import read_hierarchy, read_superpoint_image, write_hierarchy
from torchjoint.scene import Hierarchy

LEARNED = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])
LEVELS = (0.0, 0.3, 0.5, 0.7, 1.0)


@pytest.fixture(scope="module")
def scene(scene_of):
    return scene_of(3).scene


@pytest.fixture(scope="module")
def result(scene):
    return tj.JointSegmenter(LEARNED)(scene)


def written(folder, scene, result, granularity=0.5):
    folder.mkdir()
    write_result(folder, scene, result.at(granularity), LEARNED, "test", granularity)
    return folder


@pytest.mark.parametrize("granularity", [0.2, *(pytest.param(level, marks=pytest.mark.slow) for level in (0.5, 0.9))])
def test_levels_are_read_back(tmp_path, scene, result, granularity):
    read = read_result(written(tmp_path / "out", scene, result, granularity))
    assert torch.equal(read.points, result.at(granularity).points)
    assert read.names == result.names
    assert read.hierarchy.default == result.hierarchy.default == 0.6
    for level in LEVELS:
        got, expected = read.at(level), result.at(level)
        assert torch.equal(got.points, expected.points)
        assert all(torch.equal(a, b) for a, b in zip(got.images, expected.images, strict=True))
        assert torch.equal(got.confidence, expected.confidence)
        assert torch.equal(got.point_confidence, expected.point_confidence)


@pytest.mark.slow
def test_equal_results_are_equal_bytes(tmp_path, scene, result):
    first, second = (written(tmp_path / name, scene, result) for name in ("a", "b"))
    files = ["hierarchy.npz", *(f"pieces/{name}.png" for name in result.names)]
    assert sorted(f"pieces/{path.name}" for path in (first / "pieces").iterdir()) == sorted(files[1:])
    for file in files:
        assert (first / file).read_bytes() == (second / file).read_bytes()


def test_a_result_without_levels(tmp_path, scene):
    result = tj.JointSegmenter(tj.Config.from_preset("paper").set(["boundary.detector=gradient"]))(scene)
    (tmp_path / "out").mkdir()
    write_result(tmp_path / "out", scene, result, tj.Config(), "test")
    read = read_result(tmp_path / "out")
    assert torch.equal(read.points, result.points)
    assert all(torch.equal(a, b) for a, b in zip(read.images, result.images, strict=True))
    assert read.hierarchy is None
    assert not (tmp_path / "out" / "pieces").exists()
    with pytest.raises(FileNotFoundError, match=r"hierarchy\.npz: missing; expected a result with all levels"):
        read_hierarchy(tmp_path / "out", 3000)


def test_superpoints_of_more_than_16_bits(tmp_path):
    num_superpoints = 70_000
    chain = torch.arange(num_superpoints)
    heights = torch.full((num_superpoints - 1,), 0.5, dtype=torch.float64)
    hierarchy = Hierarchy(chain, torch.stack([chain[:-1], chain[1:]], dim=1), heights)
    image = torch.tensor([[-1, 0, 255], [256, 65_535, 69_999]])
    write_hierarchy(tmp_path, hierarchy, ["a"], [image])
    assert torch.equal(read_superpoint_image(tmp_path / "pieces" / "a.png", num_superpoints), image)
    read = read_hierarchy(tmp_path, num_superpoints)
    assert torch.equal(read.superpoint, chain)
    assert torch.equal(read.merges, hierarchy.merges)
    assert torch.equal(read.heights, heights)
    with pytest.raises(ValueError, match=r"a\.png: expected superpoints below 69999, got 69999; of another result"):
        read_superpoint_image(tmp_path / "pieces" / "a.png", 69_999)


class TestDamage:
    def test_of_other_points(self, tmp_path, scene, result):
        folder = written(tmp_path / "out", scene, result)
        with pytest.raises(ValueError, match=r"hierarchy\.npz: expected a hierarchy of 5 points, got 3000"):
            read_hierarchy(folder, 5)

    @pytest.mark.parametrize("content", [b"", b"PK\x03\x04 broken"])
    def test_no_archive(self, tmp_path, content):
        (tmp_path / "hierarchy.npz").write_bytes(content)
        with pytest.raises(ValueError, match=r"hierarchy\.npz: not a whole hierarchy"):
            read_hierarchy(tmp_path, 3)

    @pytest.mark.parametrize("name", ["piece", "merges", "heights", "default"])
    def test_an_array_is_missing_or_wrong(self, tmp_path, name):
        arrays = {"piece": np.arange(3), "merges": np.array([[0, 1]]), "heights": np.array([0.5]), "default": 0.5}
        np.savez(tmp_path / "hierarchy.npz", **arrays)
        assert read_hierarchy(tmp_path, 3).at().tolist() == [0, 0, 1]
        for wrong in (None, np.array([[7.5]]), np.array(["x"])):
            changed = {key: value for key, value in arrays.items() if key != name}
            np.savez(tmp_path / "hierarchy.npz", **changed | ({} if wrong is None else {name: wrong}))
            with pytest.raises(ValueError, match=r"hierarchy\.npz: not a whole hierarchy"):
                read_hierarchy(tmp_path, 3)

    @pytest.mark.parametrize("name", ["piece", "merges", "votes", "piece_size"])
    def test_floats_are_not_cut_to_integers(self, tmp_path, name):
        arrays = {"piece": np.arange(3), "merges": np.array([[0, 1]]), "heights": np.array([0.5]), "default": 0.5}
        arrays |= {"votes": np.zeros((1, 3), np.uint8), "piece_size": np.ones(3, np.uint64)}
        np.savez(tmp_path / "hierarchy.npz", **arrays)
        assert read_hierarchy(tmp_path, 3).votes.size.tolist() == [1, 1, 1]
        np.savez(tmp_path / "hierarchy.npz", **arrays | {name: arrays[name] + 0.4})
        with pytest.raises(ValueError, match=r"hierarchy\.npz: not a whole hierarchy.*float64"):
            read_hierarchy(tmp_path, 3)

    def test_a_superpoint_image_is_missing(self, tmp_path, scene, result):
        read = read_result(written(tmp_path / "out", scene, result))
        next((tmp_path / "out" / "pieces").iterdir()).unlink()
        with pytest.raises(FileNotFoundError, match="missing; expected an image"):
            list(read.at(0.9).images)
        list(read.at(0.1).images)  # coarser levels need no superpoints

    def test_a_grey_image_of_16_bits(self, tmp_path):
        Image.fromarray(np.zeros((2, 2), np.uint16)).save(tmp_path / "a.png")
        with pytest.raises(ValueError, match="expected an 8-bit image"):
            read_superpoint_image(tmp_path / "a.png", 3)
