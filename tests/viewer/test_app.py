"""The viewer's page as an object: two of them on one result, and the end of a program that opened one."""

import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
import weakref
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import torchjoint as tj
from torchjoint.results.edits import Edit, read_edits
from torchjoint.results.shared_edits import save_edits
from torchjoint.viewer.shown import Shown

viser = pytest.importorskip("viser", reason="the viewer needs viser: pip install 'torchjoint[viewer]'")
from msgspec import msgpack  # noqa: E402 (packages that viser needs)
from websockets.sync.client import connect  # noqa: E402

from torchjoint.viewer import app, live  # noqa: E402
from torchjoint.viewer.server import FairLock, Page, _end  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")


def opened(folder, port):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return app.Viewer(tj.load_result(folder, edits=False), Shown(folder), page=Page(port=port))


def test_of_two_pages_the_later_save_keeps_the_earlier_one_s(out, tmp_path):
    folder = shutil.copytree(out, tmp_path / "out")
    one, other = opened(folder, 8990), opened(folder, 8990)
    steps = Edit("name", (0,), "sofa"), Edit("name", (1,), "lamp")
    for viewer, step in ((one, steps[0]), (other, steps[1])):
        with viewer._lock:  # what works in the background saves, too
            viewer.model.select((int(viewer.model.table[step.superpoints[0]]),))
            viewer.model.name(step.name)
            viewer._on_save()
    saved = read_edits(folder, one.model.parts.count)
    assert [step.name for step in saved.steps] == ["sofa", "lamp"]
    assert set(other.model.names.values()) >= {"lamp"}
    assert other.model.edits == saved
    one._on_save()  # it has nothing new, and shows what the other one has saved
    assert one.model.edits == saved
    for viewer, times in ((other, 2), (one, 1)):
        for _ in range(times):
            viewer._guarded(viewer.model.undo)
    one.model.select((int(one.model.table[0]),))
    one._guarded(one.model.name, "sofa")  # again, as before it was told that the other one has undone it
    assert read_edits(folder, one.model.parts.count).steps == one.model.edits.steps == saved.steps[:1]
    for viewer in (one, other):
        viewer.stop()


def test_a_page_is_there_before_the_labels(scene_of, monkeypatch):
    scene, found, segmenter = scene_of(3, num_points=6000).scene, [], tj.JointSegmenter()
    labels_so_far = live.labels_so_far
    monkeypatch.setattr(live, "labels_so_far", lambda *of_run: (found.append("labels"), labels_so_far(*of_run))[1])
    view = live.LiveView(lambda: Page(lambda url: found.append("page"), port=8990))
    for _ in segmenter.steps(scene, batch_size=6):
        view(segmenter, scene)
        assert view.viewer.result.num_point_segments > 1
    assert found[:2] == ["page", "labels"]
    view.viewer.stop()


def test_corrections_are_saved_as_they_are_made(out, tmp_path, monkeypatch):
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
    monkeypatch.setattr(viewer, "_draw", lambda: (_ for _ in ()).throw(ValueError("damaged image")))
    viewer._guarded(viewer._change, lambda: viewer.model.name("couch"))
    assert [step.name for step in read_edits(folder, count).steps] == ["couch"]
    assert told[-1] == "damaged image"
    viewer.stop()


def test_other_parameters_cannot_be_corrected(out, tmp_path):
    """Corrections of what `Compute again` shows were lost, also if it was computed with the parameters of OUT."""
    folder = shutil.copytree(out, tmp_path / "out")
    result = tj.load_result(folder, edits=False)
    run = SimpleNamespace(parameters={}, compute=lambda _: result)
    viewer = app.Viewer(result, Shown(folder, run), page=Page(port=8990))
    viewer.model.select((int(viewer.model.table[0]),))
    typed(viewer, "sofa")
    controls = [getattr(viewer._panel, name) for name in ("name", "correct", "save", "by_clicks")]
    assert all(one.visible for one in controls)
    viewer._guarded(viewer._on_parameters)
    assert [one.visible for one in (*controls, viewer._panel.keep)] == [False, False, False, True, False]
    controls[3].value = True
    assert not viewer._panel.keep.visible
    assert [step.name for step in read_edits(folder, viewer.model.parts.count).steps] == ["sofa"]
    assert viewer.not_kept() == ""
    viewer.stop()


