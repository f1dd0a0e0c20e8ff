"""One recording over many workers: the same labels as in one process."""

import contextlib
import os
import threading
from concurrent.futures import Future
from dataclasses import replace

import pytest
import torch
from test_batch import HereExecutor

import torchjoint as tj
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.engine.engine import SHARED
from torchjoint.recordings.segment import evidence_of_chunks, fingerprints, run, segment_recording
from torchjoint.results.checkpoint import Checkpoint
from torchjoint.results.folder import write_result
from torchjoint.runtime.files import file_checksum

QUICK = tj.Config().set(["boundary.detector=gradient"])


def assert_same(one, other):
    assert torch.equal(one.points, other.points)
    assert one.names == other.names
    for labels, others in zip(one.images, other.images, strict=True):
        assert torch.equal(labels, others)


class SwappingExecutor(HereExecutor):
    """Every other task ends after the following one; with a limit, it breaks after some tasks."""

    def __init__(self, limit=None):
        super().__init__()
        self.limit, self._max_workers = limit, 2

    def submit(self, function, /, *arguments):
        if self.started == self.limit:
            raise ConnectionError("cut")
        ended, future = super().submit(function, *arguments), Future()
        future.set_running_or_notify_cancel()  # after a cut, too, it gets its result
        threading.Timer(0.2 * (self.started % 2), lambda: future.set_result(ended.result())).start()
        return future


@pytest.fixture(scope="module")
def whole(scene_of):
    return tj.JointSegmenter(QUICK)(scene_of(2).scene)


def test_a_path_that_is_no_text(tmp_path):
    """Its result could not be read."""
    (path := tmp_path / "a\udcff.ply").touch()
    with pytest.raises(ValueError, match="expected a recording and masks with paths in UTF-8"):
        segment_recording(path, tmp_path / "out", QUICK, tj.RecordingOptions())
    assert not (tmp_path / "out").exists()


def test_a_page_opens_before_files_are_read_if_all_else_is_right(scene_of, tmp_path):
    (recording := tmp_path / "a.ply").write_bytes(b"ply\nno header")
    begun, options = [], tj.RecordingOptions()
    for path, out in ((tmp_path / "full", "out"), (recording, "full")):  # no format; not OUT's
        (tmp_path / "full").mkdir(exist_ok=True)
        (tmp_path / "full" / "mine.txt").touch()
        with pytest.raises((ValueError, OSError), match=r"no known format|exists already"):
            segment_recording(path, tmp_path / out, QUICK, options, begin=lambda: begun.append(1))
    assert not begun
    with pytest.raises(ValueError, match=r"a\.ply"):
        segment_recording(recording, tmp_path / "out", QUICK, options, begin=lambda: begun.append(1))
    assert begun == [1]


def test_topics_may_be_a_dict():
    """Its topics did not count: a batch took the result of another camera for done."""
    pairs, others = (tj.RecordingOptions(topics=topics) for topics in ((("color", "/left"),), {"color": "/right"}))
    same = tj.RecordingOptions(topics={"color": "/left"})
    assert same.source() == pairs.source() != others.source()
    assert same.record(QUICK) == pairs.record(QUICK) != others.record(QUICK)


def test_any_order(whole, scene_of, tmp_path):
    scene, segmenter = scene_of(2).scene, tj.JointSegmenter(QUICK)
    checkpoint = Checkpoint(tmp_path / "state", "key")
    with pytest.raises(ConnectionError):
        run(segmenter, scene, checkpoint, engine=SwappingExecutor(limit=3))
    assert 0 < len(segmenter.state.observations) < len(scene.frames)
    (checkpoint.directory / f"{SHARED}killed").touch()
    again = Checkpoint(tmp_path / "state", "key")
    segmenter = tj.JointSegmenter(QUICK)
    assert_same(run(segmenter, scene, again, engine=SwappingExecutor()), whole)
    assert not list(again.directory.glob(f"{SHARED}*"))
    assert segmenter.stopwatch.seconds["boundaries"] > 0


def test_an_error_of_a_frame_is_raised(scene_of):
    scene = scene_of(2).scene

    class Damaged(tuple):
        def __getitem__(self, index):
            raise OSError("frame.png: damaged")

    segmenter = tj.JointSegmenter(QUICK)
    segmenter.reset(scene.points)
    damaged = replace(scene, frames=Damaged(scene.frames))
    with pytest.raises(OSError, match=r"frame.png: damaged"):
        list(evidence_of_chunks(HereExecutor())(segmenter, damaged))


