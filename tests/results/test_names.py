"""Frames may have any name: no file leaves the result, and what is shown is the true name."""

import io
import json
import os
import zipfile
from dataclasses import replace
from pathlib import PureWindowsPath

import numpy as np
import pytest

import torchjoint as tj
from torchjoint.results.edits import Edits, write_edits
from torchjoint.results.exports import FORMATS
from torchjoint.results.folder import write_result
from torchjoint.results.output_folder import output_folder
from torchjoint.runtime.files import LONGEST, file_name
from torchjoint.viewer.html import image_html, panel_html
from torchjoint.viewer.model import Model, export_selected
from torchjoint.viewer.shared_page import write_page

CONFIG = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])
NAMES = (
    "../../../victim/PWN", "{root}/victim/PWN", "a/b", "..", ".", "nul\0.", "half \ud800", "n" * 300, "ü" * 200,
    "$\\frac$", "plain name", ".hidden",
    "a\x1b[2Jb\tc\u202e", "Plain Name", "plain NAME",
)  # fmt: skip


@pytest.fixture(scope="module")
def run(scene_of):
    """A scene and its result; each frame again and again, so that there is one for each name."""
    scene = scene_of(1).scene
    result = tj.JointSegmenter(CONFIG)(scene)
    count = len(NAMES)
    scene = replace(scene, frames=(scene.frames[0],) * count, truth=None)
    return scene, replace(
        result, images=[result.images[0]] * count, initial_images=[result.initial_images[0]] * count,
        superpoint_images=[result.superpoint_images[0]] * count, names=(scene.frames[0].name,) * count,
    )  # fmt: skip


@pytest.fixture
def place(tmp_path):
    """Four folders deep, beside it the victim; at the end nothing is new outside `out`, `selection` and the exports."""
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "PWN.png").write_text("precious")
    deep = tmp_path / "one" / "two" / "three" / "four"
    deep.mkdir(parents=True)
    yield deep
    outside = {path for path in tmp_path.rglob("*") if path.is_file() and not path.is_relative_to(deep)}
    assert outside == {victim / "PWN.png"}
    assert (victim / "PWN.png").read_text() == "precious"


@pytest.mark.filterwarnings("ignore:.*no EPSG code")
def test_any_name_is_written_read_and_exported(run, place, tmp_path):
    names = tuple(name.replace("{root}", str(tmp_path)) for name in NAMES)
    scene, result = run[0], replace(run[1], names=names)
    out = place / "out"
    out.mkdir()
    write_result(out, scene, result, CONFIG, "test")
    for part in ("images", "inputs", "images_color", "pieces"):  # also on a disk that does not know cases
        assert len({file.name.casefold() for file in (out / part).iterdir()}) == len(names)
    read = tj.load_result(out)
    assert sorted(read.names) == sorted(names)
    for index, name in enumerate(read.names):
        assert read.scene.frames[index].name == name
        assert (read.images[index] == result.images[0]).all()
    assert read.at(1.0).images[0].max() >= 0  # reads the superpoints
    read.embed(lambda crops: crops.mean((2, 3)), size=8).save(out)  # an export needs vectors
    read = tj.load_result(out)
    for form, export in FORMATS.items():
        export(place / f"{form}.{form}", read)
    arrays = np.load(place / "npz.npz")
    assert sorted(map(str, arrays["names"])) == sorted(name.rstrip("\0") for name in names)
    assert len([key for key in arrays if key.startswith("image:")]) == len(names)
    coco = json.loads((place / "coco.coco").read_text())
    assert {one["file_name"] for one in coco["images"]} == {file.name for file in (out / "inputs").iterdir()}
    model = Model(read, Edits(read.hierarchy.num_superpoints), np.array([0.0, 0.0, 1.0]))
    model.select((int(model.table[read.hierarchy.superpoint[read.points.argmin()]]),))
    for kind in ("PLY", "PNG", "COCO"):
        assert os.path.basename(export_selected(model, kind)[0]) == export_selected(model, kind)[0]
    masks = zipfile.ZipFile(io.BytesIO(export_selected(model, "PNG")[1])).namelist()
    assert {*masks} <= {file.name for file in (out / "images").iterdir()}
    assert masks
    write_page(place / "page.html", read)
    for name in names:
        image_html(np.zeros((2, 2, 3), np.uint8), name).encode()
    panel_html([model.row(model.selected[0])], [(name, 1) for name in names]).encode()