def test_what_others_save_while_a_run_ends_is_kept(out, tmp_path, monkeypatch):
    """What came after the corrections were read, and before they were read again, counted as undone here."""
    folder = shutil.copytree(out, tmp_path / "out")
    result = tj.load_result(folder, edits=False)
    viewer = app.Viewer(result, Shown(is_running=True), page=Page(port=8990))
    viewer.model.select((int(viewer.model.table[0]),))
    typed(viewer, "sofa")
    theirs, take_names = Edit("join", (0, 1)), app.Model.take_names

    def saved_meanwhile(model, *arguments):
        save_edits(folder, replace(edits := read_edits(folder, model.parts.count), steps=(theirs,)), edits, model.parts)
        take_names(model, *arguments)

    monkeypatch.setattr(app.Model, "take_names", saved_meanwhile)
    viewer.replace(result, Shown(folder))
    viewer.stop()
    assert [step.kind for step in read_edits(folder, viewer.model.parts.count).steps] == ["join", "name"]


def typed(viewer, text, page=None):
    """As if a page told it."""
    viewer._panel.name._impl.value = text
    viewer._on_typed(SimpleNamespace(client=page or object()))


def test_names_of_a_run_are_saved_with_its_result(out, tmp_path):
    folder = shutil.copytree(out, tmp_path / "out")
    result = tj.load_result(folder, edits=False)
    viewer = app.Viewer(result, Shown(is_running=True), page=Page(port=8990))
    viewer.model.select((int(viewer.model.table[0]),))
    typed(viewer, "sofa\x1b[2J\x9b\t")  # what was pasted may control a terminal that prints a file with names
    viewer.replace(result, Shown(folder))  # of the same superpoints, as of method paper
    viewer.stop()
    assert [step.name for step in read_edits(folder, viewer.model.parts.count).steps] == ["sofa\\x1b[2J\\x9b\t"]


def test_a_click_in_the_table_of_an_earlier_result(out):
    """While a run went on, it chose what had the same id in the result that came meanwhile."""
    whole, order = tj.load_result(out, edits=False), np.random.default_rng(0).permutation
    result = tj.Result.of(tj.Segmentation(whole.points, ()), tj.Scene(whole.scene.points))
    viewer = app.Viewer(result, Shown(is_running=True), page=Page(port=8990))
    others = torch.from_numpy(order(result.num_point_segments))
    for row in re.findall(r'data-hue="(\d+)".*?</span>(\d+)', before := viewer._panel.table.content):
        viewer.replace(replace(result, points=others[result.points]))
        viewer._on_event(f"torchjoint:row {row[0]} 0 1", object())
        (lit,) = viewer.model.selected
        assert set(result.points[viewer.model.table[viewer.model.parts.of_point] == lit].tolist()) == {int(row[1])}
        others = torch.from_numpy(order(result.num_point_segments))
    assert viewer._panel.table.content != before
    viewer.stop()


def test_what_is_typed_while_a_name_is_saved_stays(out, tmp_path, monkeypatch):
    viewer = opened(shutil.copytree(out, tmp_path / "out"), 8990)
    viewer.model.select((int(viewer.model.table[0]),))
    field, named = viewer._panel.name, viewer.model.name
    monkeypatch.setattr(viewer.model, "name", lambda name: (named(name), setattr(field._impl, "value", f"{name}er")))
    typed(viewer, "lock")
    assert (field.value, *viewer.model.names.values()) == ("locker", "lock")
    monkeypatch.undo()
    typed(viewer, 201 * "x")  # too long
    assert field.value == "lock"
    viewer.stop()


def test_what_is_typed_while_another_action_works_stays(out, tmp_path):
    """Each growth of a live cloud emptied the field, and letters were lost."""
    viewer = opened(shutil.copytree(out, tmp_path / "out"), 8990)
    with ThreadPoolExecutor() as pool, viewer._lock:
        viewer.model.select((int(viewer.model.table[0]),))
        for text in ("l", "lock"):
            pool.submit(typed, viewer, text)
            time.sleep(0.1)
        viewer._draw()
        assert viewer._panel.name.value == "lock"
    assert (viewer._panel.name.value, *viewer.model.names.values()) == ("lock", "lock")
    viewer.stop()


def test_names_go_to_what_was_clicked_before_them(out, tmp_path):
    """Both got the later one, if both waited for another action, such as an export of many frames."""
    viewer = opened(shutil.copytree(out, tmp_path / "out"), 8990)
    names = dict(zip(np.unique(viewer.model.table).tolist(), ("sofa", "lamp"), strict=False))
    with ThreadPoolExecutor() as pool, viewer._lock:
        for segment, name in names.items():
            event = f"torchjoint:row {viewer.model.key(segment)} 0 {name}"
            for action in (partial(setattr, viewer._panel.bridge, "value", event), partial(typed, viewer, name)):
                pool.submit(action)
                time.sleep(0.1)
    viewer.stop()
    assert viewer.model.names == names


