"""The viewer's page as an object: two of them on one result, and the end of a program that opened one."""

import shutil
import subprocess
import sys
import threading
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import torchjoint as tj
from torchjoint.results.edits import Edit, read_edits
from torchjoint.viewer.shown import Shown

pytest.importorskip("viser", reason="the viewer needs viser: pip install 'torchjoint[viewer]'")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")


def opened(folder, port):
    from torchjoint.viewer.app import Viewer

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return Viewer(tj.load_result(folder, edits=False), Shown(folder), port=port)


def test_of_two_pages_the_later_save_keeps_the_earlier_one_s(out, tmp_path):
    folder = shutil.copytree(out, tmp_path / "out")
    one, other = opened(folder, 8990), opened(folder, 8990)
    steps = Edit("name", (0,), "sofa"), Edit("name", (1,), "lamp")
    for viewer, step in ((one, steps[0]), (other, steps[1])):
        viewer.model.select((int(viewer.model.table[step.superpoints[0]]),))
        viewer.model.name(step.name)
        viewer._on_save()
    saved = read_edits(folder, one.model.parts.count)
    assert [step.name for step in saved.steps] == ["sofa", "lamp"]
    assert set(other.model.names.values()) >= {"lamp"}
    assert other.model.edits == saved
    one._on_save()  # it has nothing new, and shows what the other one has saved
    assert one.model.edits == saved
    for viewer in (one, other):
        viewer.stop()


def test_corrections_are_saved_as_they_are_made(out, tmp_path, monkeypatch):
    from torchjoint.viewer import app

    folder = shutil.copytree(out, tmp_path / "out")
    viewer = opened(folder, 8990)
    count = viewer.model.parts.count
    viewer._guarded(viewer._change, lambda: viewer.model.set_granularity(0.7))
    assert not (folder / "edits.json").exists()  # to look at a level corrects nothing
    viewer.model.select((int(viewer.model.table[0]),))
    viewer._guarded(viewer._change, lambda: viewer.model.name("sofa"))
    assert [step.name for step in read_edits(folder, count).steps] == ["sofa"]
    assert read_edits(folder, count).granularity == 0.7
    viewer._guarded(viewer._change, viewer.model.undo)
    assert read_edits(folder, count).steps == ()
    told, saved = [], app.save_edits
    monkeypatch.setattr(viewer, "_say", lambda text, color="green": told.append(text))
    monkeypatch.setattr(app, "save_edits", lambda *_: (_ for _ in ()).throw(PermissionError("read-only")))
    viewer._guarded(viewer._change, lambda: viewer.model.name("chair"))
    viewer._guarded(lambda: None)  # such as a movement of the camera
    assert told == ["read-only"]
    monkeypatch.setattr(app, "save_edits", saved)
    viewer._guarded(viewer._change, lambda: viewer.model.name("stool"))
    assert [step.name for step in read_edits(folder, count).steps] == ["stool"]
    viewer._can_save = False  # what is shown is not what is in the folder
    viewer._guarded(viewer._change, lambda: viewer.model.name("lamp"))
    assert [step.name for step in read_edits(folder, count).steps] == ["stool"]
    viewer.stop()


def test_what_is_typed_while_a_name_is_saved_stays(out, tmp_path, monkeypatch):
    viewer = opened(shutil.copytree(out, tmp_path / "out"), 8990)
    viewer.model.select((int(viewer.model.table[0]),))
    field, named = viewer._panel.name, viewer.model.name
    monkeypatch.setattr(viewer.model, "name", lambda name: (named(name), setattr(field._impl, "value", f"{name}er")))
    field.value = "lock"  # which calls viewer._on_name
    assert (field.value, *viewer.model.names.values()) == ("locker", "lock")
    monkeypatch.undo()
    field.value = 201 * "x"  # too long
    assert field.value == "lock"
    viewer.stop()


def test_a_page_that_ends_has_no_thread_at_work(out):
    viewer = opened(out, 8990)
    (worker,) = viewer._workers
    viewer.stop()
    assert not worker.is_alive()
    assert worker not in threading.enumerate()


def test_a_survey_is_as_exact_as_a_room(out):
    """The page has float32: its points stood in steps of a quarter of a metre."""
    from torchjoint.viewer.app import Viewer

    result = tj.load_result(out)
    points = result.scene.points.double() + torch.tensor([500_000.0, 4_000_000.0, 100.0])
    viewer = Viewer(replace(result, scene=replace(result.scene, points=points, frames=())), port=8990)
    (part, *_), handle = viewer._cloud._parts, viewer._cloud._handles[0]
    shown = handle.points.astype(np.float64) + handle.position
    viewer.stop()
    assert np.abs(shown - points.numpy()[part]).max() < 1e-3


PROGRAM = """
import sys, time, threading
import torchjoint as tj
from torchjoint.results.parts import Parts
from torchjoint.viewer.app import Viewer

image, started = Parts.image, threading.Event()
def slow(*arguments):
    started.set()
    time.sleep(0.2)  # the thread is at work when the program ends
    return image(*arguments)
Parts.image = slow
viewer = Viewer(tj.load_result(sys.argv[1], edits=False), port=8995)
assert started.wait(60)
print("end", flush=True)
"""


def test_a_program_that_opened_a_page_ends(out):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(out)], capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stdout.splitlines()[0]) == (0, "end"), done.stderr
    assert "Traceback" not in done.stderr


def test_a_click_at_the_edge_of_the_photo_stays_at_that_edge(out, monkeypatch):
    viewer = opened(out, 8990)
    superpoints, chosen = np.full((4, 6), -1), []
    superpoints[0, 0] = 3
    monkeypatch.setattr(type(viewer.model.parts), "image", lambda *_: superpoints)
    monkeypatch.setattr(viewer, "_on_point", lambda point, _: chosen.append(point))
    for place in ("-1 -1", "-9 0", "5 3", "99 99", f"{10**30} 0"):
        viewer._panel.bridge = SimpleNamespace(value=f"torchjoint:image {place} 0 1")
        viewer._on_event(None)
    middle = viewer.model.parts.middle(3)
    assert chosen == [middle, middle, None, None, None]
    viewer.stop()
