"""torchjoint show: what it opens, with which scene, and what it says if it cannot."""

import os
import re
import shutil
import stat
import sys
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote, urlsplit

import laspy
import numpy as np
import pytest
import torch
from folder_files import write_folder, write_truth

import torchjoint as tj
from torchjoint.cli.show import _open_page
from torchjoint.datasets.files.text_clouds import with_column
from torchjoint.results.embeddings import Embeddings
from torchjoint.results.exports import FORMATS
from torchjoint.results.labelled_file import label_file, write_labelled
from torchjoint.viewer.shared_page import write_page
from torchjoint.viewer.truth import read_labelled_cloud, with_truth


def test_the_truth_is_in_the_order_of_the_result(scene_of, tmp_path):
    synthetic = scene_of(3, num_points=6000)
    recording = write_folder(tmp_path / "recording", synthetic)
    write_truth(recording, synthetic)
    scene = tj.load_scene(recording)
    keep = torch.arange(0, 6000, 3).flip(0)
    some = scene.select_points(keep).select_frames([4, 1])
    images = [torch.zeros(120, 160, dtype=torch.int64)] * 2
    names = tuple(frame.name for frame in some.frames)
    labels = torch.zeros(2000, dtype=torch.int64)
    result = tj.Result.of(tj.Segmentation(labels, images, names=names), some)
    truth = with_truth(result, scene).scene.truth
    assert torch.equal(truth.points, synthetic.point_labels[keep])
    assert torch.equal(truth.images[0], synthetic.image_labels[4])
    with pytest.raises(ValueError, match="expected the points of the result; recording lacks 1999 of them"):
        with_truth(result, replace(scene, points=scene.points + 0.01))
    with pytest.raises(ValueError, match="has no frame 'frame-0000"):
        with_truth(result, scene.select_frames([1]))
    with pytest.raises(ValueError, match="expected a scene with ground truth"):
        with_truth(result, replace(scene, truth=None))


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
def test_superpoints_can_be_shown(run, scene_of, tmp_path, suffix):
    cloud = scene_of(3, num_points=6000).scene
    np.savez(tmp_path / "cloud.npz", points=cloud.points.numpy(), colors=cloud.colors.numpy())
    out = tmp_path / f"out{suffix}"
    run("superpoints", tmp_path / "cloud.npz", "-o", out, "--no-picture")
    assert torch.equal(read_labelled_cloud(out).points, tj.superpoints(cloud.points, cloud.colors))
    run("show", out, "--static", tmp_path / "page.html")
    with pytest.raises(ValueError, match=r"cloud\.npz: expected .* got no labels"):
        read_labelled_cloud(tmp_path / "cloud.npz")


def test_a_labelled_survey_can_be_shown(run, tmp_path):
    survey = laspy.LasData(laspy.LasHeader(point_format=2, version="1.2"))
    survey.add_extra_dim(laspy.ExtraBytesParams("Amplitude", np.float32))  # of which `show` needs not tell
    survey.x, survey.y, survey.z = np.random.default_rng(0).uniform(0, 1, (3, 500))
    survey.write(tmp_path / "a.las")
    with pytest.raises(ValueError, match=r"a\.las: expected .* got no labels"):
        read_labelled_cloud(tmp_path / "a.las")
    run("superpoints", tmp_path / "a.las", "-o", tmp_path / "b.laz", "--no-picture")
    found = np.asarray(laspy.read(tmp_path / "b.laz")["superpoint"])
    assert read_labelled_cloud(tmp_path / "b.laz").points.tolist() == found.tolist()
    write_labelled(tmp_path / "a.las", tmp_path / "c.las", {"label": np.arange(500)})
    run("superpoints", tmp_path / "c.las", "-o", tmp_path / "d.las", "--no-picture")
    assert read_labelled_cloud(tmp_path / "d.las").points.tolist() == found.tolist()
    run("show", tmp_path / "b.laz", "--static", tmp_path / "page.html")


