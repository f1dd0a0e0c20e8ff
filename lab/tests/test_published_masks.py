"""Each layout of published masks, written as the program of its method writes it, gives the same masks."""

import zipfile

import numpy as np
import pytest
import torch
from PIL import Image
from torchjoint_lab.datasets.published_masks import masks_of

from torchjoint.masks import read_masks

FRAMES = ("0", "20")
LABELS = np.array([[-1, -1, 0, 0], [1, 1, 0, 0], [1, 1, 0, 2]])  # -1: none


def mask_clustering(folder):
    masks = folder / "scan" / "output" / "mask"
    masks.mkdir(parents=True)
    for frame in FRAMES:
        Image.fromarray((LABELS + 1).astype(np.uint8)).save(masks / f"{frame}.png")


def sai3d(folder):
    masks = folder / "scan" / "semantic-sam"
    masks.mkdir(parents=True)
    for frame in FRAMES:
        Image.fromarray((LABELS + 1).astype(np.uint8)).save(masks / f"maskraw_{frame:0>5}.png")
        Image.fromarray(np.full((3, 4, 3), 77, dtype=np.uint8)).save(masks / f"maskcolor_{frame:0>5}.png")


def sam3d(folder):
    (folder / "scan").mkdir(parents=True)
    for frame in FRAMES:
        Image.fromarray(LABELS.astype(np.int16).view(np.uint16)).save(folder / "scan" / f"{frame}.png")


def open3dis(folder, **other):
    folder.mkdir()
    # as pycocotools.mask.encode writes the masks
    masks = [{"size": [3, 4], "counts": counts} for counts in ("651", "12105", ";1")]
    frame = {"masks": masks, "img_feat": torch.ones(3, 768).half(), "conf": torch.tensor([0.75, 0.5, 0.5])}
    torch.save({f"{name:0>5}": frame | other for name in FRAMES}, folder / "scan.pth")


@pytest.mark.parametrize("write", [mask_clustering, sai3d, sam3d, open3dis])
def test_each_layout_gives_the_masks(write, tmp_path):
    write(tmp_path / "masks")
    with masks_of(tmp_path / "masks", "scan", FRAMES) as folder:
        assert sorted(path.stem for path in folder.iterdir()) == sorted(FRAMES)
        for path in folder.iterdir():
            stack = read_masks(path).stack().numpy()
            assert (stack == [label == LABELS for label in range(3)]).all()


def test_scores_of_open3dis_are_kept(tmp_path):
    open3dis(tmp_path / "masks")
    with masks_of(tmp_path / "masks", "scan", FRAMES) as folder:
        assert read_masks(folder / "20.npz").scores.tolist() == [0.75, 0.5, 0.5]


@pytest.mark.parametrize(
    "other",
    [
        {"conf": torch.ones(2)},
        {"masks": None},
        {"masks": [{"size": [3, 4]}]},
        {"masks": torch.zeros(1).expand(10**12), "conf": torch.zeros(1).expand(10**12)},
        {"conf": torch.ones(1).expand(3, 10**12)},
    ],
)
def test_damaged_pth_is_an_error_with_its_name(other, tmp_path):
    open3dis(tmp_path / "masks", **other)
    with (
        pytest.raises(ValueError, match=r"scan\.pth: not masks of Open3DIS"),
        masks_of(tmp_path / "masks", "scan", FRAMES),
    ):
        pass


@pytest.mark.parametrize("name", ["..", "", "1" * 5000, "a\0b", "x" * 300])
def test_a_pth_has_names_of_frames(name, tmp_path):
    masks = [{"size": [3, 4], "counts": "651"}]
    torch.save({name: {"masks": masks, "conf": torch.ones(1)}}, tmp_path / "scan.pth")
    with pytest.raises(ValueError, match=r"scan\.pth: not masks of Open3DIS"), masks_of(tmp_path, "scan", FRAMES):
        pass


def test_a_frame_without_masks_and_hidden_files_are_left_out(tmp_path):
    frame = {"masks": [{"size": [3, 4], "counts": "651"}], "conf": torch.ones(1)}
    torch.save({"0": {"masks": [], "conf": torch.ones(0)}, "20": frame}, tmp_path / "scan.pth")
    with masks_of(tmp_path, "scan", FRAMES) as folder:
        assert [path.name for path in folder.iterdir()] == ["20.npz"]
    sam3d(tmp_path / "other")
    (tmp_path / "other" / "scan" / "._20.png").write_text("of macOS")
    with masks_of(tmp_path / "other", "scan", FRAMES) as folder:
        assert sorted(path.stem for path in folder.iterdir()) == ["0", "20"]


def test_two_sets_of_a_frame_are_an_error(tmp_path):
    sam3d(tmp_path)
    (tmp_path / "scan" / "00020.png").write_bytes((tmp_path / "scan" / "20.png").read_bytes())
    with pytest.raises(ValueError, match="got two for 20"), masks_of(tmp_path, "scan", FRAMES):
        pass


def test_a_compressed_pth_is_refused(tmp_path):
    open3dis(tmp_path / "masks")
    file = tmp_path / "masks" / "scan.pth"
    with zipfile.ZipFile(file) as archive:
        entries = {entry: archive.read(entry) for entry in archive.namelist()}
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, content in entries.items():
            archive.writestr(entry, content)
    with pytest.raises(ValueError, match="torch packs nothing"), masks_of(tmp_path / "masks", "scan", FRAMES):
        pass


def test_a_pth_that_was_cut_off_is_an_error(tmp_path):
    open3dis(tmp_path / "masks")
    whole = (tmp_path / "masks" / "scan.pth").read_bytes()
    for end in range(0, len(whole), 97):
        (tmp_path / "masks" / "scan.pth").write_bytes(whole[:end])
        with pytest.raises(ValueError, match=r"scan\.pth"), masks_of(tmp_path / "masks", "scan", FRAMES):
            pass


def test_no_code_of_a_pth_runs(tmp_path):
    class Code:
        def __reduce__(self):
            return (tmp_path / "ran").write_text, ("x",)

    open3dis(tmp_path / "masks", masks=Code())
    with pytest.raises(ValueError, match="not masks of Open3DIS"), masks_of(tmp_path / "masks", "scan", FRAMES):
        pass
    assert not (tmp_path / "ran").exists()


def test_a_pth_makes_tensors_and_texts_only(tmp_path):
    """torch itself would make a gigabyte of the few bytes of this bytearray."""
    open3dis(tmp_path / "masks", conf=bytearray(4))
    with (
        pytest.raises(ValueError, match="expected tensors, numbers and texts"),
        masks_of(tmp_path / "masks", "scan", FRAMES),
    ):
        pass


def test_no_masks_and_two_sets_are_errors(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"scan: missing; expected masks"), masks_of(tmp_path, "scan", FRAMES):
        pass
    sai3d(tmp_path / "masks")
    (tmp_path / "masks" / "scan" / "semantic-sam").rename(tmp_path / "masks" / "scan" / "sam-hq")
    (tmp_path / "masks" / "scan" / "semantic-sam").mkdir()
    (tmp_path / "masks" / "scan" / "semantic-sam" / "maskraw_00000.png").touch()
    with pytest.raises(ValueError, match="one set of masks"), masks_of(tmp_path / "masks", "scan", FRAMES):
        pass
    mask_clustering(tmp_path / "other")
    open3dis(tmp_path / "pth")
    (tmp_path / "pth" / "scan.pth").rename(tmp_path / "other" / "scan.pth")
    with pytest.raises(ValueError, match="one set of masks"), masks_of(tmp_path / "other", "scan", FRAMES):
        pass
