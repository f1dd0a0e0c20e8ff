"""A dead link, a pipe or a device in the place of any file of any format: an error, and never another recording."""

import os
import warnings
from contextlib import suppress
from pathlib import Path

import pytest
import samples
import traps

import torchjoint as tj
from torchjoint.datasets import recording
from torchjoint.datasets.files.readers import fingerprint
from torchjoint.runtime import bounds

CLEAR = (ValueError, FileNotFoundError, TypeError)


@pytest.mark.parametrize("trap", traps.TRAPS)
@pytest.mark.parametrize("name", samples.FORMATS)
def test_a_trap_in_the_place_of_any_file(name, trap, tmp_path, monkeypatch):
    monkeypatch.setenv("TORCHJOINT_CACHE", "")
    path = samples.write(name, tmp_path / "sample")
    whole = traps.content_of(path)
    wrong = []
    for file in sorted(file for file in (tmp_path / "sample").rglob("*") if file.is_file()):
        with traps.trapped(file, trap), traps.ends(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with suppress(*CLEAR):
                wrong += [] if traps.same(traps.content_of(path), whole) else [file.name]
    assert wrong == []
    assert traps.same(traps.content_of(path), whole)


def test_a_folder_that_is_a_dead_link(tmp_path):
    path = samples.write("scannet_exported", tmp_path / "sample")
    depth = next(one for one in (tmp_path / "sample").rglob("depth") if one.is_dir())
    depth.rename(tmp_path / "away")
    depth.symlink_to(tmp_path / "lost")
    with pytest.raises(ValueError, match=r"cannot be read: .*depth is a link to .*lost, which is not there"):
        traps.content_of(path)


@pytest.mark.parametrize("name", ["folder", "scannet", "scannetpp", "s3dis", "organized_pcd"])
def test_a_lost_scene_hides_no_other(name, tmp_path):
    path = samples.write(name, tmp_path / "set" / ("scans" if name == "scannet" else "1"))
    lost = path.parent / f"lost{path.suffix}"
    lost.symlink_to(tmp_path / "away")
    top = path.parent.parent if name in ("scannet", "scannetpp") else path.parent
    assert sorted(tj.datasets.list_scenes(top).values()) == sorted([lost, path])
    with pytest.raises(ValueError, match=r"lost.* cannot be read: .* is a link to .*away, which is not there"):
        tj.load_scene(lost)


def test_a_closed_folder_hides_no_scene(tmp_path, monkeypatch):
    path = samples.write("folder", tmp_path / "set" / "1")
    (closed := path.with_name("closed")).mkdir()

    def names(folder, iterdir=Path.iterdir):  # root may read everything
        if folder == closed:
            raise PermissionError(13, "Permission denied", str(folder))
        return iterdir(folder)

    monkeypatch.setattr(Path, "iterdir", names)
    assert sorted(tj.datasets.list_scenes(path.parent).values()) == sorted([closed, path])


def test_a_cloud_that_comes_while_one_is_fused_stays(tmp_path, monkeypatch):
    path, cloud = samples.write("folder", tmp_path / "sample"), tmp_path / "fused.ply"
    (path / "cloud.ply").unlink()
    fuse = recording.fuse_or_recall
    monkeypatch.setattr(recording, "fuse_or_recall", lambda *a: (cloud.write_text("mine"), fuse(*a))[1])
    with pytest.raises(FileExistsError, match=r"fused.ply: was made or changed while this run worked"):
        tj.load_scene(path, cloud=cloud)
    assert cloud.read_text() == "mine"


def test_the_message_names_the_link(tmp_path):
    path = samples.write("folder", tmp_path / "sample")
    (path / "cloud.ply").unlink(missing_ok=True)
    (path / "cloud.ply").symlink_to(tmp_path / "lost.ply")
    with pytest.raises(ValueError, match=r"cannot be read: .*cloud\.ply is a link to .*lost\.ply, which"):
        tj.load_scene(path)


class TestFingerprint:
    def test_a_link_to_a_folder_around_it_is_not_followed(self, tmp_path):
        path = samples.write("folder", tmp_path / "sample")
        before = fingerprint(path)
        (path / "up").symlink_to("/")
        with traps.ends():
            assert fingerprint(path) == before

    def test_a_link_to_many_files(self, tmp_path, monkeypatch):
        (tmp_path / "many").mkdir()
        for number in range(30):
            (tmp_path / "many" / f"{number}").touch()
        (tmp_path / "scan").mkdir()
        (tmp_path / "scan" / "link").symlink_to(tmp_path / "many")
        fingerprint(tmp_path / "scan")
        monkeypatch.setattr(bounds, "FILES", 20)
        with pytest.raises(ValueError, match=r"scan: expected at most 20 files below it \(does a link lead out"):
            fingerprint(tmp_path / "scan")

    def test_a_dead_link_that_comes_alive_is_a_change(self, tmp_path):
        (tmp_path / "scan").mkdir()
        (tmp_path / "scan" / "cloud.ply").symlink_to(tmp_path / "lost.ply")
        os.mkfifo(tmp_path / "scan" / "pipe")
        with traps.ends():
            before = fingerprint(tmp_path / "scan")
            (tmp_path / "lost.ply").write_text("ply")
            assert fingerprint(tmp_path / "scan") != before