def test_labels_of_another_name_can_be_shown(run, tmp_path):
    """What `label --name` writes, and text, were files without labels."""
    labels, name = np.arange(50, dtype=np.int32) // 9, "mine"
    survey = laspy.LasData(laspy.LasHeader(point_format=2, version="1.2"))
    survey.x, survey.y, survey.z = np.random.default_rng(0).uniform(0, 1, (3, 50))
    survey.write(tmp_path / "a.las")
    write_labelled(tmp_path / "a.las", tmp_path / "b.laz", {name: labels, f"{name}_confidence": np.float32(labels)})
    assert read_labelled_cloud(tmp_path / "b.laz").points.tolist() == labels.tolist()
    rows = [f"{x:.3f};{y:.3f};{z:.3f};0.5" for x, y, z in survey.xyz.tolist()]
    (tmp_path / "a.csv").write_text("x;y;z;intensity\n" + "\n".join(rows))
    with pytest.raises(ValueError, match=r"a\.csv: expected .* text with .*, got no labels"):
        read_labelled_cloud(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_bytes(with_column(tmp_path / "a.csv", "label", labels.tolist()))
    assert read_labelled_cloud(tmp_path / "b.csv").points.tolist() == labels.tolist()
    run("show", tmp_path / "b.csv", "--static", tmp_path / "page.html")
    (tmp_path / "b.csv").write_text((tmp_path / "b.csv").read_text().replace(";5\n", ";4.5\n"))
    with pytest.raises(TypeError, match=r"b\.csv: labels: expected an integer dtype, got torch\.float64"):
        read_labelled_cloud(tmp_path / "b.csv")


def test_a_folder_of_segments_can_be_shown(out, run, tmp_path):
    result = tj.load_result(out)
    result = replace(result, segment_names={1: "a / chair"})
    FORMATS["ply"](tmp_path / "parts", result)
    shown, order = read_labelled_cloud(tmp_path / "parts"), result.points.argsort(stable=True)
    assert torch.equal(shown.points, result.points[order])
    assert torch.equal(shown.scene.points, result.scene.points[order])
    assert torch.allclose(shown.scene.colors, result.scene.colors[order], atol=1 / 255)
    assert shown.segment_names == {1: "a _ chair"}
    run("show", tmp_path / "parts", "--static", tmp_path / "page.html")
    (tmp_path / "parts" / "mine.ply").write_bytes((tmp_path / "parts" / "000000.ply").read_bytes())
    with pytest.raises(SystemExit, match=r"run\.yaml: missing; expected a folder that `torchjoint segment` wrote"):
        run("show", tmp_path / "parts", "--static", tmp_path / "page2.html")


def test_a_mesh_of_segments_can_be_shown(run, tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="meshes need trimesh: pip install 'torchjoint[mesh]'")
    box = trimesh.creation.box((1, 1, 1)).subdivide().subdivide()
    points = torch.from_numpy(np.array(box.vertices)).float()
    scene = tj.Scene(points)
    labels = (points[:, 0] > 0.1).long()
    result = replace(tj.Result.of(tj.Segmentation(labels, ()), scene), segment_names={1: "lid"})
    box.export(tmp_path / "box.ply")
    label_file(tmp_path / "box.ply", tmp_path / "a.glb", result)
    with pytest.MonkeyPatch.context() as patch:  # files of others are read in one way only
        patch.setattr(trimesh.resolvers, "FilePathResolver", lambda *_: pytest.fail("reads files around it"))
        shown = read_labelled_cloud(tmp_path / "a.glb")
    assert shown.segment_names == {1: "lid"}
    nearest = torch.cdist(shown.scene.points, points).argmin(1)
    inside = (shown.scene.points[:, 0] - 0.1).abs() > 0.3  # a vertex between two segments is in both
    assert inside.sum() > 50
    assert torch.equal(shown.points[inside], labels[nearest][inside])
    run("show", tmp_path / "a.glb", "--static", tmp_path / "page.html")
    # It lay on its side, and heights and relations were those along z.
    for up in ([0.0, 1, 0], [0.0, 0, 1]):
        standing = replace(result, scene=replace(scene, up=torch.tensor(up)))
        label_file(tmp_path / "box.ply", tmp_path / "b.glb", standing)
        assert read_labelled_cloud(tmp_path / "b.glb").scene.up.tolist() == up
    label_file(tmp_path / "box.ply", tmp_path / "c.glb", replace(result, points=labels - 1))
    assert read_labelled_cloud(tmp_path / "c.glb").points.unique().tolist() == [0, 1]  # what has no label is the last
    box.export(tmp_path / "other.glb")
    with pytest.raises(ValueError, match=r"other\.glb: expected .* got no labels"):
        read_labelled_cloud(tmp_path / "other.glb")


def test_no_segment_of_a_folder_is_left_out(out, tmp_path):
    """One in capitals was; of two with one id, both became one, with the name of the later."""
    parts = tmp_path / "parts"
    FORMATS["ply"](parts, replace(tj.load_result(out), segment_names={}))
    (parts / "000001.ply").rename(parts / "000001-CHAIR.PLY")
    shown = read_labelled_cloud(parts)
    assert len(shown.points) == len(tj.load_result(out).points)
    assert shown.segment_names == {1: "CHAIR"}
    shutil.copy(parts / "000000.ply", parts / "000001-sofa.ply")
    with pytest.raises(ValueError, match=f"{parts}: segment 1 is there twice"):
        read_labelled_cloud(parts)


def test_the_ids_of_a_file_are_shown(tmp_path):
    """They were numbered anew: after corrections, or with points without a label, 5 was shown as 2."""
    labels = np.repeat([5, -1, 2], 20)
    np.savez(tmp_path / "a.npz", points=np.random.default_rng(0).random((60, 3)), labels=labels)
    file = (tmp_path / "a.npz").rename(tmp_path / "A.NPZ")
    assert read_labelled_cloud(file).points.tolist() == np.where(labels < 0, 6, labels).tolist()


@pytest.mark.parametrize(
    ("labels", "told"),
    [
        (np.arange(40) + 0.5, "an integer dtype, got torch.float64"),
        (np.full(40, np.nan, np.float32), "an integer dtype, got torch.float32"),
        (np.arange(40).astype(str), "numbers, got an array of <U"),
        (np.arange(40)[:, None], r"shape \[40\], got \[40, 1\]"),
        (np.full(40, 1 << 63, np.uint64), r"integers below 2\^63"),
    ],
)
def test_labels_of_a_file_are_whole_numbers(tmp_path, labels, told):
    """Others were cut to integers in silence."""
    path = tmp_path / "a.npz"
    np.savez(path, points=np.random.default_rng(0).random((40, 3)), labels=labels)
    with pytest.raises((TypeError, ValueError), match=rf"a\.npz: labels: expected {told}"):
        read_labelled_cloud(path)


def test_a_large_cloud_says_how_many_points_are_shown(tmp_path):
    points = torch.rand(250_000, 3)
    result = tj.Result.of(tj.Segmentation(torch.zeros(250_000, dtype=torch.int64), ()), tj.Scene(points))
    assert write_page(tmp_path / "page.html", result) == 83_334
    assert "83334 of 250000 points" in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--granularity", 2], "--granularity: expected a number from 0"),
        (["--up", 0, 0, 0], "--up: expected a direction, got zeros"),
        (["--truth"], r"--truth: expected the recording of this result, .*test"),
    ],
)
def test_errors(run, out, tmp_path, arguments, message):
    with pytest.raises(SystemExit, match=message):
        run("show", out, "--static", tmp_path / "page.html", *arguments)
    assert not (tmp_path / "page.html").exists()


