"""A dead link, a pipe or a device in the place of a file of a result, a state, masks, boxes or parameters."""

from __future__ import annotations

import io
import warnings
import zlib

import numpy as np
import pytest
import samples
import torch
import traps
from PIL import Image

import torchjoint as tj
from torchjoint.results.boxes import read_boxes
from torchjoint.results.checkpoint import Checkpoint
from torchjoint.runtime.files import write_checked
from torchjoint.runtime.store import Packed, pack, read_values, write_values
from torchjoint.views.evidence import Evidence

CANNOT = "cannot be read"


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """The result of a small recording, with corrections."""
    folder = tmp_path_factory.mktemp("traps")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _segment(samples.write("folder", folder / "scene"), folder / "out")
    return folder / "out"


def _segment(path, out):
    from torchjoint.results.folder import write_result

    scene, config = tj.load_scene(path), tj.Config()
    out.mkdir()
    write_result(out, scene, tj.JointSegmenter(config)(scene), config, str(path))


def everything(out):
    found = tj.load_result(out)
    return [*found.images, *(frame.image for frame in found.scene.frames), *found.superpoint_images]


@pytest.mark.parametrize("trap", traps.TRAPS)
def test_files_of_a_result(trap, result):
    (result / "edits.json").write_text('{"pieces": 0, "granularity": null, "edits": []}')
    for name in ("points.npz", "hierarchy.npz", "run.yaml", "manifest.json", "cameras.json", "edits.json"):
        with traps.trapped(result / name, trap), traps.ends(), pytest.raises(ValueError, match=CANNOT):
            everything(result)
    (result / "edits.json").unlink()
    for folder in ("images", "pieces", "inputs"):
        file = next((result / folder).iterdir())
        with traps.trapped(file, trap), traps.ends(), pytest.raises(ValueError, match=CANNOT):
            everything(result)
    assert everything(result)


@pytest.mark.parametrize("trap", traps.TRAPS)
def test_other_files(trap, tmp_path):
    (tmp_path / "masks").mkdir()
    Image.fromarray(np.full((4, 4), 255, np.uint8)).save(tmp_path / "masks" / "0.png")
    (tmp_path / "masks.json").write_text('[{"segmentation": {"size": [2, 3], "counts": [1, 2, 3]}}]')
    (tmp_path / "boxes.json").write_text('{"objects": []}')
    (tmp_path / "boxes.txt").write_text("")
    (tmp_path / "config.yaml").write_text("{}")
    (tmp_path / "cloud.npy").write_bytes(b"")
    write_values(tmp_path / "state", {})
    readers = {
        "masks/0.png": lambda path: tj.masks.read_masks(path.parent),
        "masks.json": tj.masks.read_masks,
        "boxes.json": read_boxes,
        "boxes.txt": read_boxes,
        "config.yaml": lambda path: tj.Config.from_preset(str(path)),
        "state": tj.LiveSegmenter().restore,
        "cloud.npy": tj.load_scene,
    }
    for name, read in readers.items():
        with traps.trapped(tmp_path / name, trap), traps.ends(), pytest.raises(ValueError, match=CANNOT):
            read(tmp_path / name)


@pytest.mark.parametrize("trap", traps.TRAPS)
def test_a_checkpoint(trap, tmp_path):
    checkpoint = Checkpoint(tmp_path / "state", "key")
    checkpoint.save(Evidence.zeros(3, 4), now=True)
    with (
        traps.trapped(tmp_path / "state" / "sums.pt", trap),
        traps.ends(),
        pytest.warns(UserWarning, match=f"damaged, starting again .*{CANNOT}"),
    ):
        assert checkpoint.load() is None
    assert checkpoint.load() is not None


