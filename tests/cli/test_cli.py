"""The command line, end to end: files that open in other people's tools, nothing overwritten or half written."""

import errno
import json
import os
import re
import shutil
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest
import torch
import yaml
from folder_files import write_folder, write_truth
from PIL import Image

import torchjoint as tj
from torchjoint.cli.demo import RECORDING
from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.results.figures import overview
from torchjoint.results.folder import read_points
from torchjoint.results.output_folder import output_folder
from torchjoint.views.visibility import project

SMALL = ["--set", "image_segments.min_size=20"]


@pytest.fixture(scope="module")
def synthetic(scene_of):
    return scene_of(2)


@pytest.fixture(scope="module")
def recording(tmp_path_factory, synthetic):
    return write_folder(tmp_path_factory.mktemp("cli") / "recording", synthetic)


@pytest.fixture(scope="module")
def out(recording, run):
    folder = recording.parent / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchjoint.results.folder.overview", overview)
        run("segment", recording, "-o", folder, *SMALL, "refinement.color_weight=90")
    return folder


def test_what_segment_writes(out, recording, synthetic):
    files = {"points.ply", "points.npz", "images", "overview.png", "run.yaml", "hierarchy.npz", "pieces"}
    files |= {"segments.json", "cameras.json", "inputs", "images_color", "manifest.json"}
    assert {path.name for path in out.iterdir()} == files
    assert {path.name for path in recording.parent.iterdir()} == {"recording", "out"}
    config = tj.Config().set([*SMALL[1:], "refinement.color_weight=90"])
    expected = tj.JointSegmenter(config)(tj.load_scene(recording))

    result = read_points(out)
    assert torch.equal(result.labels, expected.points)
    assert torch.equal(result.points, synthetic.scene.points)
    for name, labels in zip(expected.names, expected.images, strict=True):
        image = Image.open(out / "images" / f"{name}.png")
        assert image.mode == "I;16"
        np.testing.assert_array_equal(np.array(image).astype(np.int64) - 1, labels.numpy())

    record = yaml.safe_load((out / "run.yaml").read_text())
    assert record["config"] == config.to_dict()
    assert record["counts"]["points"] == len(result.points)
    assert record["counts"]["frames"] == 6
    assert record["counts"]["point_segments"] == expected.num_point_segments
    assert record["versions"]["torch"] == torch.__version__
    assert all(seconds >= 0 for seconds in record["seconds"].values())

    overview = Image.open(out / "overview.png")
    assert overview.height > 500
    assert len(overview.getcolors(overview.width * overview.height)) > 1000


def test_the_cloud_opens_elsewhere_with_colours_and_labels(out):
    from open3d import io, t

    labels = read_points(out).labels.numpy()
    cloud = io.read_point_cloud(str(out / "points.ply"))
    colors = (np.asarray(cloud.colors) * 255).round().astype(int)
    assert len(colors) == len(labels)
    assert len(np.unique(colors[labels == 0], axis=0)) == 1  # one segment, one colour
    assert t.io.read_point_cloud(str(out / "points.ply")).point.label.numpy().ravel().tolist() == labels.tolist()


@pytest.mark.slow
def test_a_recording_far_from_the_origin(recording, synthetic, out, run, tmp_path):
    """Coordinates of a map, with a cloud of doubles: the same labels to the last bit."""
    offset = np.array([500_000.0, 5_400_000.0, 100.0])
    far = shutil.copytree(recording, tmp_path / "far")
    for file in far.glob("*.pose.txt"):
        pose = np.loadtxt(file)
        pose[:3, 3] += offset
        np.savetxt(file, pose, fmt="%.17g")
    write_cloud(far / "cloud.ply", synthetic.scene.points.double() + torch.from_numpy(offset), synthetic.scene.colors)
    run("segment", far, "-o", tmp_path / "out", *SMALL, "refinement.color_weight=90")
    here, there = read_points(out), read_points(tmp_path / "out")
    torch.testing.assert_close(there.points - torch.from_numpy(offset), here.points.double(), atol=1e-8, rtol=0)
    assert torch.equal(there.labels, here.labels)
    for image in (out / "images").iterdir():
        assert image.read_bytes() == (tmp_path / "out" / "images" / image.name).read_bytes()


def test_an_existing_result_is_kept(out, recording, run):
    before = (out / "run.yaml").read_text()
    with pytest.raises(SystemExit, match=r"out: exists already; choose another folder, or --overwrite"):
        run("segment", recording, "-o", out)
    assert (out / "run.yaml").read_text() == before


