"""Bytes on disk that leave nothing behind, and are not lost when the disk is full or the folder is deleted."""

import errno
import gc
import os
import pickle

import pytest

import torchjoint as tj
from torchjoint.runtime import store as offload
from torchjoint.runtime.store import OffloadFile
from torchjoint.views.observations import Observations


def test_what_is_written_is_read(tmp_path):
    file = OffloadFile(tmp_path)
    first, empty, second = [*file.write([b"one", b""]), *file.write([b"two two"])]
    assert (first.read(), empty.read(), second.read()) == (b"one", b"", b"two two")
    assert pickle.loads(pickle.dumps(second)) == b"two two"


def test_the_last_span_closes_the_file_and_leaves_nothing(tmp_path):
    file = OffloadFile(tmp_path)
    (span,) = file.write([b"bytes"])
    assert list(tmp_path.iterdir()) == []
    tmp_path.rmdir()
    number, file = file._file.fileno(), None
    assert span.read() == b"bytes"
    del span
    gc.collect()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(number)


def test_a_full_disk_is_told_and_nothing_is_lost(tmp_path, monkeypatch):
    file = OffloadFile(tmp_path)
    (before,) = file.write([b"before"])
    pwrite = os.pwrite

    def full(number, data, start):
        if start >= 12:
            raise OSError(errno.ENOSPC, "No space left on device")
        return pwrite(number, data[: 12 - start], start)

    monkeypatch.setattr(offload.os, "pwrite", full)
    with pytest.raises(
        OSError, match=r"memory: .*cannot be written \(No space left on device\); free disk space"
    ) as raised:
        file.write([b"abc", b"defghi"])
    assert (raised.value.errno, raised.value.filename) == (errno.ENOSPC, str(tmp_path))
    assert os.fstat(file._file.fileno()).st_size == 6
    monkeypatch.undo()
    (after,) = file.write([b"after"])
    assert (before.read(), after.read()) == (b"before", b"after")


def test_a_file_is_memory(tmp_path, monkeypatch):
    file = OffloadFile(tmp_path)
    small = file.mapped(3)
    small[:] = b"one"
    large = file.mapped(offload.ZEROS + 10)
    assert (large[:4], large[-1:], len(large)) == (b"one\0", b"\0", offload.ZEROS + 10)
    large[1] = ord("w")
    assert small[:] == b"owe"

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(offload.os, "pwrite", full)
    with pytest.raises(OSError, match=r"memory: .*cannot be written \(No space left on device\)"):
        file.mapped(offload.ZEROS + 11)


def test_a_missing_folder_is_told(tmp_path):
    with pytest.raises(OSError, match=r"memory: .*\(No such file or directory\).*: '.*/gone'"):
        OffloadFile(tmp_path / "gone")


def test_the_default_folder(tmp_path, monkeypatch):
    monkeypatch.delenv("TMPDIR", raising=False)
    assert str(OffloadFile().folder) == "/var/tmp"
    monkeypatch.setattr(offload.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert OffloadFile().folder == tmp_path


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_forked_processes_do_not_write_to_one_file(tmp_path, monkeypatch):
    """Both wrote to the same place, and each read what the other had written."""
    kept = Observations(budget=0, folder=tmp_path)
    kept._file = before = OffloadFile(tmp_path)
    child = os.getpid() + 1
    monkeypatch.setattr(os, "getpid", lambda: child)
    scene = tj.synthetic.make_scene(seed=0, num_views=1).scene
    segmenter = tj.JointSegmenter()
    segmenter.reset(scene.points)
    segmenter.update(scene.frames)
    kept.extend(segmenter.state.observations[:])
    assert kept._file is not before