class TestStates:
    def test_a_tensor_that_repeats_its_bytes(self, tmp_path):
        write_values(tmp_path / "a", {"values": torch.zeros(1).expand(10**12)})
        with pytest.raises(ValueError, match=r"not a saved state: expected at most \d+ bytes of tensors"):
            read_values(tmp_path / "a")

    @pytest.mark.parametrize("same", [torch.zeros(2), 1])
    def test_lists_that_hold_the_same_lists(self, tmp_path, same):
        for _ in range(40):
            same = [same, same]
        write_values(tmp_path / "a", {"a": same})
        with traps.ends(), pytest.raises(ValueError, match=r"not a saved state: expected at most \d+ values"):
            read_values(tmp_path / "a")

    def test_a_pickle_that_calls_for_more_than_tensors(self, tmp_path):
        content = io.BytesIO()
        torch.save({"a": bytearray(b"1")}, content)
        write_checked(tmp_path / "a", content.getvalue())
        with pytest.raises(ValueError, match=r"expected tensors, numbers and texts, got \w+ bytearray"):
            read_values(tmp_path / "a")

    def test_an_older_format_with_an_archive_behind_it(self, tmp_path):
        old, new = io.BytesIO(), io.BytesIO()
        torch.save({"a": 1}, old, _use_new_zipfile_serialization=False)
        torch.save({"a": 1}, new)
        write_checked(tmp_path / "a", old.getvalue() + new.getvalue())
        with pytest.raises(ValueError, match=r"not a saved state: expected an archive"):
            read_values(tmp_path / "a")

    def test_what_is_no_archive(self, tmp_path):
        write_checked(tmp_path / "a", b"\x80\x02]q\x00.")
        with pytest.raises(ValueError, match="not a saved state: expected an archive"):
            read_values(tmp_path / "a")

    def test_endless_zlib(self):
        values = pack(torch.zeros(9, dtype=torch.uint8)).to_dict()
        bomb = zlib.compress(bytes(10**7))
        values["content"] = torch.frombuffer(bytearray(bomb), dtype=torch.uint8)
        with pytest.raises(ValueError, match=r"packed uint8 of shape \[9\]: expected a zlib stream of 9 bytes"):
            Packed.from_dict(values).unpack()

    @pytest.mark.parametrize(
        "change", [{"shape": (10**6, 10**6)}, {"shape": (-9,)}, {"dtype": "object"}, {"stored": "O"}, {"low": 2**70}]
    )
    def test_a_packed_tensor_of_another_kind(self, change):
        values = pack(torch.zeros(9, dtype=torch.int64)).to_dict() | change
        with pytest.raises(ValueError, match=r"expected (a packed tensor|at most \d+ bytes when)"):
            Packed.from_dict(values)

    @pytest.mark.parametrize(
        ("part", "message"),
        [
            (
                {"ids": {"cube": torch.tensor([1]), "id": torch.tensor([-3]), "last": torch.tensor([0]), "next": 1}},
                "ids: expected 0 to 0, got -3",
            ),
            (
                {"ids": {"cube": torch.tensor([1]), "id": torch.tensor([0, 0]), "last": torch.tensor([0]), "next": 1}},
                "ids: expected ascending",
            ),
            (
                {"ids": {"cube": torch.tensor([1]), "id": torch.tensor([0]), "last": torch.tensor([4]), "next": 1}},
                "last ids: expected -1 to 0, got 4",
            ),
            ({"pose": torch.zeros(4, 4)}, "pose: expected a rigid transform"),
            ({"origin": torch.zeros(7, dtype=torch.float64)}, "origin: expected shape"),
            ({"volume": {"key": torch.tensor([2, 1]), "sums": torch.zeros(2, 1)}}, "volume: expected ascending blocks"),
            ({"volume": 3}, "not a state of live segmentation"),
            ({"keyframes": [{"name": "a"}]}, "not a state of live segmentation"),
            ({"settings": None}, "expected a state with"),
        ],
    )
    def test_a_tampered_live_state(self, part, message, tmp_path):
        segmenter = tj.LiveSegmenter()
        segmenter.save(tmp_path / "state")
        write_values(tmp_path / "state", read_values(tmp_path / "state") | part)
        segmenter._in_memory = 7
        with pytest.raises(ValueError, match=message) as caught:
            segmenter.restore(tmp_path / "state")
        assert str(tmp_path / "state") in str(caught.value)
        assert segmenter._in_memory == 7  # as it was

    def test_settings_that_cannot_be_compared(self, tmp_path):
        segmenter = tj.LiveSegmenter()
        segmenter.save(tmp_path / "state")
        values = read_values(tmp_path / "state")
        values["settings"]["turn"] = torch.zeros(3)
        write_values(tmp_path / "state", values)
        with pytest.raises(ValueError, match="not a state of live segmentation"):
            segmenter.restore(tmp_path / "state")

    @pytest.mark.parametrize(
        ("name", "change"),
        [("labels", {"shape": (3, 3)}), ("image", {"shape": (3, 10**4, 10**4)}), ("labels", {"low": -9})],
    )
    def test_a_tampered_keyframe(self, name, change, tmp_path):
        segmenter = tj.LiveSegmenter(step=0)
        scene = tj.load_scene(samples.write("folder", tmp_path / "scene"))
        segmenter.update(scene.frames[0])
        segmenter.save(tmp_path / "state")
        values = read_values(tmp_path / "state")
        assert values["keyframes"]
        values["keyframes"][0][name] |= change
        write_values(tmp_path / "state", values)
        with pytest.raises(ValueError, match="not a state of live segmentation"):
            tj.LiveSegmenter(step=0).restore(tmp_path / "state")


def test_names_with_escapes_and_formulas(tmp_path, capsys):
    from torchjoint_lab.evaluation.levels import write_levels
    from torchjoint_lab.evaluation.scores import Scores
    from torchjoint_lab.evaluation.table import Row, write_csv

    from torchjoint.runtime.messages import in_one_line, say

    scores = Scores(*[0.5] * len(Scores._fields))
    write_csv(tmp_path / "a.csv", [Row("=1+1", "@x", "3D", scores, {"-2+3": 0.5})])
    write_levels(tmp_path / "b.csv", {"=1+1": [scores] * 21})
    cells = [
        cell for file in ("a.csv", "b.csv") for cell in (tmp_path / file).read_text().replace("\n", ",").split(",")
    ]
    assert "'=1+1" in cells
    assert not [cell for cell in cells if cell.startswith(("=", "+", "-", "@"))]
    say("a\x1b[2J\u202eb\x07")
    assert capsys.readouterr().out == "a\\x1b[2J\\u202eb\\x07\n"
    assert "\x1b" not in in_one_line(ValueError("a\x1b]0;x\x07"))
    assert in_one_line(PermissionError(13, "Permission denied", "a b.ply")) == "a b.ply: Permission denied"


def test_integers_beyond_64_bits():
    edges = torch.tensor([[0], [1]])
    with pytest.raises(ValueError, match="min_size: expected an integer of at most 64 bits"):
        tj.ops.felzenszwalb(edges, torch.ones(1), 2, 1.0, min_size=2**63)
    record = {"id": 2**63, "segmentation": [[0, 0, 2, 0, 2, 2]]}
    with pytest.raises(ValueError, match="ids: expected integers of 64 bits"):
        tj.masks.from_coco([record], (2, 2))
    with pytest.raises(ValueError, match=r"segments_info\[0\]: expected an id of 64 bits"):
        tj.masks.from_panoptic(torch.zeros(2, 2, dtype=torch.int64), [{"id": 2**63}])