def test_overwrite(recording, run, tmp_path):
    folder = tmp_path / "twice"
    folder.mkdir()
    (folder / "thesis.tex").write_text("precious")
    with pytest.raises(SystemExit, match=r"twice: expected a result of torchjoint, which has a run\.yaml"):
        run("segment", recording, "-o", folder, "--overwrite", "--max-frames", 2, *SMALL)
    assert (folder / "thesis.tex").read_text() == "precious"
    (folder / "run.yaml").write_text("an earlier result")
    with pytest.raises(SystemExit, match=r"thesis\.tex: is of no result of torchjoint; move or delete it"):
        run("segment", recording, "-o", folder, "--overwrite", "--max-frames", 2, *SMALL)
    os.rename(folder / "thesis.tex", folder / "points.ply")
    run("segment", recording, "-o", folder, "--overwrite", "--max-frames", 2, "--up", 0, 0, -2, *SMALL)
    assert (folder / "points.ply").read_bytes() != b"precious"
    assert tj.load_result(folder).scene.up.tolist() == json.loads((folder / "segments.json").read_text())["up"]
    assert tj.load_result(folder).scene.up.tolist() == [0, 0, -1]
    assert len(list((folder / "images").iterdir())) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["twice"]


def test_what_fails_leaves_no_result(tmp_path):
    def write_and_die():
        with output_folder(tmp_path / "out", "source", key="run") as partial:
            (partial / "half").write_text("x")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_and_die()
    assert not (tmp_path / "out").exists()
    with output_folder(tmp_path / "out", "source", key="run") as partial:
        assert (partial / "half").exists()  # to be resumed
    shutil.rmtree(tmp_path / "out")
    with pytest.raises(KeyboardInterrupt):
        write_and_die()
    with output_folder(tmp_path / "out", "another source") as partial:
        assert not (partial / "half").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("kind", ["file", "dangling link", "recording"])
def test_outputs_that_cannot_be(recording, run, tmp_path, kind):
    out = tmp_path / "out"
    if kind == "file":
        out.write_text("precious")
    elif kind == "dangling link":
        out.symlink_to(tmp_path / "nowhere")
    else:
        out = recording
    with pytest.raises(SystemExit, match=r"exists and is not a folder|expected another path than the input's"):
        run("segment", recording, "-o", out, "--overwrite", *SMALL)
    assert kind != "file" or out.read_text() == "precious"
    assert (recording / "camera-intrinsics.txt").exists()


