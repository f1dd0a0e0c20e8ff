"""Corrections of two programs at once: nothing is lost, and none lands on another result."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import torchjoint as tj
from torchjoint.results.edits import FILE, Edit, Edits, read_edits, write_edits
from torchjoint.results.folder import write_result
from torchjoint.results.parts import Parts
from torchjoint.results.shared_edits import merged_steps, save_edits
from torchjoint.runtime.outputs import BusyError, lock

A, B, C, D = (Edit("name", (0,), name) for name in "abcd")


@pytest.fixture
def out(scene_of, tmp_path):
    return written(scene_of(3).scene, tmp_path / "out")


def written(scene: tj.Scene, folder: Path) -> Path:
    folder.mkdir()
    result = tj.Segmentation(torch.arange(len(scene.points)) % 5, ())
    write_result(folder, replace(scene, frames=()), result, tj.Config(), "test")
    return folder


def opened(folder: Path) -> tuple[Parts, Edits]:
    parts = Parts(tj.load_result(folder, edits=False))
    return parts, read_edits(folder, parts.count)


@pytest.mark.parametrize(
    ("before", "theirs", "own", "merged"),
    [
        ((), (), (), ()),
        ((A,), (A, B), (A, C), (A, B, C)),
        ((A, B), (A,), (A, B, C), (A, C)),  # they have undone b
        ((A, B), (A, B, C), (A,), (A, C)),  # this one has undone b
        ((A, B), (A,), (), ()),
        ((A,), (A, B, C), (A, B, D), (A, B, C, D)),  # both have done b
        ((A,), (B,), (A,), (B,)),
        ((A, B, C), (A, C), (A, B), (A,)),  # each has undone another one
        ((A,), (A, A), (), (A,)),  # they have done the same once more
    ],
)
def test_what_two_make_of_the_same_corrections(before, theirs, own, merged):
    assert merged_steps(before, theirs, own) == merged


def test_the_later_one_keeps_what_the_earlier_one_saved(out):
    parts, before = opened(out)
    first, second = (replace(before, steps=(step,)) for step in (A, Edit("join", (1, 2))))
    save_edits(out, first, before, parts)
    saved = save_edits(out, second, before, parts)
    assert saved.steps == (A, *second.steps)
    assert opened(out)[1] == saved
    assert save_edits(out, replace(saved, steps=saved.steps[:-1]), saved, parts).steps == (A,)
    assert sorted(path.name for path in out.iterdir() if "edits" in path.name) == [FILE]


def test_a_file_that_was_moved_away_has_undone_nothing(out):
    parts, before = opened(out)
    saved = save_edits(out, replace(before, steps=(A,)), before, parts)
    (out / FILE).unlink()
    assert save_edits(out, replace(saved, steps=(A, B)), saved, parts).steps == (A, B)


def test_corrections_that_exclude_each_other(out):
    parts, before = opened(out)
    save_edits(out, replace(before, steps=(A,)), before, parts)
    with pytest.raises(ValueError, match=r"edits\.json: expected corrections that go with those that others have"):
        save_edits(out, replace(before, steps=(Edit("split", (0,)),)), before, parts)
    assert opened(out)[1].steps == (A,)


def test_names_at_many_levels_take_no_square_of_time(out):
    """At each level all corrections are applied: a megabyte took an hour."""
    parts, edits = opened(out)
    steps = tuple(Edit("name", (0,), "a", number / 2000) for number in range(2000))
    write_edits(out, replace(edits, steps=steps))
    with pytest.raises(ValueError, match=r"edits\.json: .*expected at most \d+ corrections times levels of names"):
        tj.load_result(out)
    write_edits(out, replace(edits, steps=steps[:500]))
    assert len(read_edits(out, parts.count).steps) == 500


def test_only_one_saves_at_a_time(out, monkeypatch):
    monkeypatch.setattr("torchjoint.results.shared_edits.PATIENCE", 0.0)
    parts, before = opened(out)
    with lock(out / f".{FILE}.lock", "busy"), pytest.raises(BusyError, match=r"edits\.json: another program is saving"):
        save_edits(out, before, before, parts)


def test_who_saves_waits_for_another_who_saves(out):
    """Else what the viewer could not save at this moment was saved only with the next correction."""
    parts, before = opened(out)
    with ThreadPoolExecutor() as pool:
        with lock(out / f".{FILE}.lock", "busy"):
            saved = pool.submit(save_edits, out, replace(before, steps=(A,)), before, parts)
            time.sleep(0.2)
            assert not (out / FILE).exists()
        assert saved.result().steps == opened(out)[1].steps == (A,)


def test_corrections_of_the_same_cloud_in_another_order(scene_of, out, tmp_path):
    """It has as many superpoints, but they are others."""
    scene = scene_of(3).scene
    other = written(scene.select_points(torch.arange(len(scene.points)).flip(0)), tmp_path / "other")
    parts, before = opened(out)
    saved = save_edits(out, replace(before, steps=(A,)), before, parts)
    assert opened(other)[0].count == parts.count
    shutil.copy(out / FILE, other)
    for read in (lambda: opened(other), lambda: tj.load_result(other)):
        with pytest.raises(ValueError, match=r"edits\.json: expected edits of this result, got those of another"):
            read()
    (other / FILE).unlink()
    with pytest.raises(ValueError, match="expected the result that was opened, got another"):
        save_edits(other, saved, saved, parts)
    assert not (other / FILE).exists()


def test_a_file_that_does_not_say_its_result_is_still_read(out):
    parts, before = opened(out)
    write_edits(out, Edits(parts.count, None, (A,)))
    assert opened(out)[1] == replace(before, steps=(A,))


SAVING = """
import sys
from dataclasses import replace
from pathlib import Path
import torchjoint as tj
from torchjoint.results.edits import Edit, read_edits
from torchjoint.results.parts import Parts
from torchjoint.results.shared_edits import save_edits
folder = Path(sys.argv[1])
parts = Parts(tj.load_result(folder, edits=False))
edits = read_edits(folder, parts.count)
while True:
    names = (*edits.steps, Edit("name", (0,), str(len(edits.steps))))
    edits = save_edits(folder, replace(edits, steps=names), edits, parts)
    print(len(edits.steps), flush=True)
"""


@pytest.mark.parametrize("seconds", [pytest.param(0.003, marks=pytest.mark.slow), 0.011])
def test_what_was_saved_survives_a_kill(out, seconds):
    """The viewer saves in this way. Who is killed while it saves loses no more than what it was saving."""
    saving = subprocess.Popen([sys.executable, "-c", SAVING, str(out)], stdout=subprocess.PIPE, text=True)
    told = saving.stdout.readline()
    time.sleep(seconds)
    saving.kill()
    told = (told + saving.communicate()[0]).split()
    steps = opened(out)[1].steps
    assert len(steps) >= int(told[-1])
    assert [step.name for step in steps] == [str(number) for number in range(len(steps))]
    assert tj.load_result(out).segment_names[0] == str(len(steps) - 1)
