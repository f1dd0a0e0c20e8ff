import zlib

import pytest

from torchjoint.runtime.foreign_files import damage_is, parse_json, present


def test_a_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"one: missing; expected a cloud"):
        present(tmp_path / "one", "a cloud")
    (tmp_path / "one").touch()
    assert present(tmp_path / "one", "a cloud") == tmp_path / "one"


@pytest.mark.parametrize("error", [ValueError("so"), zlib.error("so"), UnicodeError("so"), RecursionError("so")])
def test_what_damaged_bytes_raise(error):
    with pytest.raises(ValueError, match=r"^a\.npz: not whole: so$"), damage_is("a.npz: not whole"):
        raise error


@pytest.mark.parametrize("error", [OSError("disk"), MemoryError(), ModuleNotFoundError("lzfse"), KeyboardInterrupt()])
def test_other_errors_stay(error):
    with pytest.raises(type(error)) as caught, damage_is("a.npz: not whole"):
        raise error
    assert caught.value is error


def test_one_more_kind():
    with pytest.raises(ValueError, match=r"^a\.npz: not whole: disk$"), damage_is("a.npz: not whole", OSError):
        raise OSError("disk")


def test_a_name_that_is_there_twice_in_an_object():
    """Only the last of its values would be read."""
    assert parse_json(b'{"a": {"b": 1}, "c": [{"b": 2}]}', "it") == {"a": {"b": 1}, "c": [{"b": 2}]}
    with pytest.raises(ValueError, match=r"^it: not a whole JSON file: name 'fl_x' is there twice"):
        parse_json(b'{"frames": [{"fl_x": 1, "fl_y": 2, "fl_x": 3}]}', "it")