def test_what_a_page_does_goes_to_no_thing_of_another(out, tmp_path, monkeypatch):
    """Who typed "arm chair" while another page selected something else had half of it there."""
    viewer, pages = opened(shutil.copytree(out, tmp_path / "out"), 8990), (object(), object())
    mine, yours = np.unique(viewer.model.table)[:2].tolist()
    told = []
    monkeypatch.setattr(viewer, "_say", lambda text, color="green": told.append(text))
    viewer._on_event(f"torchjoint:row {viewer.model.key(mine)} 0 1", pages[0])
    typed(viewer, "arm ", pages[0])
    viewer._on_event(f"torchjoint:row {viewer.model.key(yours)} 0 2", pages[1])
    typed(viewer, "arm chair", pages[0])
    for action in ("Split", "Undo", "Keep"):
        viewer._guarded(viewer._on_correct, action, pages[0])
    leave, clients = viewer.server._client_disconnect_cb[-1], [{0: pages[0]}]
    monkeypatch.setattr(viewer.server, "get_clients", lambda: clients[0])
    leave(SimpleNamespace(client_id=1))
    typed(viewer, "arm chair", pages[0])
    assert viewer.model.names == {mine: "arm "}
    assert len(viewer.model.edits.steps) == 1
    assert len(told) == 5 == sum("another page has chosen" in one for one in told)
    typed(viewer, "sofa", pages[1])
    viewer._on_event(f"torchjoint:row {viewer.model.key(mine)} 0 3", pages[0])
    typed(viewer, "arm chair", pages[0])
    assert viewer.model.names == {mine: "arm chair", yours: "sofa"}
    viewer._guarded(viewer._on_level, 0.9, pages[1])  # other segments
    typed(viewer, "bed", pages[0])
    assert "bed" not in viewer.model.names.values()
    with ThreadPoolExecutor() as pool, viewer._lock:  # a page that is loaded again while an action works
        clients[0] = {}
        pool.submit(leave, SimpleNamespace(client_id=0))
        time.sleep(0.1)
        clients[0] = {1: object()}
    typed(viewer, "bed", object())
    assert "bed" in viewer.model.names.values()
    viewer._on_event(f"torchjoint:row {viewer.model.key(mine)} 0 4", pages[0])
    viewer._guarded(viewer._on_view, "Clear selection", pages[1])
    viewer._guarded(viewer._on_correct, "Undo", pages[0])
    assert told[-1] == told[0]
    viewer._guarded(viewer._on_correct, "Undo", pages[1])
    assert told[-1] == "undone: name 'bed'"
    viewer.stop()


def test_a_lock_is_given_in_the_order_of_those_who_ask():
    lock, came = FairLock(), []

    def work():
        with lock, lock:
            came.append("first")

    with ThreadPoolExecutor() as pool:
        with lock:
            pool.submit(work)
            time.sleep(0.1)
        with lock:
            came.append("second")
    assert came == ["first", "second"]


def test_a_page_that_ends_has_no_thread_at_work(out):
    viewer = opened(out, 8990)
    (worker,) = viewer.page._workers
    viewer.stop()
    assert not worker.is_alive()
    assert worker not in threading.enumerate()


def test_a_page_of_a_damaged_image_ends_no_thread(out, tmp_path, monkeypatch):
    """The terminal got a traceback of a thread, such as when a run replaced the result."""
    folder, raised = shutil.copytree(out, tmp_path / "out"), []
    monkeypatch.setattr(threading, "excepthook", lambda error: raised.append(error.exc_value))
    monkeypatch.setattr("torchjoint.viewer.app.Viewer._draw_image", lambda viewer: None)  # which would tell
    for image in (folder / "pieces").iterdir():
        image.write_bytes(b"")
    viewer = opened(folder, 8990)
    viewer.page._workers[-1].join()
    viewer.stop()
    assert raised == []