def test_a_recording_cannot_name_a_file_outside(run, place, tmp_path):
    """A sample of nuScenes, whose cameras have such names."""
    from PIL import Image

    recording = tmp_path / "one" / "two" / "three" / "four" / "recording"
    recording.mkdir()
    rng = np.random.default_rng(0)
    rng.uniform(-1, 1, (500, 3)).astype(np.float32).tofile(recording / "scan.bin")
    Image.fromarray(rng.integers(0, 255, (24, 32, 3), dtype=np.uint8)).save(recording / "image.png")
    camera = {"img_path": "image.png", "cam2img": [[20, 0, 16], [0, 20, 12], [0, 0, 1]]}
    pose = np.eye(4)
    pose[2, 3] = 3
    cameras = {"../../../../victim/PWN": camera | {"lidar2cam": pose.tolist()}}
    record = {"lidar": {"lidar_path": "scan.bin", "num_pts_feats": 3}, "cameras": cameras}
    (recording / "sample.json").write_text(json.dumps(record))
    from torchjoint.recordings import RecordingOptions, segment_recording

    segment_recording(recording, place / "out", CONFIG, RecordingOptions())
    assert tj.load_result(place / "out").names == ("../../../../victim/PWN",)
    assert len(list((place / "out" / "images").glob("*.png"))) == 1


@pytest.mark.parametrize("name", ["x", "..x", "a b", "%2F", "é" * 100, "n" * LONGEST])
def test_a_name_that_can_be_a_file_stays(name):
    assert file_name(name) == name
    assert file_name(name, is_free=False) != name


@pytest.mark.parametrize("name", ["..\\..\\x", "C:x", "C:\\x"])
def test_a_name_that_leads_out_of_a_folder_of_windows(name):
    assert PureWindowsPath("out", file_name(name)).parent == PureWindowsPath("out")


def test_different_names_have_different_files():
    names = ["a/b", "a_b", "a\0b", "a//b", "\ud800", "\ud801", "", ".", "..", "._x", "n" * 300, "n" * 301]
    files = [file_name(name) for name in names]
    assert len(set(files)) == len(names)
    assert not any(file.startswith("._") for file in files)  # macOS has them beside a file, and they are not read
    assert all(os.path.basename(file) == file and len(os.fsencode(file)) <= LONGEST for file in files)


def test_nothing_is_written_through_a_link(run, place, tmp_path):
    victim = tmp_path / "victim"
    out = place / "out"
    out.mkdir()
    (out / "edits.json").symlink_to(victim / "PWN.png")
    write_edits(out, Edits(3))
    assert not (out / "edits.json").is_symlink()
    for name, target in (("one.partial", victim), (".one.lock", victim / "created")):
        (place / name).symlink_to(target)
        with pytest.raises(FileExistsError, match="got a link"), output_folder(place / "one", "source"):
            pass
        (place / name).unlink()
    (place / "one.partial").mkdir()  # of an earlier run
    (place / "one.partial" / "source.txt").write_text("source")
    (place / "one.partial" / "state").symlink_to(victim)
    with pytest.raises(FileExistsError, match=r"state: .* got a link"), output_folder(place / "one", "source"):
        pass


def test_an_unknown_kind_of_export(run):
    model = Model(tj.Result.of(run[1], run[0]), Edits(run[1].hierarchy.num_superpoints), np.array([0.0, 0.0, 1.0]))
    model.select((0,))
    with pytest.raises(ValueError, match="export: expected PLY, PNG or COCO, got 'EXE'"):
        export_selected(model, "EXE")
