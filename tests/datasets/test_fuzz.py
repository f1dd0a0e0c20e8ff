"""Bytes of every format's sample are cut, flipped, and numbers made huge: only clear errors come out."""

from pathlib import Path

import pytest
import samples
from damage import CLEAR, TOLD, damages

import torchjoint as tj

DAMAGES = 12  # `make fuzz` makes more


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


@pytest.mark.parametrize("name", samples.FORMATS)
def test_a_sample_is_read(name, tmp_path):
    scene = read_all(samples.write(name, tmp_path / "sample"))
    assert len(scene.points) > 0
    assert (len(scene.frames) == 0) == (samples.format_of(name) in samples.WITHOUT_IMAGES)


@pytest.mark.parametrize("name", samples.FORMATS)
def test_the_format_is_detected(name, tmp_path):
    path = samples.write(name, tmp_path / "sample")
    assert next(one for one, module in tj.datasets.FORMATS.items() if module.recognizes(path)) == samples.format_of(
        name
    )


@pytest.mark.filterwarnings(f"ignore:{TOLD}")
@pytest.mark.filterwarnings("ignore:.*(not in metadata.yaml|are no CLASS_N.txt)")
@pytest.mark.parametrize("name", samples.FORMATS)
def test_files_that_macos_adds_are_no_frames(name, tmp_path):
    path = samples.write(name, tmp_path / "sample")
    names = [frame.name for frame in _read_all(path).frames]
    for file in sorted((tmp_path / "sample").rglob("*")):
        file.with_name(f"._{file.name}").write_bytes(b"\0\5\x16\7\0\2\0\0Mac OS X")
    assert [frame.name for frame in _read_all(path).frames] == names


@pytest.mark.parametrize("name", samples.FORMATS)
def test_damaged_files_give_clear_errors(name, tmp_path):
    path = samples.write(name, tmp_path / "sample")
    assert read_all(path) is not None
    count = sum(file.is_file() for file in (tmp_path / "sample").rglob("*"))
    for _ in damages(tmp_path / "sample", max(4, DAMAGES // count)):
        read_all(path)
    assert read_all(path) is not None


@pytest.mark.filterwarnings(f"ignore:{TOLD}")
@pytest.mark.filterwarnings("ignore:.*frames have no depth image")
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


def test_every_format_is_in_the_documents():
    page, readme = (
        (Path(__file__).parents[2] / name).read_text("utf-8") for name in ("docs/your_data.md", "README.md")
    )
    rows = page.partition("<!-- formats -->\n")[2].partition("<!-- end formats -->")[0].strip().splitlines()[2:]
    assert len(rows) == len(tj.datasets.FORMATS)
    named = " ".join(readme.partition("## Data")[2].partition("##")[0].split())
    assert [name for name in (row.split("|")[1].strip() for row in rows) if name not in named] == []