def test_a_fused_cloud_is_of_its_format(scene_of, tmp_path, monkeypatch):
    """A run that was stopped because the format was wrong leaves no cloud to the run with the right one."""
    given = []

    def load(path, *, cloud, format, **_):
        given.append((format, cloud.exists()))
        write_cloud(cloud, scene_of(1).scene.points)
        raise KeyboardInterrupt

    for name, mocked in (("load_scene", load), ("find_format", lambda *_: None)):
        monkeypatch.setattr(f"torchjoint.recordings.segment.{name}", mocked)
    (tmp_path / "recording").mkdir()
    for format in (None, None, "tum"):
        with pytest.raises(KeyboardInterrupt):
            segment_recording(tmp_path / "recording", tmp_path / "out", QUICK, tj.RecordingOptions(format=format))
        (cloud,) = (tmp_path / "out.partial").glob("cloud-*.ply")
        (tmp_path / "out.partial" / "state").mkdir(exist_ok=True)
        (tmp_path / "out.partial" / "state" / "cloud.sha256").write_text(file_checksum(cloud))
    assert given == [(None, False), (None, True), ("tum", False)]


def test_a_whole_result_of_another_up_is_not_taken(scene_of, tmp_path, monkeypatch):
    """A run that was killed after its last file, started again with the same arguments, has nothing to do."""
    recording, out = tmp_path / "a.ply", tmp_path / "out"
    write_cloud(recording, scene_of(1).scene.points)
    for up, has_run in (((0.0, 0.0, 1.0), True), ((0.0, 0.0, 1.0), False), ((1.0, 0.0, 0.0), True)):
        with monkeypatch.context() as patch:
            patch.setattr("torchjoint.results.output_folder._place", lambda *_: None)
            made = segment_recording(recording, out, QUICK, tj.RecordingOptions(up=up))
            assert (made is not None) == has_run


@pytest.mark.parametrize("late", [None, "image", "masks", "gone", "written"])
def test_a_recording_that_changes_meanwhile(scene_of, tmp_path, monkeypatch, late):
    """As one that is still being copied."""
    recording, masks = tmp_path / "a.ply", tmp_path / "masks"
    write_cloud(recording, scene_of(1).scene.points)
    masks.mkdir()

    def load(*_, **__):
        if late == "gone":
            recording.unlink()
        elif late in ("image", "masks"):
            (masks / "b.png" if late == "masks" else recording).write_bytes(b"new")
        return scene_of(1).scene

    def write(*arguments, **named):  # reads the images again
        if late == "written":
            recording.write_bytes(b"new")
        write_result(*arguments, **named)

    monkeypatch.setattr("torchjoint.recordings.segment.load_scene", load)
    monkeypatch.setattr("torchjoint.recordings.segment.read_folder", lambda _, scene, *__: scene)
    monkeypatch.setattr("torchjoint.recordings.segment.write_result", write)
    told = (
        contextlib.nullcontext()
        if late is None
        else pytest.warns(UserWarning, match=r"a\.ply: it or its masks changed")
    )
    with told:
        segment_recording(recording, tmp_path / "out", QUICK, tj.RecordingOptions(), masks=masks)
    tj.load_result(tmp_path / "out")


def test_what_is_beside_a_file_of_masks_is_no_change(tmp_path):
    masks, out = tmp_path / "masks.json", tmp_path / "out"
    (tmp_path / "recording").mkdir()
    masks.write_text("{}")
    before = fingerprints(tmp_path / "recording", masks, out)
    (tmp_path / "out.partial").mkdir()
    (tmp_path / "out.partial" / "state.npz").write_text("of the run")
    (tmp_path / "notes.txt").write_text("mine")
    assert fingerprints(tmp_path / "recording", masks, out) == before
    masks.write_text("{} ")
    assert fingerprints(tmp_path / "recording", masks, out) != before


@pytest.mark.parametrize("place", ["a.ply", "masks/b.png"])
def test_another_file_with_the_time_of_the_first(scene_of, tmp_path, monkeypatch, place):
    """A run that was killed does not go on with what it has computed from the file before."""
    masks, partial = tmp_path / "masks", tmp_path / "out.partial" / "state" / "kept"
    masks.mkdir()
    (masks / "b.png").write_bytes(b"one")
    write_cloud(tmp_path / "a.ply", scene_of(1).scene.points)
    went_on = []

    def load(*_, **__):
        went_on.append(partial.exists())
        partial.parent.mkdir(exist_ok=True)
        partial.touch()
        raise KeyboardInterrupt

    monkeypatch.setattr("torchjoint.recordings.segment.load_scene", load)
    monkeypatch.setattr("torchjoint.recordings.segment.check_files", lambda _: None)
    for run_number in range(3):
        if run_number == 2:
            status = (tmp_path / place).stat()
            (tmp_path / place).write_bytes((tmp_path / place).read_bytes()[::-1])
            os.utime(tmp_path / place, ns=(status.st_atime_ns, status.st_mtime_ns))
        with pytest.raises(KeyboardInterrupt):
            segment_recording(tmp_path / "a.ply", tmp_path / "out", QUICK, tj.RecordingOptions(), masks=masks)
    assert went_on == [False, True, False]
