"""An interrupted run finds its folder again; a folder that no run made at this place is neither used nor deleted."""

import os
import shutil

import pytest

from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.outputs import SOURCE, read_sealed, work_folder, write_sealed


def test_found_again_or_emptied(tmp_path):
    folder = work_folder(tmp_path / "work", "source ü")
    (folder / "half").mkdir()
    (folder / "half" / ".partial-0123456789abcdef.npz").touch()  # of a killed writer
    work_folder(folder, "source ü")
    assert sorted(path.name for path in folder.rglob("*")) == ["half", SOURCE]
    work_folder(folder, "other \udcff")  # a path that is no text
    assert [path.name for path in folder.iterdir()] == [SOURCE]
    assert read_sealed(folder / SOURCE) == r"other \udcff"


def test_killed_before_the_first_file(tmp_path):
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / ".partial-0123456789abcdef.txt").touch()
    assert [path.name for path in work_folder(tmp_path / "work", "source").iterdir()] == [SOURCE]


@pytest.mark.parametrize("text", ["source", "torchjoint 1\nsource", "torchjoint {inode}\nsource", ""])
def test_a_folder_of_others_stays(tmp_path, text):
    """Also one whose file has the seal of another folder."""
    folder = tmp_path / "work"
    folder.mkdir()
    (folder / SOURCE).write_text(text.format(inode=tmp_path.stat().st_ino))
    (folder / "thesis.tex").write_text("precious")
    for source in ("source", "other"):
        with pytest.raises(FileExistsError, match="work: expected the folder of an earlier run; move it, or choose"):
            work_folder(folder, source)
    assert (folder / "thesis.tex").read_text() == "precious"


def test_a_folder_of_another_user(tmp_path, monkeypatch):
    """Its owner could put a link to any folder into it while the run works, which would write and delete there."""
    folder = work_folder(tmp_path / "work", "source")
    monkeypatch.setattr(os, "fstat", lambda own: os.stat_result(range(10)))  # user 4
    with pytest.raises(FileExistsError, match="work: belongs to another user; move it, or choose another output"):
        work_folder(folder, "source")


def test_a_seal_moves_with_its_folder_and_is_not_copied(tmp_path):
    work_folder(tmp_path / "one", "source")
    shutil.copytree(tmp_path / "one", tmp_path / "copy")
    os.rename(tmp_path / "one", tmp_path / "two")
    assert read_sealed(tmp_path / "two" / SOURCE) == "source"
    assert read_sealed(tmp_path / "copy" / SOURCE) is None


def test_a_seal_is_a_plain_file(tmp_path):
    work_folder(tmp_path / "one", "source")
    os.rename(tmp_path / "one" / SOURCE, tmp_path / "elsewhere.txt")
    (tmp_path / "one" / SOURCE).symlink_to(tmp_path / "elsewhere.txt")
    assert read_sealed(tmp_path / "one" / SOURCE) is None
    (tmp_path / "one" / SOURCE).unlink()
    os.mkfifo(tmp_path / "one" / SOURCE)
    assert read_sealed(tmp_path / "one" / SOURCE) is None


def test_a_writer_that_works_is_not_in_the_way(tmp_path):
    with atomic_write(tmp_path / "marker.txt") as partial:
        partial.write_text("half")
        write_sealed(tmp_path / "marker.txt", "whole")
        assert read_sealed(tmp_path / "marker.txt") == "whole"
