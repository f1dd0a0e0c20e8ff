"""What a run did not see at its output when it began stays; what it replaces is there until the new one stands."""

import errno
import os
from pathlib import Path

import pytest

from torchjoint.runtime import outputs
from torchjoint.runtime.outputs import ChangedError, Output, check_no_input, move_new, put, seen, settle


def write(path, text):
    """A file; a folder if the path has no suffix."""
    if path.suffix:
        path.write_text(text)
    else:
        path.mkdir(exist_ok=True)
        (path / "file.txt").write_text(text)


def text_of(path):
    return (path if path.suffix else path / "file.txt").read_text()


@pytest.fixture(params=["out.txt", "out"])
def out(request, tmp_path):
    (tmp_path / "o").mkdir()
    return tmp_path / "o" / request.param


def test_a_new_one_and_then_another(out):
    made = Output(out, overwrite=False)
    for text in ("first", "second"):  # what it has written itself, it may replace
        with made.written() as path:
            assert path.name == out.name
            write(path, text)
        assert text_of(out) == text
    assert list(out.parent.iterdir()) == [out]


def test_errors_name_the_path_that_was_given(out):
    def fail():
        with Output(out, overwrite=False).written() as path:
            raise ValueError(f"{path}: expected .las or .laz")

    with pytest.raises(ValueError, match=f"^{out}: expected .las or .laz$"):
        fail()


@pytest.mark.parametrize("before", [None, "old"])
def test_what_comes_meanwhile_stays(out, before):
    if before:
        write(out, before)
    made = Output(out, overwrite=True)

    def end():
        with made.written() as path:
            write(path, "new")
            write(out, "by hand")

    with pytest.raises(FileExistsError, match=r"out.* was made or changed while this run worked, and is kept; move it"):
        end()
    assert text_of(out) == "by hand"
    assert list(out.parent.iterdir()) == [out]


def test_what_comes_in_the_last_moment_stays(out, monkeypatch):
    """After the last look, when an earlier folder has moved aside: it comes back, or waits where it is."""
    write(out, "old")
    check = outputs.check_unchanged

    def late(path, before, without=(), at=None):
        check(path, before, without, at)
        if at is not None:
            write(out, "by hand")

    monkeypatch.setattr(outputs, "check_unchanged", late)
    new, aside = out.with_name(f"new{out.suffix}"), out.with_name("aside")
    write(new, "new")
    if out.suffix:
        put(new, out, seen(out), aside)  # a file is replaced in one step, and never gone
        assert text_of(out) == "new"
        return
    with pytest.raises(ChangedError):
        put(new, out, seen(out), aside)
    assert [text_of(path) for path in (out, aside, new)] == ["by hand", "old", "new"]


def test_an_earlier_folder_comes_back(tmp_path, monkeypatch):
    write(tmp_path / "out", "old")
    made, rename = Output(tmp_path / "out", overwrite=True), os.rename

    def fails(source, target):
        if source.parent.name.startswith(".partial-") and source.name == "out":
            raise OSError(errno.ENOSPC, "No space left on device")
        rename(source, target)

    monkeypatch.setattr(outputs.os, "rename", fails)

    def end():
        with made.written() as path:
            write(path, "new")

    with pytest.raises(OSError, match="No space left") as raised:
        end()
    assert raised.value.filename == str(tmp_path / "out")  # the path that the user knows
    assert text_of(tmp_path / "out") == "old"
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]


def test_an_array_on_a_full_disk(tmp_path):
    """NumPy tells neither the file nor the reason."""
    made = Output(tmp_path / "a.npy", overwrite=False)

    def end():
        with made.written() as path:
            path.touch()
            raise OSError("4000 requested and 496 written")

    with pytest.raises(OSError, match=r"a\.npy: cannot be written \(4000 .* written\); is the disk full\?"):
        end()
    assert list(tmp_path.iterdir()) == []


