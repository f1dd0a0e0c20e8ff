"""Files that are always whole: there after success, as they were after an error, and nothing is left beside them."""

import errno

import pytest

from torchjoint.runtime.files import atomic_write, remove_partial_files, write_text


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("name", ["scores.png", "state.tar.gz"])
def test_the_file_takes_its_place(tmp_path, name):
    file = tmp_path / name
    file.write_text("old")
    with atomic_write(file) as partial:
        assert partial.parent == tmp_path
        assert partial.suffix == file.suffix  # libraries tell formats by it
        assert partial != file
        partial.write_text("new")
        assert file.read_text() == "old"
    assert file.read_text() == "new"
    assert names(tmp_path) == [name]


def write_half(file):
    with atomic_write(file) as partial:
        partial.write_text("half")
        raise KeyboardInterrupt


@pytest.mark.parametrize("before", [None, "old"])
def test_after_an_error_all_is_as_before(tmp_path, before):
    file = tmp_path / "scores.csv"
    if before:
        file.write_text(before)
    with pytest.raises(KeyboardInterrupt):
        write_half(file)
    assert names(tmp_path) == ([file.name] if before else [])
    assert before is None or file.read_text() == before


def test_a_full_disk_names_the_file(tmp_path):
    """The system names it where a file is opened, and not where there is no room for its content."""

    def end():
        with atomic_write(tmp_path / "a.csv"):
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space") as raised:
        end()
    assert raised.value.filename == str(tmp_path / "a.csv")


def test_nothing_written_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_write(tmp_path / "scores.csv"):
        pass
    assert names(tmp_path) == []


def test_text_is_utf_8(tmp_path):
    write_text(tmp_path / "page.md", "5 × 10 µm")
    assert (tmp_path / "page.md").read_bytes() == "5 × 10 µm".encode()
    assert names(tmp_path) == ["page.md"]


def test_two_writers_of_one_file(tmp_path):
    """Each writes a whole file, whenever the other one begins or ends."""
    file = tmp_path / "labels.csv"
    with atomic_write(file) as one:
        one.write_text("one")
        with atomic_write(file) as two:
            two.write_text("two")
            assert one.read_text() == "one"
        assert file.read_text() == "two"
    assert file.read_text() == "one"
    assert names(tmp_path) == [file.name]


def test_a_name_as_long_as_it_can_be(tmp_path):
    write_text(tmp_path / f"{'n' * 251}.txt", "content")
    assert names(tmp_path) == [f"{'n' * 251}.txt"]


def test_what_killed_writers_left(tmp_path):
    mine = [".partial-mine.csv", "a.csv", ".partial"]
    for name in (*mine, ".partial-0123456789abcdef.csv"):
        (tmp_path / name).touch()
    remove_partial_files(tmp_path)
    assert names(tmp_path) == sorted(mine)
