"""A lock whose file somebody removes: its run says so, and leaves the lock of the next one alone."""

import os

import pytest

from torchjoint.runtime.outputs import BusyError, LostError, lock


def test_one_at_a_time(tmp_path):
    path = tmp_path / "a.lock"
    with lock(path, "busy"), pytest.raises(BusyError, match="busy"), lock(path, "busy"):
        pass
    assert list(tmp_path.iterdir()) == []


def missing_after(path, change):
    with lock(path, "busy"):
        change(path)
        raise FileNotFoundError(2, "No such file or directory")


@pytest.mark.parametrize("change", ["removed", "taken"])
def test_a_missing_file_is_explained(tmp_path, change):
    path = tmp_path / "a.lock"

    def change_it(path):
        path.unlink()
        if change == "taken":
            path.touch()

    with pytest.raises(LostError, match=r"a\.lock: was removed while this run worked; another run may have taken its"):
        missing_after(path, change_it)
    assert path.exists() == (change == "taken")


def test_other_missing_files_are_what_they_are(tmp_path):
    with pytest.raises(FileNotFoundError):
        missing_after(tmp_path / "a.lock", lambda path: None)


def test_the_next_holder_keeps_its_lock(tmp_path):
    path = tmp_path / "a.lock"
    with lock(path, "busy") as first:
        path.unlink()
        with lock(path, "busy") as second:
            assert second.is_held()
            with pytest.raises(LostError):
                first.check()
            second.check()


@pytest.mark.parametrize("kind", ["file", "folder", "pipe"])
def test_a_file_of_something_else_stays(tmp_path, kind):
    path = tmp_path / "a.lock"
    {"file": lambda: path.write_text("precious"), "folder": path.mkdir, "pipe": lambda: os.mkfifo(path)}[kind]()
    with (
        pytest.raises(FileExistsError, match=r"a\.lock: expected the empty file of a lock; move it"),
        lock(path, "busy"),
    ):
        pass
    assert path.exists()
