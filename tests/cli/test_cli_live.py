"""torchjoint live: a recording is played, and its last result is written like that of segment."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
import samples
import torch
from folder_files import write_folder

import torchjoint as tj
from torchjoint.results.folder import write_result
from torchjoint.runtime import outputs


@pytest.fixture(scope="module")
def recording(tmp_path_factory, scene_of):
    return write_folder(tmp_path_factory.mktemp("live") / "recording", scene_of(2), cloud=False)


def test_the_last_result_is_written(recording, tmp_path, run, capsys):
    run("live", recording, "-o", tmp_path / "out", "--voxel-size", "0.12", "--step", "0", "--every", "1")
    said = capsys.readouterr().out
    frames = tj.load_scene(recording).frames
    assert f"{len(frames)} frames, the slowest in" in said
    assert f"0 dropped; {len(frames)} keyframes" in said
    assert "things in" in said
    result = tj.load_result(tmp_path / "out")
    segmenter = tj.LiveSegmenter(voxel_size=0.12, step=0)
    segmenter.update(list(frames))
    expected = segmenter.result()
    assert torch.equal(result.points, expected.segmentation.points)
    assert torch.equal(result.scene.points, expected.cloud.points)


def test_nothing_is_fused_before_it_plays(recording, tmp_path, run, monkeypatch):
    monkeypatch.setattr("torchjoint.datasets.recording.fuse_or_recall", lambda *_: pytest.fail("fused while loading"))
    run("live", recording, "-o", tmp_path / "out", "--voxel-size", "0.12")
    assert len(tj.load_result(tmp_path / "out").scene.points) > 1000


def test_a_recording_that_changes_while_it_plays(recording, tmp_path, run, monkeypatch):
    """Its pictures in the result are read at the end, and may be others than those that were segmented."""
    changing, update = shutil.copytree(recording, tmp_path / "recording"), tj.LiveSegmenter.update
    first, *_, last = sorted(changing.glob("*.color.png"))
    monkeypatch.setattr(tj.LiveSegmenter, "update", lambda *given: (shutil.copy(last, first), update(*given)))
    with pytest.warns(
        UserWarning, match="recording: it or its masks changed meanwhile; the result may be of both states"
    ):
        run("live", changing, "-o", tmp_path / "out", "--voxel-size", "0.12")
    monkeypatch.setattr(tj.LiveSegmenter, "update", update)
    monkeypatch.setattr(
        "torchjoint.cli.live.write_result", lambda *given, **named: (first.touch(), write_result(*given, **named))
    )
    with pytest.warns(
        UserWarning, match="recording: it or its masks changed meanwhile; the result may be of both states"
    ):
        run("live", changing, "-o", tmp_path / "more", "--voxel-size", "0.12")


def test_wrong_poses_are_told_before_it_plays(recording, tmp_path, run, monkeypatch):
    wrong = shutil.copytree(recording, tmp_path / "recording")
    for file in wrong.glob("*.pose.txt"):
        np.savetxt(file, np.linalg.inv(np.loadtxt(file)))
    monkeypatch.setattr("torchjoint.cli.live.play", lambda *_: sys.exit("it plays"))
    with pytest.warns(tj.PoseWarning, match="recording: the poses look inverted"), pytest.raises(SystemExit):
        run("live", wrong, "-o", tmp_path / "out")


def test_a_cloud_alone_is_no_recording(tmp_path, run):
    with pytest.raises(SystemExit, match=r"cloud\.ply: expected frames with depth, got a cloud without frames"):
        run("live", samples.write("cloud_alone", tmp_path / "sample"), "-o", tmp_path / "out")


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--rate", "0", "--rate: expected more than 0 and up to 1000 frames a second, or None, got 0.0"),
        ("--every", "-1", "--every: expected a number of frames of at least 0, got -1"),
        ("--voxel-size", "0", "voxel_size: expected 0.0001 to 10 metres, got 0.0"),
    ],
)
def test_wrong_options_are_named(recording, tmp_path, run, option, value, message):
    with pytest.raises(SystemExit, match=message):
        run("live", recording, "-o", tmp_path / "out", option, value)
    assert not (tmp_path / "out").exists()


def test_a_recording_without_depth_is_named(tmp_path, scene_of, run):
    folder = write_folder(tmp_path / "recording", scene_of(2), depth=False)
    with pytest.raises(SystemExit, match="depth: the frames so far give no surface"):
        run("live", folder, "-o", tmp_path / "out")


@pytest.mark.slow
def test_a_page_shows_each_result(recording, tmp_path, run, monkeypatch, capsys):
    shown, served = [], []

    class Page:
        viewer = "viewer"

        def camera(self, frame):
            shown.append(frame.name)

        def show(self, result, seen, note):
            assert seen.up.tolist() == [0, 1, 0]
            shown.append((len(seen.frames), len(result.labels) == len(result.cloud.points), note))

        def finish(self, folder, result):
            written = tj.load_result(folder)
            assert len(written.points) == len(result.labels)
            assert written.scene.up.tolist() == [0, 1, 0]
            served.append(folder)

    monkeypatch.setattr("torchjoint.cli.live.growing_view", Page)
    told = replace(tj.load_scene(recording, fuse=False), up=torch.tensor([0.0, 1, 0]))
    monkeypatch.setattr("torchjoint.cli.live.load_scene", lambda *_, **__: told)
    monkeypatch.setattr("torchjoint.cli.live.serve_until_interrupted", served.append)
    options = ("--voxel-size", "0.12", "--show")
    run("live", recording, "-o", tmp_path / "out", *options)
    names = [frame.name for frame in tj.load_scene(recording).frames]
    assert [one for one in shown if isinstance(one, str)] == names
    results = [one for one in shown if not isinstance(one, str)]
    assert len(results) > 1
    assert all(fits for _, fits, _ in results)
    assert results[0][2].startswith(f"after {results[0][0]} frame")
    assert results[-1][0] == len(names)
    assert results[-1][2].startswith("at the end: ")
    assert served == [tmp_path / "out", "viewer"]
    assert "after 1 frame: " in capsys.readouterr().out


@pytest.mark.slow
def test_a_recording_of_rerun_is_written(recording, tmp_path, run):
    pytest.importorskip("rerun", reason="recordings of Rerun need rerun: pip install 'torchjoint[rerun]'")
    from rerun.chunk import RrdReader

    options = ("--voxel-size", "0.12", "--every", "2", "--rerun", tmp_path / "a.rrd")
    run("live", recording, "-o", tmp_path / "out", *options)
    numbers = {}
    for chunk in RrdReader(tmp_path / "a.rrd").stream():
        rows = chunk.to_record_batch().to_pydict()
        numbers.setdefault(chunk.entity_path, set()).update(rows.get("frame", ()))
    count = len(tj.load_scene(recording).frames)
    assert numbers["/world/camera/image"] == set(range(1, count + 1))
    assert {2, count} <= numbers["/world/things"]
    assert numbers["/world/camera/things"]


def test_no_file_of_rerun_is_overwritten(recording, tmp_path, run):
    (tmp_path / "a.rrd").write_text("mine")
    with pytest.raises(SystemExit, match=r"a\.rrd: exists already; choose another name with --rerun, or --overwrite"):
        run("live", recording, "-o", tmp_path / "out", "--rerun", tmp_path / "a.rrd")
    assert (tmp_path / "a.rrd").read_text() == "mine"
    assert not (tmp_path / "out").exists()


def test_a_bag_is_played(tmp_path, run, capsys):
    pytest.importorskip("rosbags", reason="ROS recordings need rosbags: pip install 'torchjoint[ros]'")
    bag = samples.write("ros", tmp_path / "ros")
    run("live", bag, "-o", tmp_path / "out", "--topics", "color=/camera/image_raw")
    assert "2 frames, the slowest in" in capsys.readouterr().out
    names = [frame.name for frame in tj.load_scene(bag).frames]
    assert list(tj.load_result(tmp_path / "out").names) == names
    with pytest.raises(SystemExit, match=r"topics: color: .* has no messages of /front"):
        run("live", bag, "-o", tmp_path / "other", "--topics", "color=/front")


def test_a_file_of_rerun_that_comes_meanwhile_stays(recording, tmp_path, run, monkeypatch):
    pytest.importorskip("rerun", reason="recordings of Rerun need rerun: pip install 'torchjoint[rerun]'")
    file, put = tmp_path / "log.rrd", outputs.put

    def late(*given):
        file.write_text("by hand")
        put(*given)

    monkeypatch.setattr(outputs, "put", late)
    with pytest.raises(SystemExit, match=r"log\.rrd: was made or changed while this run worked"):
        run("live", recording, "-o", tmp_path / "out", "--voxel-size", "0.1", "--rerun", file)
    assert file.read_text() == "by hand"