def test_a_kill_between_both_steps(tmp_path):
    new, out, aside = (tmp_path / name for name in ("new", "out", "aside"))
    write(new, "new")
    write(aside, "old")
    settle(new, out, aside)  # killed before the new one stood
    assert (text_of(out), aside.exists()) == ("old", False)
    write(aside, "older")
    with pytest.raises(FileExistsError, match=r"aside: holds what stood at .*out before the last run; move it"):
        settle(new, out, aside)
    assert text_of(aside) == "older"
    settle(tmp_path / "placed", out, aside)  # killed afterwards
    assert (text_of(out), aside.exists()) == ("old", False)


@pytest.mark.parametrize("has_links", [True, False])
def test_moving_replaces_nothing(tmp_path, monkeypatch, has_links):
    one, two = tmp_path / "one.txt", tmp_path / "two.txt"
    one.write_text("one")
    two.write_text("two")
    if not has_links:
        monkeypatch.setattr(outputs.os, "link", no_link)
    with pytest.raises(ChangedError, match=r"two\.txt: was made or changed"):
        move_new(one, two)
    assert [one.read_text(), two.read_text()] == ["one", "two"]
    two.unlink()
    move_new(one, two)
    assert two.read_text() == "one"
    assert not one.exists()


def no_link(source, target):
    raise OSError(errno.EPERM, "Operation not permitted")


def test_a_killed_move_goes_on(tmp_path):
    (tmp_path / "one.txt").write_text("one")
    os.link(tmp_path / "one.txt", tmp_path / "two.txt")
    move_new(tmp_path / "one.txt", tmp_path / "two.txt")
    assert [path.name for path in tmp_path.iterdir()] == ["two.txt"]


@pytest.mark.parametrize("link", [None, os.symlink, os.link])
def test_an_output_is_no_input(tmp_path, link):
    given = out = tmp_path / "cloud.ply"
    given.write_text("precious")
    if link is not None:
        out = tmp_path / "out.ply"
        link(given, out)
    with pytest.raises(ValueError, match=r"-o: expected another path than the input's, .*cloud\.ply, got"):
        Output(out, overwrite=True, inputs=(given,))
    with pytest.raises(ValueError, match="--static: expected another path than the input's"):
        check_no_input(given, (out,), "--static")


def test_an_output_is_no_part_of_an_input_and_holds_none(tmp_path):
    write(tmp_path / "result", "precious")
    (tmp_path / "link").symlink_to("result")
    with pytest.raises(ValueError, match="expected another path than the input's"):
        check_no_input(tmp_path / "result" / "file.txt", (tmp_path / "link",))
    with pytest.raises(ValueError, match="expected a folder that does not contain the input"):
        check_no_input(tmp_path, (None, tmp_path / "link" / "file.txt"))
    check_no_input(tmp_path / "result" / "new.txt", (tmp_path / "result", tmp_path / "nowhere"))


def test_what_does_not_belong_is_removed_if_nobody_changed_it(tmp_path):
    made = Output(tmp_path / "levels.csv", overwrite=True)
    made.remove()
    write(made.path, "by hand")
    with pytest.raises(ChangedError):
        made.remove()
    Output(made.path, overwrite=True).remove()
    assert not made.path.exists()


@pytest.mark.parametrize("out", ["out"], indirect=True)
def test_a_mount_point_is_not_replaced(out, monkeypatch):
    write(out, "mine")
    monkeypatch.setattr(outputs, "is_fixed", lambda path: path == out)
    with pytest.raises(FileExistsError, match=r"-o: .*out is a mount point, .*cannot be replaced; choose a new folder"):
        Output(out, overwrite=True)
    assert text_of(out) == "mine"


def test_pipes_and_devices_are_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path / "pipe", Path(os.devnull)):
        with pytest.raises(FileExistsError, match="is a device, a pipe or a socket; choose a new name"):
            Output(place, overwrite=True)