@pytest.mark.slow
def test_a_fused_cloud_is_kept_beside_the_output(synthetic, run, tmp_path):
    recording = write_folder(tmp_path / "recording", synthetic, cloud=False)
    run("segment", recording, "-o", tmp_path / "out", "--voxel-size", 0.05, *SMALL)
    assert (tmp_path / "out" / "cloud-50mm.ply").is_file()
    assert not (recording / "cloud.ply").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "propagation.wieght=1"], r"torchjoint: error: propagation\.wieght: unknown parameter"),
        (["--preset", "nope"], r"torchjoint: error: preset: expected one of default, paper"),
        (["--preset", "nope.yaml"], r"torchjoint: error: .*nope\.yaml"),
        (["--up", 0, 0, 0], r"torchjoint: error: --up: expected a direction, got zeros"),
        (["--max-frames", "-1"], r"torchjoint: error: --max-frames: expected >= 0, got -1"),
    ],
)
def test_errors_are_one_line(recording, run, tmp_path, arguments, message):
    with pytest.raises(SystemExit, match=message):
        run("segment", recording, "-o", tmp_path / "out", *arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_scene_that_is_not_there(run, tmp_path):
    with pytest.raises(SystemExit, match=r"scene: .*nowhere does not exist"):
        run("segment", tmp_path / "nowhere", "-o", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_in_the_way_is_left_alone(recording, run, tmp_path):
    mine = tmp_path / "out.partial" / "thesis.tex"
    mine.parent.mkdir()
    mine.write_text("precious")
    with pytest.raises(SystemExit, match=r"out\.partial: expected the folder of an earlier run"):
        run("segment", recording, "-o", tmp_path / "out", *SMALL)
    assert mine.read_text() == "precious"


def test_show_of_something_else(run, tmp_path):
    with pytest.raises(SystemExit, match=r"run\.yaml: missing; expected a folder that `torchjoint segment` wrote"):
        run("show", tmp_path)
    with pytest.raises(FileNotFoundError, match=r"points\.npz: missing; expected a folder that `torchjoint segment`"):
        tj.load_result(tmp_path)
    (tmp_path / "points.npz").write_bytes(b"PK\x03\x04 broken")
    with pytest.raises(ValueError, match=r"points\.npz: not a whole result"):
        tj.load_result(tmp_path)


def test_demo(monkeypatch, tmp_path, capsys, run, synthetic):
    write_truth(write_folder(tmp_path / "room", synthetic), synthetic)
    monkeypatch.setattr("torchjoint.cli.demo.RECORDING", tmp_path / "room")
    run("demo", "-o", tmp_path / "demo", *SMALL)
    assert (tmp_path / "demo" / "overview.png").is_file()
    told = capsys.readouterr().out
    assert "against the truth, in 3D: covering 0." in told
    listed = re.search(r"written to \S+: (.*) \(docs/quickstart\.md\)", told)[1].split(", ")
    assert listed == sorted(one.name + "/" * one.is_dir() for one in (tmp_path / "demo").iterdir())
    run("show", tmp_path / "demo", "--truth", "--static", tmp_path / "page.html")
    assert "<option>truth</option>" in (tmp_path / "page.html").read_text(encoding="utf-8")
    with pytest.raises(SystemExit, match="demo: exists already"):
        run("demo", "-o", tmp_path / "demo", *SMALL)


def test_the_recording_of_the_demo():
    """It is small, dense, and its truth fits: most points lie in images where they should, with their label."""
    assert sum(file.stat().st_size for file in RECORDING.iterdir()) < 3e6
    scene = tj.load_scene(RECORDING)
    points, labels = scene.points, scene.truth.points
    assert len(points) > 80_000
    assert nearest_neighbors(points, 2).spacing.median() < 0.025
    assert (labels >= 0).float().mean() > 0.95
    seen = right = 0
    for frame, image in zip(scene.frames, scene.truth.images, strict=True):
        at = project(points, frame.intrinsics, frame.world_to_camera, frame.size)
        row, column, label = at.v.round().long(), at.u.round().long(), labels[at.point]
        here = ((frame.depth[row, column] - at.z).abs() < 0.02) & (label >= 0)
        seen, right = seen + here.sum(), right + (image[row, column] == label)[here].sum()
    assert seen > 2 * len(points)
    assert right / seen > 0.95


def test_an_error_that_is_no_one_s_fault_is_one_line(recording, run, tmp_path, monkeypatch):
    """Full disks and too little memory; what the package itself does wrong keeps its traceback."""
    for error, message in [
        (OSError(errno.ENOSPC, "No space", "sums.pt"), r"error: the disk is full \(sums\.pt\); make room"),
        (MemoryError(), r"error: out of memory; --thin"),
        (RuntimeError("[enforce fail] DefaultCPUAllocator: not enough memory: you tried"), r"error: out of memory"),
        (RecursionError("maximum recursion depth exceeded"), r"error: nested too deeply"),
        (BrokenProcessPool("a worker was killed"), r"error: a worker was killed"),
    ]:

        def fail(*_, error=error, **__):
            raise error

        monkeypatch.setattr("torchjoint.recordings.segment.load_scene", fail)
        with pytest.raises(SystemExit, match=message):
            run("segment", recording, "-o", tmp_path / "out", *SMALL)
    monkeypatch.setattr("torchjoint.recordings.segment.load_scene", lambda *_, **__: torch.zeros(2) @ torch.zeros(3))
    with pytest.raises(RuntimeError, match="inconsistent tensor size"):
        run("segment", recording, "-o", tmp_path / "out", *SMALL)
    assert list(tmp_path.iterdir()) == []


def test_poses_that_look_wrong_end_a_run(scene_of, run, tmp_path):
    folder = write_folder(tmp_path / "recording", scene_of(3))
    for file in folder.glob("*.pose.txt"):
        np.savetxt(file, np.linalg.inv(np.loadtxt(file)))
    with pytest.raises(SystemExit, match=r"the poses look inverted: .*; --ignore-poses segments it all the same"):
        run("segment", folder, "-o", tmp_path / "out", *SMALL)
    assert not (tmp_path / "out").exists()
    with pytest.warns(tj.PoseWarning, match="the poses look inverted"):
        run("segment", folder, "-o", tmp_path / "out", "--ignore-poses", *SMALL)
    assert (tmp_path / "out" / "points.npz").is_file()


def test_intrinsics_of_another_size_are_named_in_the_error(scene_of, run, tmp_path):
    folder = write_folder(tmp_path / "recording", scene_of(3))
    file = folder / "camera-intrinsics.txt"
    np.savetxt(file, np.diag([2, 2, 1]) @ np.loadtxt(file))
    with pytest.raises(SystemExit, match=r"or units\?; the principal point .* another image size\? .*--ignore-poses"):
        run("segment", folder, "-o", tmp_path / "out", *SMALL)


@pytest.mark.slow
def test_a_full_disk_costs_nothing(recording, out, run, tmp_path, monkeypatch):
    """After making room the run goes on where it was, also at the default interval, with the same result."""
    again = tmp_path / "out"

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("torchjoint.recordings.segment.write_result", full)
    with pytest.raises(SystemExit, match=r"error: the disk is full \(.*\); make room and start again"):
        run("segment", recording, "-o", again, *SMALL, "refinement.color_weight=90")
    monkeypatch.undo()
    monkeypatch.setattr("torchjoint.results.folder.overview", overview)
    added = []
    monkeypatch.setattr("torchjoint.joint.observe", lambda frames, *_: added.append(frames))
    run("segment", recording, "-o", again, *SMALL, "refinement.color_weight=90")
    assert added == []
    for file in ("points.npz", "hierarchy.npz", "points.ply", "overview.png"):
        assert (again / file).read_bytes() == (out / file).read_bytes()
