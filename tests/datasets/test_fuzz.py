"""Bytes of every format's sample are cut, flipped, and numbers made huge: only clear errors come out."""

import re
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import samples

import torchjoint as tj

#: A clear error of a file that cannot be read is one of these, and names the file or the argument.
CLEAR = (ValueError, FileNotFoundError, TypeError)
DAMAGES = 40


def read_all(path):
    """Everything a scene has, lazy or not; None after a clear error."""
    try:
        return _read_all(path)
    except CLEAR as error:
        message = str(error)
    assert len(message) > 10, message
    return None


def _read_all(path):
    scene = tj.load_scene(path)
    for frame in scene.frames:
        assert frame.image.ndim == 3
    if scene.truth is not None:
        for labels in scene.truth.images:
            assert labels.ndim == 2
    return scene


def damage(data, rng):
    """One way of many to spoil a file's bytes."""
    kind, place = rng.integers(5), int(rng.integers(max(len(data), 1)))
    if kind == 0:
        return data[:place]
    if kind == 1:
        return data[:place] + data[place + 1 :]
    if kind == 2:  # a number somewhere becomes huge, or negative
        huge = struct.pack("<Q", [0xFFFFFFFFFFFFFFFF, 0x7FFFFFFF, 1 << 40, 1 << 62][rng.integers(4)])
        return data[:place] + huge[: 4 if rng.integers(2) else 8] + data[place + 8 :]
    if kind == 3:  # digits of text become huge
        numbers = list(re.finditer(rb"\d+", data))
        if numbers:
            chosen = numbers[rng.integers(len(numbers))]
            return data[: chosen.start()] + b"999999999999" + data[chosen.end() :]
    spoiled = bytearray(data)
    for _ in range(1 + int(rng.integers(8))):
        if spoiled:
            spoiled[rng.integers(len(spoiled))] ^= 1 << rng.integers(8)
    return bytes(spoiled)


def damages(folder, times, seed=0):
    """Spoils every file below a folder in turn, so many times; the caller reads in between, warnings being errors."""
    rng = np.random.default_rng(seed)
    for file in sorted(file for file in folder.rglob("*") if file.is_file()):
        whole = file.read_bytes()
        for _ in range(times):
            file.write_bytes(damage(whole, rng))
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # an odd byte is no reason to print something either
                yield file
        file.write_bytes(whole)


@pytest.mark.parametrize("name", samples.FORMATS)
def test_a_sample_is_read(name, tmp_path):
    scene = read_all(samples.write(name, tmp_path / "sample"))
    assert len(scene.points) > 0
    assert len(scene.frames) > 0


@pytest.mark.parametrize("name", samples.FORMATS)
def test_the_format_is_detected(name, tmp_path):
    path = samples.write(name, tmp_path / "sample")
    assert next(one for one, module in tj.datasets.FORMATS.items() if module.recognizes(path)) == samples.format_of(
        name
    )


@pytest.mark.parametrize("name", samples.FORMATS)
def test_damaged_files_give_clear_errors(name, tmp_path):
    path = samples.write(name, tmp_path / "sample")
    assert read_all(path) is not None
    count = sum(file.is_file() for file in (tmp_path / "sample").rglob("*"))
    for _ in damages(tmp_path / "sample", max(8, DAMAGES // count)):
        read_all(path)
    assert read_all(path) is not None


@pytest.mark.parametrize("name", samples.FORMATS)
def test_missing_files_give_clear_errors(name, tmp_path):
    path = samples.write(name, tmp_path / "sample")
    for file in sorted(file for file in (tmp_path / "sample").rglob("*") if file.is_file()):
        whole = file.read_bytes()
        file.unlink()
        read_all(path)
        file.write_bytes(whole)
    assert read_all(path) is not None


def test_every_format_has_a_sample():
    assert {samples.format_of(name) for name in samples.FORMATS} == set(tj.datasets.FORMATS)


def test_every_format_is_in_the_readme():
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    table = readme.partition("<!-- formats -->")[2].partition("<!-- end formats -->")[0]
    assert len(table.strip().splitlines()) - 2 == len(tj.datasets.FORMATS)
