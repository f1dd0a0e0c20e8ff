"""Recordings of Record3D: packed, unpacked and exported; what else they may hold."""

import json
import sys
import zipfile

import lzfse
import numpy as np
import pytest
import samples
import torch

import torchjoint as tj
from torchjoint.datasets.formats.record3d import decompress_lzfse, read_exr
from torchjoint.runtime import bounds


@pytest.fixture
def folder(tmp_path):
    """The unpacked zip."""
    with zipfile.ZipFile(samples.write("record3d", tmp_path / "packed")) as archive:
        archive.extractall(tmp_path / "scan")
    return tmp_path / "scan"


def change(path, **values):
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def test_the_unpacked_folder_is_the_same(folder, tmp_path):
    packed = tj.load_scene(tmp_path / "packed" / "2026-01-02--03-04-05.r3d")
    unpacked = tj.load_scene(folder)
    assert torch.equal(packed.points, unpacked.points)
    assert torch.equal(packed.frames[1].image, unpacked.frames[1].image)
    assert packed.name == "2026-01-02--03-04-05"


def test_unknown_and_unsure_depth_is_left_out(folder):
    depth, confidence = np.full((6, 8), 2, dtype=np.float32), np.full((6, 8), 1, dtype=np.uint8)
    depth[0], depth[1], confidence[2] = np.nan, -1, 0
    (folder / "rgbd" / "0.depth").write_bytes(lzfse.compress(depth.tobytes()))
    (folder / "rgbd" / "0.conf").write_bytes(lzfse.compress(confidence.tobytes()))
    measured = tj.load_scene(folder).frames[0].depth
    assert measured[:6].unique().tolist() == [0]
    assert measured[6:].unique().tolist() == [2]
    (folder / "rgbd" / "0.conf").unlink()
    assert tj.load_scene(folder).frames[0].depth[4:6].unique().tolist() == [2]


def test_each_frame_has_its_own_intrinsics(folder):
    change(folder / "metadata", perFrameIntrinsicCoeffs=[[14, 14, 7.5, 5.5], [28, 29, 7.5, 4.5]])
    frames = tj.load_scene(folder).frames
    assert [frame.intrinsics[0, 0].item() for frame in frames] == [14, 28]
    assert frames[1].intrinsics[1].tolist() == [0, 29, 4.5]


def test_an_exported_folder_may_be_given_itself(tmp_path):
    path = samples.write("record3d_exr", tmp_path / "a")
    assert tj.load_scene(path).name == "scan"
    assert len(tj.load_scene(path / "EXR_RGBD", cloud=path / "cloud.ply").frames) == 2


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"poses": [[0, 0, 0, 1, 0, 0, 0]]}, r"metadata: poses: .* got 1; last image: rgbd/1\.jpg"),
        ({"poses": []}, "got 0; last image"),
        ({"poses": [[0, 0, 0, 2, 0, 0, 0]] * 2}, "metadata: poses: expected unit quaternions"),
        ({"perFrameIntrinsicCoeffs": [[1, 1, 1, 1]] * 3}, "expected a row for each of 2 poses, got 3 rows"),
        ({"perFrameIntrinsicCoeffs": None, "K": [1]}, "metadata: K: expected 9 numbers"),
        ({"dw": 1e9}, "dw, dh: expected the size of depth images, got 1000000000 x 6"),
        ({"dw": 7}, r"0\.depth: damaged: expected 168 bytes of LZFSE data, got"),
    ],
)
def test_wrong_metadata(folder, values, message):
    change(folder / "metadata", **values)
    with pytest.raises(ValueError, match=message):
        tj.load_scene(folder)


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    for name, module in (("record3d", "lzfse"), ("record3d_exr", "OpenEXR")):
        path = samples.write(name, tmp_path / name)
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(ModuleNotFoundError, match=rf"needs {module}: pip install 'torchjoint\[record3d\]'"):
            _ = tj.load_scene(path).frames[0].image


class TestLzfse:
    def test_data_come_back(self):
        rng = np.random.default_rng(0)
        smooth = np.cumsum(rng.normal(size=49152)).astype(np.float16).astype("<f4").tobytes()
        for data in (smooth, rng.bytes(49152), b"ab", bytes(1 << 20)):
            assert decompress_lzfse(lzfse.compress(data), len(data)) == data
        assert lzfse.compress(smooth).startswith(b"bvx2")

    def test_a_bomb_is_not_unpacked(self, monkeypatch):
        monkeypatch.setattr(lzfse, "decompress", lambda data: pytest.fail("it was unpacked"))
        block = lzfse.compress(np.arange(4096, dtype="<f4").tobytes())[:-4]
        for bomb in (block * 8, b"bvxn\xff\xff\xff\xff" + bytes(99), bytes(1 << 18), b"", b"bvx$"):
            with pytest.raises(ValueError, match=r"damaged: expected 16384 bytes of LZFSE data, got \d+ packed bytes"):
                decompress_lzfse(bomb, 1 << 14)

    def test_another_size(self):
        with pytest.raises(ValueError, match=r"a\.depth: damaged: expected 9 bytes of LZFSE data, got 8"):
            decompress_lzfse(lzfse.compress(bytes(8)), 9, "a.depth")


def test_exr_images(tmp_path, monkeypatch):
    import OpenEXR

    pixels = np.arange(12, dtype=np.float16).reshape(3, 4)
    header = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"R": pixels, "G": pixels + 1, "B": pixels}).write(str(tmp_path / "a.exr"))
    assert read_exr(tmp_path / "a.exr", "G").tolist() == (pixels + 1).tolist()
    with pytest.raises(ValueError, match=r"a\.exr: not a whole EXR image: expected a channel Z, got B, G, R"):
        read_exr(tmp_path / "a.exr", "Z")
    monkeypatch.setattr(bounds, "PIXELS", 35)
    with pytest.raises(ValueError, match=r"expected at most 35 numbers in all channels, got 36"):
        read_exr(tmp_path / "a.exr", "G")
    with pytest.raises(FileNotFoundError, match=r"b\.exr: missing"):
        read_exr(tmp_path / "b.exr", "G")
