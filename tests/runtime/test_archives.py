"""Archives of arrays: no more memory than the file is worth."""

import io
import tracemalloc
import warnings
import zipfile
from contextlib import suppress

import numpy as np
import pytest

from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.runtime.archives import read_archive, read_npy


def declared(path, shape, content=b""):
    """An archive with an array whose header declares a shape."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("points.npy", "w") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f4", "fortran_order": False, "shape": shape})
        stream.write(content)
    return path


def test_what_numpy_writes(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(5), "c": np.asfortranarray(np.eye(3))}
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    read = read_archive(tmp_path / "a.npz")
    assert set(read) == set(arrays)
    assert all(np.array_equal(read[name], arrays[name]) and read[name].dtype == arrays[name].dtype for name in arrays)


def test_an_array_that_declares_more_than_there_is(tmp_path):
    path = declared(tmp_path / "a.npz", (10**9, 3))
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"a\.npz.*expected a shape that fits the file, got \[1000000000, 3\]"):
        read_cloud_file(path)
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


def test_an_archive_that_inflates(tmp_path, monkeypatch):
    monkeypatch.setattr("torchjoint.runtime.bounds.FREE", 0)
    path = declared(tmp_path / "a.npz", (100_000, 3), bytes(1_200_000))
    with pytest.raises(ValueError, match=r"expected at most \d+ bytes when \d+ bytes are unpacked, got 1200128"):
        read_archive(path)


@pytest.mark.parametrize("header", [b"{'descr': (", b"{'descr': '<f4', 'shape': (1,}", b"[" * 200, b"\xff"])
def test_headers_that_are_no_dictionary(tmp_path, header):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + bytes([len(header), 0]) + header)
    with pytest.raises(ValueError, match=r"a\.npz: not a whole archive of arrays"):
        read_archive(tmp_path / "a.npz")


def test_objects_are_not_read(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.array([{}], dtype=object))
    with pytest.raises(ValueError, match=r"a\.npz: .*expected numbers, or texts .*, got dtype object"):
        read_archive(tmp_path / "a.npz")


@pytest.mark.parametrize("at", [28, 30, 32])  # the lengths of the name, of more fields, of a comment
def test_a_directory_that_hides_an_array(tmp_path, at):
    np.savez(tmp_path / "a.npz", points=np.zeros((2, 3)), colors=np.ones((2, 3)))
    content = bytearray((tmp_path / "a.npz").read_bytes())
    content[content.index(b"PK\x01\x02") + at] ^= 64
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.npz: not a whole archive of arrays"):
        read_archive(tmp_path / "a.npz")


@pytest.mark.parametrize("names", [("points.npy", "points.npy"), ("points", "points.npy")])
@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_arrays_of_one_name(tmp_path, names):
    content = io.BytesIO()
    np.save(content, np.zeros((4, 3)))
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for name in names:
            archive.writestr(name, content.getvalue())
    with pytest.raises(ValueError, match=r"a\.npz: .* array 'points' is there twice"):
        read_archive(tmp_path / "a.npz")


def test_a_thread_that_reads_hides_no_warning_of_another(tmp_path, monkeypatch):
    """All were ignored, also after several threads had read arrays, and for good."""
    np.save(tmp_path / "a.npy", np.zeros((9, 3)))

    def read(*_, **__):
        warnings.warn("of another thread", stacklevel=1)
        return np.zeros(3)

    monkeypatch.setattr(np.lib.format, "read_array", read)
    with suppress(ValueError), pytest.warns(UserWarning, match="another"):
        read_npy(tmp_path / "a.npy")
