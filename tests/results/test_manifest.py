"""A result that was changed, or is mixed from several, is an error; that of version 0.1.0 is read for good."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from PIL import Image

import torchjoint as tj
from torchjoint.results.edits import read_edits
from torchjoint.results.folder import write_result
from torchjoint.results.manifest import listed_files

OLD = Path(__file__).parents[1] / "samples" / "result-0.1.0"
CONFIG = tj.Config().set(["point_segments.method=learned", "boundary.detector=gradient"])


@pytest.fixture(scope="module")
def outs(scene_of, tmp_path_factory):
    """Two levels of one result."""
    scene = scene_of(3).scene
    result = tj.JointSegmenter(CONFIG)(scene)
    folders = []
    for level in (0.5, 0.9):
        folders.append(tmp_path_factory.mktemp("level") / "out")
        folders[-1].mkdir()
        write_result(folders[-1], scene, result.at(level), CONFIG, "test", level)
    return folders


@pytest.fixture
def out(outs, tmp_path):
    return shutil.copytree(outs[0], tmp_path / "out")


@pytest.fixture
def old(tmp_path):
    return shutil.copytree(OLD, tmp_path / "old")


def read_all(folder, **options):
    """Reads whatever a result has."""
    result = tj.load_result(folder, **options)
    sizes = [image.shape for image in result.images] + [frame.size for frame in result.scene.frames]
    return result, sizes, [result.at(1.0).images[index].max() for index in range(len(result.images))]


def change_points(folder, **arrays):
    with np.load(folder / "points.npz") as stored:
        values = dict(stored)
    np.savez(folder / "points.npz", **(values | arrays))


def labels(change):
    def damage(folder):
        with np.load(folder / "points.npz") as stored:
            change_points(folder, labels=change(stored["labels"].copy()))

    return damage


def put(place, value):
    def change(array):
        array[place] = value
        return array

    return change


def zeros(folder):
    with np.load(folder / "hierarchy.npz") as stored:
        np.savez(folder / "hierarchy.npz", **({name: array * 0 for name, array in stored.items()} | {
            "merges": stored["merges"][:0], "heights": stored["heights"][:0]}))  # fmt: skip


def small_input(folder):
    Image.new("RGB", (10, 10)).save(sorted((folder / "inputs").iterdir())[0])


def swap(part):
    def damage(folder):
        one, two = sorted((folder / part).iterdir())[:2]
        first = one.read_bytes()
        one.write_bytes(two.read_bytes())
        two.write_bytes(first)

    return damage


def edit_run(key, value):
    def damage(folder):
        record = yaml.safe_load((folder / "run.yaml").read_text())
        record[key] = value
        (folder / "run.yaml").write_text(yaml.safe_dump(record, sort_keys=False))

    return damage


NOTICED_WITHOUT = {
    "no images": lambda folder: shutil.rmtree(folder / "images"),
    "an image less": lambda folder: sorted((folder / "images").iterdir())[0].unlink(),
    "labels of 3e9": labels(put(5, 3_000_000_000)),
    "labels of 2^62": labels(put(5, 2**62)),
    "negative labels": labels(put(5, -5)),
    "labels of another dtype": labels(lambda array: array.astype(np.float32)),
    "fewer labels": labels(lambda array: array[:-1]),
    "labels as a column": labels(lambda array: array[:, None]),
    "points of NaN": lambda folder: change_points(folder, points=np.full((400, 3), np.nan)),
    "colours of another length": lambda folder: change_points(folder, colors=np.zeros((5, 3), np.float32)),
    "a label image of another size": lambda folder: Image.fromarray(np.zeros((10, 10), np.uint16)).save(
        sorted((folder / "images").iterdir())[0]
    ),
    "a hierarchy of zeros": zeros,
    "a small input": small_input,
    "counts": edit_run("counts", {"points": 400, "frames": 2, "point_segments": 3}),
    "counts that are no counts": edit_run("counts", {"points": float("inf"), "frames": "x", "point_segments": None}),
    "no counts": edit_run("counts", None),
}  # fmt: skip
NOTICED_WITH = NOTICED_WITHOUT | {
    "swapped images": swap("images"),
    "swapped superpoints": swap("pieces"),
    "swapped inputs": swap("inputs"),
    "another label": labels(lambda array: put(0, array.max())(array)),
    "one image more": lambda folder: shutil.copy(next((folder / "images").iterdir()), folder / "images" / "z.png"),
    "no superpoints": lambda folder: shutil.rmtree(folder / "pieces"),
    "no cameras": lambda folder: (folder / "cameras.json").unlink(),
    "no hierarchy": lambda folder: (folder / "hierarchy.npz").unlink(),
    "a record that was cut": lambda folder: (folder / "run.yaml").write_text(
        (folder / "run.yaml").read_text().replace("manifest: manifest.json\n", "")
    ),
    "no manifest": lambda folder: (folder / "manifest.json").unlink(),
    "another granularity": edit_run("granularity", 0.1),
    "another config": edit_run("config", {}),
    "a manifest that is a list": lambda folder: (folder / "manifest.json").write_text("[]"),
    "a manifest of other types": lambda folder: (folder / "manifest.json").write_text(
        json.dumps({"run": json.loads((folder / "manifest.json").read_text())["run"], "files": [["points.npz", 1]]})
    ),
}


@pytest.mark.parametrize("damage", NOTICED_WITH.values(), ids=NOTICED_WITH)
def test_what_was_changed_is_noticed(out, damage):
    damage(out)
    with pytest.raises((ValueError, TypeError, FileNotFoundError), match=str(out)):
        read_all(out)


@pytest.mark.parametrize("damage", NOTICED_WITHOUT.values(), ids=NOTICED_WITHOUT)
def test_what_is_noticed_without_a_manifest(old, damage):
    damage(old)
    with pytest.raises((ValueError, TypeError, FileNotFoundError), match=rf"{old}|superpoints of image 0"):
        read_all(old)


@pytest.mark.parametrize("part", ["points.npz", "images", "pieces", "run.yaml", "cameras.json", "hierarchy.npz"])
def test_parts_of_two_levels(out, outs, part):
    of_other = outs[1] / part
    if of_other.is_dir():
        shutil.rmtree(out / part)
        shutil.copytree(of_other, out / part)
    else:
        shutil.copy(of_other, out / part)
    if part in ("pieces", "cameras.json", "hierarchy.npz"):  # they are the same in all levels
        read_all(out)
        return
    with pytest.raises(ValueError, match=r"expected the (file|record)"):
        read_all(out)


def test_a_result_that_was_replaced_says_so(out, outs, monkeypatch):
    """It counted as damaged; corrections of its superpoints went into the folder of the other one."""
    result, told = tj.load_result(out), "expected the result that was opened, got another"

    def replaced(*_):
        shutil.rmtree(out)
        shutil.copytree(outs[1], out)

    replaced()
    with pytest.raises(ValueError, match=told):
        result.images[0]
    with pytest.raises(ValueError, match=told):
        read_edits(out, result.hierarchy.num_superpoints, result.manifest)
    shutil.rmtree(out)
    shutil.copytree(outs[0], out)
    monkeypatch.setattr("torchjoint.results.folder.read_embeddings", replaced)
    with pytest.raises(ValueError, match=told):
        tj.load_result(out)


def test_the_way_out(out):
    swap("images")(out)
    result, *_ = read_all(out, verify=False)
    assert len(result.images) == 6


def test_corrections_and_other_files_are_free(out):
    (out / "edits.json").write_text((OLD / "edits.json").read_text().replace("[0]", "[0]"))
    count = tj.load_result(out, edits=False).hierarchy.num_superpoints
    text = (out / "edits.json").read_text()
    (out / "edits.json").write_text(text.replace(text.split('"pieces": ')[1].split(",")[0], str(count), 1))
    (out / "notes.txt").write_text("mine")
    (out / "overview.png").unlink()
    assert list(read_all(out)[0].segment_names.values()) == ["floor"]


@pytest.mark.parametrize("version", ["new", "old"])
def test_files_that_macos_adds_are_none_of_a_result(version, request):
    folder = request.getfixturevalue("out" if version == "new" else "old")
    count = len(tj.load_result(folder).images)
    for file in sorted(folder.rglob("*")):
        file.with_name(f"._{file.name}").write_bytes(b"\0\5\x16\7\0\2\0\0Mac OS X")
    sizes = read_all(folder)[1] if version == "new" else list(tj.load_result(folder).images)
    assert len(tj.load_result(folder).images) == count <= len(sizes)


def test_a_result_of_version_0_1_0():
    result, sizes, _ = read_all(OLD)
    assert not (OLD / "manifest.json").exists()
    assert sizes == [(24, 32)] * 4
    assert result.names == ("frame-000000", "frame-000001")
    assert list(result.segment_names.values()) == ["floor"]
    assert (len(result.points), result.num_point_segments) == (400, 2)
    assert result.hierarchy is not None
    assert result.at(1.0).num_point_segments > 2
    assert result.config == CONFIG
    assert torch.equal(result.at(0.5).points, tj.load_result(OLD, edits=False).points)
    assert len(result.crops(0)) > 0


@pytest.mark.parametrize("name", ["points.ply", "images_color/*.jpg"])
def test_what_nothing_reads_may_be_missing_but_not_changed(out, name):
    listed_files(out)
    (file := next(out.glob(name))).write_text("by hand")
    with pytest.raises(ValueError, match=f"{file.name}: is not as the run wrote it"):
        listed_files(out)
    file.unlink()
    listed_files(out)
    tj.load_result(out)
