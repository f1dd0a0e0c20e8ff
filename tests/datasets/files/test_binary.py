"""Files in archives and in folders."""

import pickle
import zipfile

import pytest

from torchjoint.datasets.files.binary import Members

CONTENT = {"a": b"stored", "b/c": bytes(1000), "b/d": b""}


@pytest.fixture
def archive(tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in CONTENT.items():
            kind = zipfile.ZIP_DEFLATED if name == "b/c" else zipfile.ZIP_STORED
            archive.writestr(zipfile.ZipInfo(name), data, kind)
    return path


def test_archives_and_folders_read_the_same(archive, tmp_path):
    with zipfile.ZipFile(archive) as whole:
        whole.extractall(tmp_path / "folder")
    before = tmp_path / "behind.zip"
    before.write_bytes(b"a program" + archive.read_bytes())
    for path in (archive, tmp_path / "folder", before):
        files = pickle.loads(pickle.dumps(Members(path)))
        assert {name: files.read(name, 1000) for name in files.names} == CONTENT


def test_a_file_that_is_there_twice(archive):
    with zipfile.ZipFile(archive, "a") as opened, pytest.warns(UserWarning, match="Duplicate name"):
        opened.writestr("a", b"another")
    with pytest.raises(ValueError, match=r"a\.zip: not a whole archive: file 'a' is there twice"):
        Members(archive)


def test_large_and_missing_files(archive, tmp_path):
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "c").write_bytes(bytes(1000))
    for path in (archive, tmp_path):
        with pytest.raises(ValueError, match=r"b/c: expected at most 999 bytes( of a part of .*)?, got 1000"):
            Members(path).read("b/c", 999)
        with pytest.raises(ValueError, match=r"\.\./x is missing"):
            Members(path).read("../x", 999)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"stored", b"Stored"),  # another checksum
        (b"PK\1\2\x14\3\x14\0\0\0\0\0", b"PK\1\2\x14\3\x14\0\0\0\x63\0"),  # method 99: encrypted
    ],
)
def test_a_damaged_file_is_not_read(archive, old, new):
    data = archive.read_bytes()
    assert old in data
    archive.write_bytes(data.replace(old, new))
    with pytest.raises(ValueError, match=r"a\.zip: a in it is damaged: "):
        Members(archive).read("a", 10)


def test_a_bomb_is_bounded_by_what_it_declares(archive):
    """The unpacked size of the directory is made smaller than what comes out."""
    data = archive.read_bytes()
    archive.write_bytes(data.replace((1000).to_bytes(4, "little"), (10).to_bytes(4, "little")))
    with pytest.raises(ValueError, match="its size or checksum is another one"):
        Members(archive).read("b/c", 100)


def test_no_archive(tmp_path):
    (tmp_path / "a.zip").write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"a\.zip: not a whole archive"):
        Members(tmp_path / "a.zip")