def test_a_survey_is_as_exact_as_a_room(out):
    """The page has float32: its points stood in steps of a quarter of a metre."""
    result = tj.load_result(out)
    points = result.scene.points.double() + torch.tensor([500_000.0, 4_000_000.0, 100.0])
    viewer = app.Viewer(replace(result, scene=replace(result.scene, points=points, frames=())), page=Page(port=8990))
    (part, *_), handle = viewer._cloud._parts, viewer._cloud._handles[0]
    shown = handle.points.astype(np.float64) + handle.position
    viewer.stop()
    assert np.abs(shown - points.numpy()[part]).max() < 1e-3


def test_ctrl_c_while_a_page_ends_does_not_abort():
    """An exception in the wait for a thread that computes let Python end before it: std::terminate."""
    code = """
import os, signal, time
from torchjoint.viewer.server import Page
page = Page(port=8996)
page.work(lambda: (time.sleep(0.5), os.kill(os.getpid(), signal.SIGINT), time.sleep(2)))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


PROGRAM = """
import sys, time, threading
import torchjoint as tj
from torchjoint.results.parts import Parts
from torchjoint.viewer.app import Viewer
from torchjoint.viewer.server import Page

image, started = Parts.image, threading.Event()
def slow(*arguments):
    started.set()
    time.sleep(1)  # the thread is at work when the program ends
    return image(*arguments)
Parts.image = slow
viewer = Viewer(tj.load_result(sys.argv[1], edits=False), page=Page(port=8995))
assert started.wait(60)
print(viewer.page.url, flush=True)
while not viewer.server.get_clients():
    time.sleep(0.1)