def test_what_is_not_there_is_told(run, tmp_path):
    with pytest.raises(SystemExit, match=r"nothing does not exist; expected a result"):
        run("show", tmp_path / "nothing")


def test_without_viser_it_says_what_to_install(run, out, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(SystemExit, match=r"the viewer needs viser: pip install 'torchjoint\[viewer\]'"):
        run("show", out)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")  # of viser and websockets
def test_a_page_for_the_network_says_so(run, out, monkeypatch, capsys):
    from torchjoint.viewer.app import Viewer

    monkeypatch.setattr("torchjoint.cli.show.serve_until_interrupted", lambda viewer: viewer.stop())
    monkeypatch.setattr(Viewer, "_work_behind", lambda viewer: None)
    run("show", out, "--no-open-browser", "--port", 8990)
    assert "--host" not in capsys.readouterr().out
    run("show", out, "--no-open-browser", "--port", 8990, "--host", "0.0.0.0")
    text = capsys.readouterr().out
    assert "--host 0.0.0.0: whoever has the address below in this network sees this result, and may change" in text
    assert re.search(r"http://localhost:899\d/\S{32}/\n", text)
    assert "Websocket" not in text  # viser's own addresses, which are refused


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")  # of viser and websockets
def test_an_encoder_of_text_is_imported(run, out, tmp_path, monkeypatch):
    from torchjoint.viewer.app import Viewer

    folder, found = tmp_path / "out", []
    shutil.copytree(out, folder)
    with pytest.raises(SystemExit, match="--text-encoder: expected a result with embeddings"):
        run("show", folder, "--text-encoder", "words:encode")
    labels = tj.load_result(folder).points
    Embeddings(torch.eye(int(labels.max()) + 1), labels).save(folder)
    with pytest.raises(SystemExit, match="--text-encoder: words:encode cannot be imported: No module named 'words'"):
        run("show", folder, "--text-encoder", "words:encode")
    (tmp_path / "words.py").write_text("def encode(words):\n    return len(words)\n")
    monkeypatch.syspath_prepend(tmp_path)
    served = "torchjoint.cli.show.serve_until_interrupted"
    monkeypatch.setattr(served, lambda viewer: (found.append(viewer._shown.text_encoder), viewer.stop()))
    monkeypatch.setattr(Viewer, "_work_behind", lambda viewer: None)
    run("show", folder, "--no-open-browser", "--port", 8995, "--text-encoder", "words:encode")
    assert found[0]("a mug") == 5


def test_up_turns_the_page(run, out, tmp_path):
    texts = []
    for name, up in (("a", ()), ("b", ("--up", 0, 0, -1))):
        run("show", out, "--static", tmp_path / f"{name}.html", *up)
        texts.append((tmp_path / f"{name}.html").read_text(encoding="utf-8"))
    assert texts[0] != texts[1]


def test_a_page_of_a_result_whose_name_is_no_text(run, out, tmp_path):
    shutil.copytree(out, other := tmp_path / os.fsdecode(b"other-\xff"))
    run("show", other, "--static", tmp_path / "page.html")
    assert "other-\\udcff: " in (tmp_path / "page.html").read_text()


def test_corrections_are_in_the_static_page(run, out, tmp_path):
    from torchjoint.results.edits import Edit, Edits, write_edits
    from torchjoint.results.parts import Parts

    folder = tmp_path / "out"
    shutil.copytree(out, folder)
    result = tj.load_result(folder)
    parts = Parts(result)
    other = int(np.nonzero(parts.stored == 1)[0][0])
    write_edits(folder, Edits(parts.count, None, (Edit("join", (0, other)),)))
    run("show", folder, "--static", tmp_path / "page.html")
    assert f"{result.num_point_segments - 1} segments" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_the_token_is_not_in_the_list_of_processes(monkeypatch, capsys):
    """The browser is called with a page that only this user can read, and that leads to the address."""
    called = []
    monkeypatch.setattr("webbrowser.open", called.append)
    url = "http://127.0.0.1:8080/secret-token/"
    _open_page(url, True)
    _open_page(url, in_browser=False)
    (page,) = called
    assert "secret-token" not in page
    file = Path(unquote(urlsplit(page).path))
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert f"url={url}" in file.read_text(encoding="utf-8")
    assert capsys.readouterr().out.count(url) == 2
    file.unlink()