"""
CAMERA = {"type": "ViewerCameraMessage", "wxyz": (1.0, 0, 0, 0), "position": (0, 0, 0), "fov": 1, "near": 0.1, "far": 9}
CAMERA |= {"image_height": 9, "image_width": 9, "look_at": (0, 0, 1), "up_direction": (0, -1, 0)}


@pytest.mark.slow
def test_a_program_that_opened_a_page_ends(out):
    pipes = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen([sys.executable, "-c", PROGRAM, str(out)], text=True, **pipes) as program:
        url = program.stdout.readline().strip().replace("http", "ws")
        with connect(url, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, max_queue=None) as page:
            page.send(msgpack.encode(CAMERA))
            _, told = program.communicate(timeout=300)
    assert (program.returncode, "Traceback" in told) == (0, False), told


def test_a_click_at_the_edge_of_the_photo_stays_at_that_edge(out, monkeypatch):
    viewer = opened(out, 8990)
    superpoints, chosen = np.full((4, 6), -1), []
    superpoints[0, 0] = 3
    monkeypatch.setattr(type(viewer.model.parts), "image", lambda *_: superpoints)
    monkeypatch.setattr(viewer, "_on_point", lambda point, *_: chosen.append(point))
    for place in ("-1 -1", "-9 0", "5 3", "99 99", f"{10**30} 0"):
        viewer._on_event(f"torchjoint:image {place} 0 1", None)
    middle = viewer.model.parts.middle(3)
    assert chosen == [middle, middle, None, None, None]
    viewer.stop()


def test_the_photo_goes_to_a_frame_that_sees_the_selected(out, monkeypatch):
    viewer = opened(out, 8990)
    seen = {0: [(2, 9), (1, 5)], 1: [(1, 8), (2, 3)], 2: []}
    monkeypatch.setattr(viewer.model.measures, "frames_of", lambda segment: seen.get(segment, []))
    monkeypatch.setattr(viewer.model, "select", lambda segments: None)
    shown = [(viewer._select(segments, None), viewer._frame_index())[1] for segments in ((), (2,), (0,), (1,))]
    assert shown == [0, 0, 2, 2]
    viewer.stop()


def test_clicks_while_another_action_works(out):
    """A large cloud takes a while to draw: of clicks that waited, the last one counted for all."""
    viewer = opened(out, 8990)
    segments = np.unique(viewer.model.table)[:3].tolist()
    with ThreadPoolExecutor() as pool, viewer._lock:
        for number, segment in enumerate(segments):
            event = f"torchjoint:row {viewer.model.key(segment)} 1 {number}"
            pool.submit(setattr, viewer._panel.bridge, "value", event)
            time.sleep(0.1)
        assert not viewer.model.selected
    assert {*viewer.model.selected} == {*segments}
    viewer.stop()


def test_a_page_whose_camera_never_changes_sees_the_whole_cloud(out):
    """viser tells of the first camera before anything can listen to it."""
    viewer = opened(out, 8990)
    camera = SimpleNamespace(aspect=1.5, position=np.ones(3), wxyz=np.array([1.0, 0, 0, 0]), on_update=lambda _: None)
    page = SimpleNamespace(client_id=7, camera=camera, atomic=nullcontext)
    for connected in viewer.server._client_connect_cb:
        connected(page)
    assert not np.allclose(camera.position, 1)
    assert viewer._eyes._fitted[7][1] == 1.5
    viewer.stop()


def test_a_page_that_goes_to_the_first_view_late_is_fitted_again(out):
    """viser sends the first view of all pages and that of one page in two queues; the former may come last."""
    viewer = opened(out, 8990)
    camera = SimpleNamespace(aspect=0.9, position=np.ones(3), wxyz=np.array([1.0, 0, 0, 0]), on_update=lambda _: None)
    page = SimpleNamespace(client_id=7, camera=camera, atomic=nullcontext)
    viewer._on_camera(page)
    fitted = camera.position
    camera.position = viewer.server.initial_camera.position
    assert not np.allclose(fitted, camera.position)
    viewer._on_camera(page)
    assert np.allclose(fitted, camera.position)
    camera.position = fitted + 0.1  # turned by hand
    viewer._on_camera(page)
    assert np.allclose(fitted + 0.1, camera.position)
    viewer.stop()


def test_a_page_on_its_way_to_a_photo_is_not_fitted_again(out):
    """The page tells of its old place once more, in a canvas that has changed, after the server has moved it."""
    viewer = opened(out, 8990)
    camera = SimpleNamespace(aspect=1.5, position=np.ones(3), wxyz=np.array([1.0, 0, 0, 0]), on_update=lambda _: None)
    scene = SimpleNamespace(set_background_image=lambda _: None)
    page = SimpleNamespace(client_id=7, camera=camera, atomic=nullcontext, scene=scene)
    viewer._on_camera(page)
    whole = camera.position, camera.wxyz
    viewer._stand_at(0, page)
    there = camera.position, camera.wxyz
    camera.position, camera.wxyz, camera.aspect = *whole, 1.6
    viewer._on_camera(page)
    assert camera.position is whole[0]
    camera.position, camera.wxyz = there
    viewer._on_camera(page)
    assert viewer._eyes._arrived == {7}
    viewer.stop()


def test_a_page_that_closes_at_a_photo_leaves_no_small_points(out):
    viewer = opened(out, 8990)
    camera = SimpleNamespace(aspect=1.5, position=np.ones(3), wxyz=np.array([1.0, 0, 0, 0]), on_update=lambda _: None)
    scene = SimpleNamespace(set_background_image=lambda _: None)
    viewer._stand_at(0, page := SimpleNamespace(client_id=7, camera=camera, atomic=nullcontext, scene=scene))
    assert viewer._cloud._factor < 0.5
    for closed in viewer.server._client_disconnect_cb:
        closed(page)
    assert viewer._cloud._factor == 1
    viewer.stop()


def test_what_is_not_kept_is_told_when_the_program_ends(out, tmp_path, capsys, monkeypatch):
    folder = shutil.copytree(out, tmp_path / "out")
    viewer = opened(folder, 8990)
    assert viewer.not_kept() == ""
    viewer.model.set_granularity(0.7)
    assert viewer.not_kept() == "level 0.7, which Save the level keeps"
    viewer._guarded(viewer._on_save)
    assert viewer.not_kept() == ""
    monkeypatch.setattr(app, "save_edits", lambda *_: (_ for _ in ()).throw(PermissionError("read-only")))
    viewer._guarded(viewer._change, lambda: (viewer.model.select((0,)), viewer.model.name("sofa")))
    _end(weakref.ref(viewer.page))
    assert capsys.readouterr().out == "not kept: corrections after those in edits.json\n"
    running = app.Viewer(viewer.result, Shown(is_running=True), page=Page(port=8990))
    running._guarded(running._change, lambda: (running.model.select((0,)), running.model.name("sofa")))
    _end(weakref.ref(running.page))
    assert capsys.readouterr().out == "not kept: names of a run that has not ended; its result would have had them\n"
    _end(weakref.ref(running.page))
    assert capsys.readouterr().out == ""


def test_without_images_there_are_no_masks_to_export(out):
    for scene, kinds in ((whole := tj.load_result(out).scene, 3), (tj.Scene(whole.points), 1)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            viewer = app.Viewer(tj.Result.of(tj.JointSegmenter()(scene), scene), page=Page(port=8990))
        assert viewer._panel.export.options == ("PLY", "PNG", "COCO")[:kinds]
        viewer.stop()
