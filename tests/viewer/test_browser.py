"""The viewer in a real browser: clicks in the cloud, in the image and in the table; what is drawn after them.

Chromium is the system's (Debian's package `chromium`), driven by Playwright. Its WebGL runs in software.
"""

import contextlib
import io
import json
import shutil
import time
import warnings
import zipfile

import numpy as np
import pytest
import torch
from PIL import Image
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import torchjoint as tj
from torchjoint.datasets.files import clouds
from torchjoint.results.embeddings import Embeddings
from torchjoint.results.folder import write_result
from torchjoint.results.render import label_colors
from torchjoint.scene.frame import camera_center
from torchjoint.viewer.app import Viewer
from torchjoint.viewer.cloud import pick_point
from torchjoint.viewer.live import GrowingView, LiveView
from torchjoint.viewer.model import Model
from torchjoint.viewer.painting import point_colors, superpoint_colors
from torchjoint.viewer.server import Page
from torchjoint.viewer.shown import LiveRun, Shown
from torchjoint.viewer.truth import with_truth

pytest.importorskip("viser", reason="the viewer needs viser: pip install 'torchjoint[viewer]'")
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

pytestmark = [
    pytest.mark.skipif(BROWSER is None, reason="no browser: apt-get install chromium"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning"),  # of viser and websockets
    pytest.mark.slow,
]
#: Seconds; this time only ends a test that has failed anyway.
PATIENCE = 240.0
# Without the first, WebGL in software is off since Chrome 144, and a page without a cloud would be tested.
FLAGS = ["--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--no-sandbox"]
#: Of the page, pixels. It is small, as drawing by software takes its time for each pixel; the panel has the last 323.
SIZE = {"width": 900, "height": 650}
#: Hides viser's note that there is no GPU, which lies before the cloud.
STYLE = "<style>#webgl-software-rendering { display: none }</style>"
NO_NOTE = f"addEventListener('DOMContentLoaded', () => document.head.insertAdjacentHTML('beforeend', '{STYLE}'))"


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api", reason="the browser tests need playwright")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def only_tab(browser):
    return new_page(browser, viewport=SIZE)


@pytest.fixture
def tab(only_tab):
    """An empty page; all tests have the same, since a page that is open takes time from others."""
    only_tab.goto("about:blank")
    only_tab.set_viewport_size(SIZE)
    return only_tab


@pytest.fixture
def phone(tab, browser):
    options = {"is_mobile": True, "has_touch": True, "color_scheme": "dark"}
    with contextlib.closing(new_page(browser, viewport={"width": 390, "height": 844}, **options)) as phone:
        yield phone


def new_page(browser, **options):
    page = browser.new_page(**options)
    page.set_default_timeout(1000 * PATIENCE)
    page.add_init_script(NO_NOTE)
    return page


@pytest.fixture(scope="module")
def only_viewer(out, tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser") / "out"
    shutil.copytree(out, folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        viewer = Viewer(tj.load_result(folder, edits=False), Shown(folder), page=Page(port=8950))
    yield viewer
    viewer.stop()


@pytest.fixture
def viewer(only_viewer, tab):
    """A viewer without a page: nothing is corrected, selected or chosen, and nothing works in the background."""
    wait(lambda: not only_viewer.server.get_clients() and not only_viewer._eyes._fitted)  # the last test's
    (only_viewer.folder / "edits.json").unlink(missing_ok=True)
    result, shown = only_viewer.result, Shown(only_viewer.folder)
    with only_viewer._lock:
        only_viewer.model = Model(result, shown.edits(result), only_viewer.model.up)
        only_viewer._panel.frame.value, only_viewer._panel.cameras.value = 0, False
        only_viewer.replace(result, shown)
    for worker in only_viewer.page._workers:
        worker.join()
    return only_viewer


@pytest.fixture
def page(tab, viewer):
    show(tab, viewer)
    wait(lambda: drawn(tab) > 100_000)
    wait(lambda: sees_all(viewer))
    wait(lambda: np.array_equal(pixels(tab), pixels(tab)))
    return tab


def show(page, viewer):
    """Opens the viewer's page. It draws each pixel, however slow that is; else it takes fewer, and moves the camera."""
    page.goto(f"{viewer.page.url}?fixedDpr=1")
    page.wait_for_selector("#tj-image")
    return page


def wait(condition):
    """Until a condition holds."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it never happened"
        time.sleep(0.1)


def until(condition, action):
    """Does something again each ten seconds until a condition holds: on a busy machine, viser may lose an event.

    Of events that come within 50 ms, it keeps the first and the last one.
    """

    def has_come():
        action()
        end = time.monotonic() + 10
        while not condition() and time.monotonic() < end:
            time.sleep(0.02)
        return condition()

    wait(has_come)


def pixels(page):
    """The page left of the panel, [H, W, 3]."""
    shot = np.array(Image.open(io.BytesIO(page.screenshot())).convert("RGB")).astype(int)
    return shot[:, : page.viewport_size["width"] - 330]


def drawn(page):
    """Number of pixels in colour."""
    return int((np.ptp(pixels(page), axis=2) > 40).sum())


def camera(viewer):
    clients = list(viewer.server.get_clients().values())
    return clients[0].camera if clients and clients[0].camera.image_height else None


def sees_all(viewer):
    """Whether the page has come to where it shows the whole cloud, in its present size."""
    (client,) = viewer.server.get_clients().values() or (None,)
    if client is None or client.client_id not in viewer._eyes._fitted:
        return False
    position, aspect = viewer._eyes._fitted[client.client_id]
    return aspect == client.camera.aspect and np.abs(position - client.camera.position).max() < 1e-3


def on_screen(viewer, points):
    """Column and row of points on the page, and their depths."""
    eye = camera(viewer)
    rotation = Rotation.from_quat(np.asarray(eye.wxyz), scalar_first=True).as_matrix()
    x, y, z = ((points - np.asarray(eye.position)) @ rotation).T
    focal = eye.image_height / 2 / np.tan(eye.fov / 2)
    return eye.image_width / 2 + focal * x / z, eye.image_height / 2 + focal * y / z, z


def places(viewer, of_point):
    """For each label of the points a pixel in the midst of what is seen of it, whose neighbours all have it."""
    u, v, z = on_screen(viewer, viewer.result.scene.points.numpy())
    inside = (u > 20) & (u < 550) & (v > 20) & (v < 630) & (z > 0)
    at, labels = np.stack([u, v], 1)[inside], of_point[inside]
    most, found = {}, {}
    for place, label, near in zip(at.tolist(), labels.tolist(), cKDTree(at).query_ball_point(at, 14), strict=True):
        if len(near) > most.get(label, 0) and (labels[near] == label).all():
            most[label], found[label] = len(near), tuple(place)
    return found


def visible_segments(viewer):
    """Segments with a place to click, largest first."""
    model = viewer.model
    found = places(viewer, model.table[model.parts.of_point])
    segments = [model.segment_of_hue(row.hue) for row in model.rows()[0]]
    return [(segment, found[segment]) for segment in segments if segment in found]


def color_at(page, place):
    """The most frequent colour near a place that is not the background."""
    column, row = (round(value) for value in place)
    patch = pixels(page)[row - 7 : row + 8, column - 7 : column + 8].reshape(-1, 3)
    colors, counts = np.unique(patch[patch.min(1) < 250], axis=0, return_counts=True)
    return colors[counts.argmax()]


def is_like(color, expected):
    """Whether a drawn colour is the expected one in some light."""
    return np.abs(color / color.max() - expected / expected.max()).max() < 0.06


def open_table(page):
    page.get_by_role("tab", name="Segments").click()
    page.wait_for_selector("#tj-table")


def panel(page):
    return page.inner_text("#tj-panel")


def click_with_shift(page, place):
    page.keyboard.down("Shift")
    page.mouse.click(*place)
    page.keyboard.up("Shift")


def rest(page, place):
    page.mouse.move(place[0] - 3, place[1])
    page.mouse.move(*place)


def test_what_is_behind_something_is_dark_beside_it(page):
    """Depth shading: no colour of a segment is so dark in any light, not even at an edge. WebGL reports no error."""
    wait(lambda: int((pixels(page).max(2) < 40).sum()) > 50)
    errors = "document.querySelector('canvas[data-engine]').getContext('webgl2').getError()"
    assert page.evaluate(errors) == 0


def test_a_click_in_the_cloud_lights_the_segment_everywhere(viewer, page):
    (first, here), (second, there) = visible_segments(viewer)[:2]
    expected = superpoint_colors(viewer.model)
    wait(lambda: is_like(color_at(page, here), expected[first]))
    wait(lambda: is_like(color_at(page, there), expected[second]))
    image = page.get_attribute("#tj-image", "src")
    page.mouse.click(*here)
    page.mouse.move(890, 300)  # the id of what is under the mouse hides it
    wait(lambda: "segment" in panel(page) and "Click" not in panel(page))
    row = viewer.model.row(first)
    assert f"segment {row.key}: {row.points} points" in panel(page)
    wait(lambda: color_at(page, there).min() > 180)  # the others fade
    wait(lambda: is_like(color_at(page, here), expected[first]))
    wait(lambda: page.get_attribute("#tj-image", "src") != image)
    open_table(page)
    wait(lambda: "tj-lit" in (page.locator(f'tr[data-hue="{row.hue}"]').get_attribute("class") or ""))
    # With shift a second one is added; then both become one.
    click_with_shift(page, there)
    wait(lambda: len(viewer.model.selected) == 2)
    page.get_by_role("button", name="Join").click()
    wait(lambda: len(viewer.model.selected) == 1)
    together = row.points + int((viewer.result.points == viewer.model.key(second)).sum())
    wait(lambda: f"{together} points" in panel(page))
    page.get_by_role("button", name="Undo").click()
    wait(lambda: len(np.unique(viewer.model.table)) == viewer.result.num_point_segments)


def test_a_click_in_the_image_and_in_the_table(viewer, page, tmp_path):
    labels = viewer.result.images[0]
    middle = int(labels[60, 80])
    box = page.locator("#tj-image").bounding_box()
    page.mouse.click(box["x"] + box["width"] * 80.5 / 160, box["y"] + box["height"] * 60.5 / 120)
    wait(lambda: f"segment {middle}:" in panel(page))
    wait(lambda: "seen in 0" not in panel(page))
    other = next(row.key for row in viewer.model.rows()[0] if row.key != middle)
    open_table(page)
    page.click(f'tr[data-hue="{other}"]')
    wait(lambda: f"segment {other}:" in panel(page))
    page.locator("xpath=//*[text()='Name']/following::input[1]").fill("<b>mug</b>")
    wait(lambda: "<b>mug</b>" in page.inner_text("#tj-table"))  # as text
    wait(lambda: (viewer.folder / "edits.json").is_file())
    assert list(tj.load_result(viewer.folder).segment_names.values()) == ["<b>mug</b>"]
    before = sorted(viewer.folder.iterdir())
    cloud = download(page, "PLY", tmp_path)
    assert cloud.name == f"{other}-_b_mug__b_.ply"  # no name leaves the folder of downloads
    np.testing.assert_array_equal(clouds.read_cloud_file(cloud).points, scene_points(viewer, other))
    with zipfile.ZipFile(download(page, "PNG", tmp_path)) as masks:
        seen = {
            name: labels.numpy() == other
            for name, labels in zip(viewer.result.names, viewer.result.images, strict=True)
        }
        assert sorted(masks.namelist()) == sorted(f"{name}.png" for name, mask in seen.items() if mask.any())
        for file in masks.namelist():
            mask = np.array(Image.open(io.BytesIO(masks.read(file))))
            np.testing.assert_array_equal(mask, seen[file.removesuffix(".png")] * 255)
    assert sorted(viewer.folder.iterdir()) == before  # nothing lands beside the result
    page.get_by_role("button", name="Clear selection").click()
    wait(lambda: "Click or tap a segment" in panel(page))
    page.get_by_role("button", name="COCO").click()
    wait(lambda: "export: select a segment first" in page.inner_text("body"))


def download(page, kind, folder):
    with page.expect_download() as coming:
        page.get_by_role("button", name=kind).click()
    wait(lambda: "Received" in page.inner_text("body"))
    coming.value.save_as(folder / coming.value.suggested_filename)
    return folder / coming.value.suggested_filename


def scene_points(viewer, label):
    return viewer.result.scene.points[viewer.result.points == label]


def test_the_panel_stands_beside_the_cloud(viewer, page):
    page.set_viewport_size({"width": 1400, "height": 900})
    wait(lambda: camera(viewer).image_height == 900 and sees_all(viewer))
    left = page.locator("#tj-panel").bounding_box()["x"]
    assert camera(viewer).image_width <= left
    u, v, _ = on_screen(viewer, viewer.result.scene.points.numpy())
    shares = np.stack([u / camera(viewer).image_width, v / 900], 1)
    assert ((shares > 0) & (shares < 1)).all(1).mean() > 0.996  # the whole cloud, as large as the canvas allows
    assert np.ptp(np.quantile(shares, [0.0005, 0.9995], axis=0), axis=0).max() > 0.85
    assert is_in_view(page.get_by_role("checkbox", name="Cameras"), 900)
    assert is_in_view(page.get_by_role("slider").nth(1), 450)  # the size of points, in the upper half
    open_table(page)
    table = page.locator("#tj-table").locator("xpath=..").bounding_box()
    assert 850 < table["y"] + table["height"] < 900
    assert page.locator("#tj-table tr").evaluate_all("rows => Math.max(...rows.map((row) => row.offsetHeight))") < 25
    page.get_by_role("tab", name="Photo").click()
    page.set_viewport_size({"width": 1000, "height": 700})
    assert is_in_view(page.get_by_text("Save the level"), 350)
    wait(lambda: camera(viewer).image_height == 700 and sees_all(viewer))
    assert is_in_view(page.get_by_role("checkbox", name="Cameras"), 700)

    def is_wide():
        button = page.get_by_label("Collapse panel area")
        if button.is_visible():  # a click while the page is laid out anew is lost
            button.click()
        return camera(viewer).image_width > 940

    wait(is_wide)


def is_in_view(element, bottom):
    box = element.bounding_box()
    return box["y"] + box["height"] < bottom


def test_the_row_of_a_selected_segment_is_in_sight(viewer, page):
    rows, _ = viewer.model.rows("", "points")
    assert len(rows) > 6
    of_last = next(segment for segment in np.unique(viewer.model.table) if viewer.model.key(segment) == rows[-1].key)
    viewer.model.select((int(of_last),))
    viewer._draw_lists()
    page.set_viewport_size({"width": 900, "height": 600})
    open_table(page)
    row = page.locator(f"#tj-table tr[data-hue='{rows[-1].hue}']")
    wait(lambda: "tj-lit" in (row.get_attribute("class") or ""))

    def window():
        return page.locator("#tj-table").locator("xpath=..").bounding_box()

    def is_in_sight():
        listed, shown = window(), row.bounding_box()
        return -1 <= shown["y"] - listed["y"] <= listed["height"] - shown["height"] + 1

    wait(is_in_sight)
    assert page.locator("#tj-table").bounding_box()["height"] > window()["height"]  # the list is longer than its window


def test_relations_are_lines_of_the_selected_thing(viewer, page):
    before = pixels(page)
    page.get_by_role("checkbox", name="Relations").press(" ")
    wait(lambda: viewer._relations._handle is not None)
    everything = len(viewer._relations._handle.points)
    wait(lambda: (np.abs(pixels(page) - before).max(2) > 40).sum() > 200)
    segment = visible_segments(viewer)[0][0]
    viewer._guarded(viewer._select, (segment,), None)
    of_one = viewer._relations._handle
    own = viewer.result.scene.points.numpy()[viewer.model.table[viewer.model.parts.of_point] == segment].mean(0)
    at_it = np.isclose(of_one.points, own, atol=1e-4).all(2).any(1)
    assert at_it.all()
    assert 0 < len(of_one.points) != everything
    page.get_by_role("checkbox", name="Relations").uncheck()
    wait(lambda: viewer._relations._handle is None)


def test_clicks_walk_the_tree_and_make_one_thing(viewer, page):
    (first, here), (_, there) = visible_segments(viewer)[:2]
    page.get_by_role("checkbox", name="Thing from clicks").check()
    wait(lambda: viewer._panel.by_clicks.value)  # viser tells clicks in the cloud at once, others in up to 50 ms
    page.mouse.click(*here)
    wait(lambda: viewer.model.selected == (first,))
    page.mouse.click(*there)
    wait(lambda: len(viewer.model.clicks) == 2)
    points = torch.tensor([point for point, _ in viewer.model.clicks])
    both = viewer.result.pick(points)
    of_point = viewer.model.table[viewer.model.parts.of_point]
    np.testing.assert_array_equal(of_point == viewer.model.selected[0], both.points)
    wait(lambda: f": {int(both.points.sum())} points" in panel(page))
    before = pixels(page)
    click_with_shift(page, here)
    wait(lambda: "expected points apart from the chosen ones" in page.inner_text("body"))
    page.get_by_role("button", name="Undo").click()
    wait(lambda: viewer.model.selected == (first,))
    click_with_shift(page, there)
    wait(lambda: [belongs for _, belongs in viewer.model.clicks] == [True, False])
    thing = viewer.result.pick(points[:1], negative=points[1:]).points
    wait(lambda: f": {int(thing.sum())} points" in panel(page))
    wait(lambda: (np.abs(pixels(page) - before).max(2) > 40).sum() > 500)
    assert [mark.text for mark in viewer._cloud._marks] == ["+", "\N{MINUS SIGN}"]
    page.get_by_role("button", name="Make it one thing").click()
    wait(lambda: len(viewer.model.edits.steps) == 1)
    wait(lambda: (viewer.folder / "edits.json").is_file())
    corrected = tj.load_result(viewer.folder).points
    np.testing.assert_array_equal(corrected == corrected[points[0]], thing)


def test_words_find_things(tab, out, tmp_path):
    folder, labels = tmp_path / "out", tj.load_result(out).points
    shutil.copytree(out, folder)
    vectors = torch.eye(int(labels.max()) + 1)
    Embeddings(vectors, labels).save(folder)
    words = {"a mug": vectors[3] + 0.5 * vectors[5], "a mu": torch.ones(2)}
    viewer = Viewer(
        tj.load_result(folder, edits=False), Shown(folder, text_encoder=words.__getitem__), page=Page(port=8985)
    )
    page = show(tab, viewer)
    open_table(page)
    for typed, told in (("a mu", "query: expected"), ("a mug", "segment 3:")):
        page.locator("xpath=//*[text()='Words']/following::input[1]").fill(typed)
        wait(lambda typed=typed: viewer._panel.words.value == typed)
        page.get_by_role("button", name="Find the words").click()
        wait(lambda told=told: told in page.inner_text("body"))
    assert page.inner_text("#tj-found").splitlines()[:2] == ["0.89 segment 3", "0.45 segment 5"]
    page.click('#tj-found [data-found="5"]')
    wait(lambda: "segment 5:" in panel(page))
    viewer.replace(viewer.result, Shown(folder))  # without an encoder
    wait(lambda: page.get_by_role("button", name="Find the words").count() == 0)
    wait(lambda: "seen in" in panel(page))  # nothing works any more
    viewer.stop()


def test_a_click_goes_through_a_camera(viewer, page):
    before, colorful = pixels(page), drawn(page)
    page.get_by_role("checkbox", name="Cameras").press(" ")  # the mouse on it would show its hint
    wait(lambda: (np.abs(pixels(page) - before).max(2) > 60).sum() > 300)
    eye = camera(viewer)
    far = eye.look_at + 1.7 * (np.asarray(eye.position) - eye.look_at)  # so that the cameras are in view
    eye.position = far
    wait(lambda: np.allclose(camera(viewer).position, far, atol=1e-3))
    before = np.asarray(camera(viewer).position)
    hits = []
    for frame in viewer.result.scene.frames:
        apex = camera_center(frame.world_to_camera).numpy()
        (u,), (v,), _ = on_screen(viewer, apex[None])
        point = pick_point(viewer.result.scene.points.numpy(), before, apex - before, 0.4 * viewer._cloud.size)
        if point is not None and 20 < u < 550 and 20 < v < 630:
            hits.append(((float(u), float(v)), int(viewer.model.table[viewer.model.parts.of_point[point]])))
    assert hits
    wait(lambda: drawn(page) < 0.7 * colorful)  # the page sees it from there, too
    for place, segment in hits:
        until(lambda: not viewer.model.selected, page.get_by_role("button", name="Clear selection").click)
        page.mouse.click(*place)
        wait(lambda: viewer.model.selected)
        assert viewer.model.selected == (segment,)
    np.testing.assert_allclose(camera(viewer).position, before, atol=1e-6)


def test_reset_view(viewer, page):
    def view():
        return np.concatenate([camera(viewer).position, camera(viewer).wxyz, [camera(viewer).fov]])

    before = view()
    page.get_by_role("button", name="Stand at this camera").click()
    wait(lambda: viewer._eyes._arrived)
    assert np.abs(view() - before).max() > 0.1
    page.get_by_role("button", name="Reset view").click()
    wait(lambda: not viewer._eyes.standing)  # the page has told where it looks from
    wait(lambda: np.abs(view() - before).max() < 0.01)


def test_a_name_stays_where_it_belongs(viewer, page):
    segment, place = visible_segments(viewer)[1]
    page.mouse.click(*place)
    wait(lambda: f"segment {viewer.model.key(segment)}:" in panel(page))
    named = viewer.model.table[viewer.model.parts.of_point] == segment
    open_table(page)
    page.locator("xpath=//*[text()='Name']/following::input[1]").fill("chair")
    wait(lambda: "chair" in page.inner_text("#tj-table"))
    slider = page.get_by_role("slider").first
    slider.focus()
    slider.press("Home")
    wait(lambda: viewer.model.edits.granularity == 0)
    wait(lambda: f"{len(np.unique(viewer.model.table))} segments" in page.inner_text("body"))
    assert not named[viewer.model.table[viewer.model.parts.of_point] == viewer.model.selected[0]].all()
    wait(lambda: "chair" not in page.inner_text("body"))
    slider.press("End")
    wait(lambda: "chair" in page.inner_text("#tj-table"))
    (found,) = {*viewer.model.names.values()}
    assert found == "chair"
    of_point = viewer.model.table[viewer.model.parts.of_point]
    np.testing.assert_array_equal(np.isin(of_point, [*viewer.model.names]), named)


def test_split_name_and_undo(viewer, page):
    segment, place = visible_segments(viewer)[0]
    page.mouse.click(*place)
    wait(lambda: f"segment {viewer.model.key(segment)}:" in panel(page))
    points = viewer.model.row(segment).points
    page.get_by_role("button", name="Split").click()
    wait(lambda: len(viewer.model.selected) == 2)
    parts = [viewer.model.row(part) for part in viewer.model.selected]
    assert sum(part.points for part in parts) == points
    wait(lambda: all(f"segment {part.key}: {part.points} points" in panel(page) for part in parts))
    page.get_by_role("button", name="Undo").click()
    wait(lambda: f"segment {viewer.model.key(segment)}: {points} points" in panel(page))
    name = page.locator("xpath=//*[text()='Name']/following::input[1]")
    name.click()
    page.keyboard.type("table top", delay=30)
    wait(lambda: "table top" in panel(page))
    page.get_by_role("button", name="Undo").click()
    wait(lambda: "table" not in panel(page) and name.input_value() == "")  # the whole name, in the field, too
    page.get_by_role("button", name="Clear selection").click()
    wait(lambda: "Click or tap a segment" in panel(page))
    name.fill("nobody")
    wait(lambda: "expected one selected segment, got 0" in page.inner_text("body"))
    wait(lambda: name.input_value() == "")


def test_the_granularity_slider_and_the_frame_slider(viewer, page):
    before = len(np.unique(viewer.model.table))
    slider = page.get_by_role("slider").first
    slider.focus()
    slider.press("Home")
    wait(lambda: viewer.model.edits.granularity == 0)
    slider.press("End")
    wait(lambda: viewer.model.edits.granularity == 1)
    assert len(np.unique(viewer.model.table)) > before
    open_table(page)
    wait(lambda: f"{len(np.unique(viewer.model.table))} segments" in page.inner_text("body"))
    page.get_by_role("tab", name="Photo").click()
    fresh = [one for one in visible_segments(viewer) if viewer.model.key(one[0]) >= viewer.result.num_point_segments]
    colors = superpoint_colors(viewer.model)
    segment, place = fresh[0]
    wait(lambda: is_like(color_at(page, place), colors[segment]))
    image = page.get_attribute("#tj-image", "alt")
    frames = page.get_by_role("slider").nth(3)  # after the sizes of points and the cut
    frames.focus()
    frames.press("ArrowRight")
    wait(lambda: page.get_attribute("#tj-image", "alt") == viewer.result.names[1] != image)
    page.get_by_role("button", name="Stand at this camera").click()
    center = camera_center(viewer.result.scene.frames[1].world_to_camera).numpy()
    wait(lambda: np.abs(np.asarray(camera(viewer).position) - center).max() < 0.01)
    # What the camera saw is now drawn where its image has it.
    u, v, _ = on_screen(viewer, viewer.result.scene.points.numpy())
    assert ((u > 0) & (u < 577) & (v > 0) & (v < 650)).sum() > 300


def test_what_the_page_sends_replaces_nothing(viewer, page):
    open_table(page)
    hues = page.evaluate(
        """() => {  // all of this comes within the 50 ms of which viser sends the first and the last
            const slider = document.querySelectorAll('[role="slider"]')[1];  // the size of points
            const press = (key) => slider.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
            const rows = [...document.querySelectorAll("#tj-table [data-hue]")].slice(0, 3);
            press("Home");
            press("End");
            rows.forEach((row) => row.dispatchEvent(new MouseEvent("click", { bubbles: true, shiftKey: true })));
            return rows.map((row) => Number(row.dataset.hue));
        }"""
    )
    wait(lambda: [viewer.model.key(one) for one in viewer.model.selected] == hues)
    assert viewer._panel.size.value == viewer._panel.size.max
    # A key that is held repeats; with shift, a click takes a thing out.
    press = 'document.body.dispatchEvent(new KeyboardEvent("keydown", { key: "Shift", bubbles: true }))'
    page.evaluate(f"held = setInterval(() => {press}, 30)")
    page.click(f'tr[data-hue="{hues[0]}"]', modifiers=["Shift"])
    wait(lambda: [viewer.model.key(one) for one in viewer.model.selected] == hues[1:])
    page.evaluate("clearInterval(held)")


def test_what_is_under_the_mouse_is_lit_and_named(viewer, page):
    segment, place = visible_segments(viewer)[0]
    until(lambda: len(viewer._cloud._lit) == 2, lambda: rest(page, place))
    label, points = viewer._cloud._lit
    assert label.text.split() == [str(viewer.model.key(segment))]
    assert len(points.points) == viewer.model.row(segment).points
    own = scene_points(viewer, viewer.model.key(segment)).numpy()
    away = [np.linalg.norm(one - camera(viewer).position, axis=1) for one in (points.points + points.position, own)]
    assert (away[0] < away[1]).all()  # in front of the same points in their own colours

    def leave():
        rest(page, place)
        page.wait_for_timeout(500)
        page.mouse.move(890, 300)  # the panel

    until(lambda: not viewer._cloud._lit, leave)


def test_a_selected_thing_under_the_mouse_is_named(viewer, page):
    errors = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    segment, place = visible_segments(viewer)[0]
    page.mouse.click(*place)
    wait(lambda: viewer.model.selected == (segment,))
    until(lambda: viewer._cloud._lit, lambda: rest(page, place))
    page.wait_for_timeout(2000)
    assert not errors  # a cloud without points was one


def test_the_photo_is_behind_the_points_until_the_view_turns(viewer, page):
    page.get_by_role("button", name="Stand at this camera").click()
    wait(lambda: viewer._eyes._arrived)
    assert viewer._eyes.standing
    assert viewer._cloud._handles[0].point_size < 0.5 * viewer._cloud._whole[0]
    wait(lambda: (pixels(page)[200:450, 50:530].min(2) > 250).mean() < 0.02)  # no white between the points
    segment = viewer.model.segment_of_hue(viewer.model.rows()[0][0].hue)
    viewer._guarded(viewer._select, (segment,), None)  # the faded others would hide the photo
    assert sum(len(handle.points) for handle in viewer._cloud._handles.values()) == viewer.model.row(segment).points
    page.mouse.move(300, 300)
    page.mouse.down()
    page.mouse.move(500, 360, steps=5)
    page.mouse.up()
    wait(lambda: not viewer._eyes.standing)
    wait(lambda: viewer._cloud._handles[0].point_size == viewer._cloud._whole[0])
    everything = len(viewer.result.scene.points)
    wait(lambda: sum(len(handle.points) for handle in viewer._cloud._handles.values()) == everything)


def test_a_phone_in_the_dark(phone, viewer, monkeypatch):
    page, dropped, on_event = phone, [], viewer._on_event

    def drop_first(event, client):  # as viser does before it knows the page's camera
        on_event(event, client) if dropped else dropped.append(event)

    monkeypatch.setattr(viewer, "_on_event", drop_first)
    viewer._guarded(viewer._select, (0,), None)
    page.goto(viewer.page.url)
    wait(lambda: camera(viewer) is not None)
    wait(lambda: viewer.model.pale < 100)
    faded = viewer.model.table[viewer.model.parts.of_point] != 0
    wait(lambda: viewer._cloud._colors[faded].max() < 100)  # what was selected before, too
    viewer._guarded(viewer._select, (), None)
    assert "dark" in dropped[0]
    assert page.title().endswith("- torchjoint")
    wait(lambda: not page.get_by_role("button", name="Join").is_visible())  # closed: the cloud has the page

    def shares():
        u, v, _ = on_screen(viewer, viewer.result.scene.points.numpy())
        return np.stack([u / 390, v / 844], 1)

    wait(lambda: ((shares() > 0) & (shares() < 1)).all(1).mean() > 0.93)
    u, v, _ = on_screen(viewer, viewer.result.scene.points.numpy())
    nearest = int(np.argmin(np.abs(u - 195) + np.abs(v - 430)))
    page.touchscreen.tap(float(u[nearest]), float(v[nearest]))
    wait(lambda: len(viewer.model.selected) == 1)
    handle = page.locator('[style*="height: 3.5em"][style*="cursor"]')
    told = "e => getComputedStyle(e, '::after').content"
    wait(lambda: f"{viewer.model.row(viewer.model.selected[0]).points} points" in handle.evaluate(told))
    page.touchscreen.tap(100, 820)
    wait(lambda: page.get_by_role("button", name="Join").is_visible())
    assert handle.evaluate(told) == '"tap: the cloud"'


def test_the_truth_beside_a_prediction(tab, out, scene_of):
    synthetic = scene_of(3, num_points=6000)
    viewer = Viewer(with_truth(tj.load_result(out), synthetic.scene), page=Page(port=8955))
    page = show(tab, viewer)
    wait(lambda: drawn(page) > 1000)
    wait(lambda: sees_all(viewer))
    image = page.get_attribute("#tj-image", "src")
    page.locator("xpath=//*[text()='Colour by']/following::input[1]").click()
    page.get_by_role("option", name="truth").click()
    wait(lambda: page.get_attribute("#tj-image", "src") != image)
    seen = places(viewer, synthetic.point_labels.numpy())
    assert len(seen) > 5
    for instance, place in [*seen.items()][:3]:
        color = label_colors(torch.tensor([instance]))[0].numpy() * 255
        wait(lambda place=place, color=color: is_like(color_at(page, place), color))
    viewer.stop()


def test_parameters_of_a_run_in_memory(tab, scene_of):
    scene = scene_of(3, num_points=6000).scene
    segmenter = tj.JointSegmenter(tj.Config().set(["point_segments.method=paper", "boundary.detector=gradient"]))
    result = tj.Result.of(segmenter(scene), scene)
    viewer = Viewer(result, Shown(run=LiveRun(segmenter, scene)), page=Page(port=8960))
    page = show(tab, viewer)
    page.locator("xpath=//*[starts-with(normalize-space(text()),'Parameters')]/following::input[1]").fill("0.1")
    page.get_by_role("button", name="Compute again").click()
    wait(lambda: viewer.result is not result)
    wait(lambda: f"{viewer.result.num_point_segments} segments" in page.inner_text("body"))
    assert viewer.result.num_point_segments != result.num_point_segments
    viewer.stop()


def test_a_run_is_shown_while_its_frames_come(tab, scene_of, tmp_path):
    scene, config = scene_of(3, num_points=6000).scene, tj.Config().set(["boundary.detector=gradient"])
    live = LiveView(lambda: Page(port=8970), share=1.0)
    page, notes, colors, images = tab, [], [], []

    def watch(segmenter, scene):
        live(segmenter, scene)
        if not notes:
            show(page, live.viewer)
            wait(lambda: drawn(page) > 1000)
            wait(lambda: sees_all(live.viewer))
        note = f"running: {len(segmenter.state.observations)} of 6 frames"
        wait(lambda: note in page.inner_text("#tj-note"))
        segment, place = visible_segments(live.viewer)[0]
        expected = superpoint_colors(live.viewer.model)[segment]
        wait(lambda: is_like(color_at(page, place), expected))
        notes.append(note)
        colors.append(point_colors(live.viewer.model))
        images.append(page.get_attribute("#tj-image", "src"))

    segmenter = tj.JointSegmenter(config)
    for _ in segmenter.steps(scene, batch_size=3):
        watch(segmenter, scene)
    result = segmenter.compute()
    assert len(notes) == 3
    assert not np.array_equal(colors[0], colors[-1])  # images have changed the labels
    assert images[0] != images[1]  # the first frame has its labels now
    out = tmp_path / "out"
    out.mkdir()
    write_result(out, scene, result, config, "test")
    page.mouse.click(*visible_segments(live.viewer)[0][1])
    wait(lambda: "segment" in panel(page) and "Click" not in panel(page))
    assert page.get_by_role("button", name="Join").count() == 0
    page.locator("xpath=//*[text()='Name']/following::input[1]").fill("chair")
    wait(lambda: "chair" in panel(page))
    with page.expect_download() as download:
        page.get_by_role("button", name="PLY").click()
    (lit,) = live.viewer.model.selected
    points = live.viewer.result.points == live.viewer.model.key(lit)
    assert len(tj.load_scene(download.value.path().rename(tmp_path / "one.ply")).points) == points.sum()
    live.finish(out, LiveRun(segmenter, scene))
    page.get_by_role("button", name="Join").wait_for()
    assert page.locator("#tj-note").count() == 0
    page.get_by_role("button", name="Compute again").wait_for()
    assert live.viewer.model.parts.count > result.num_point_segments  # all levels
    (selected,) = live.viewer.model.selected  # what was selected still is
    row = live.viewer.model.row(selected)
    wait(lambda: f"segment {row.key} chair" in panel(page) and "seen in" in panel(page))
    assert tj.load_result(out).segment_names == {row.key: "chair"}  # saved, as what is named now
    assert (result.points[points] == row.key).float().mean() > 0.5
    live.viewer.stop()


def test_the_cloud_grows_while_frames_come(tab, scene_of, tmp_path):
    frames = scene_of(3, num_points=6000).scene.frames
    view, segmenter = GrowingView(Page(port=8980, note="wait for it")), tj.LiveSegmenter(voxel_size=0.04)
    segmenter.update(frames[:2])
    first = segmenter.result(images=False)
    view.camera(frames[1])  # there is no cloud yet
    page = tab
    page.goto(f"{view.page.url}?fixedDpr=1")
    page.get_by_text("wait for it").wait_for()
    wait(lambda: page.title() == "torchjoint")  # no scene is known yet
    view.show(first, tj.Scene(first.cloud.points, frames[:2], name="walk"), "after 2 frames")
    wait(lambda: page.title() == "walk - torchjoint")
    wait(lambda: drawn(page) > 1000)
    wait(lambda: sees_all(view.viewer))
    wait(lambda: "after 2 frames" in page.inner_text("#tj-note"))
    segment, place = visible_segments(view.viewer)[0]
    page.mouse.click(*place)
    wait(lambda: view.viewer.model.selected == (segment,))
    thing = view.viewer.model.key(segment)
    color = superpoint_colors(view.viewer.model)[segment]
    page.locator("xpath=//*[text()='Name']/following::input[1]").fill("stool")
    wait(lambda: "stool" in panel(page))
    segmenter.update(frames[2:])
    second = segmenter.result(images=False)
    assert len(second.cloud.points) > len(first.cloud.points)
    assert thing in second.ids
    view.camera(frames[-1])
    (seen_from,) = view.viewer._eyes._fitted.values()
    view.show(second, tj.Scene(first.cloud.points, frames), "after all frames")
    wait(lambda: "after all frames" in page.inner_text("#tj-note"))
    wait(lambda: sees_all(view.viewer))
    assert np.abs(view.viewer.server.get_clients().popitem()[1].camera.position - seen_from[0]).max() > 0.01
    (segment,) = view.viewer.model.selected  # the same thing
    assert view.viewer.model.key(segment) == thing
    assert np.array_equal(superpoint_colors(view.viewer.model)[segment], color)
    wait(lambda: f"segment {thing} stool" in panel(page))
    place = dict(visible_segments(view.viewer))[segment]
    wait(lambda: is_like(color_at(page, place), color))
    assert page.locator("#tj-image").is_visible()
    # at the end the result's folder is shown: with the photos, names, files, and the same colours
    last = segmenter.result()
    frames = [frame for frame in frames if frame.name in segmenter.names]
    things = tj.Scene(last.cloud.points, frames, last.cloud.colors)
    write_result(tmp_path, things, last.segmentation, tj.Config(), "here")
    view.finish(tmp_path, last)
    page.get_by_role("button", name="Join").wait_for()
    assert [*tj.load_result(tmp_path).segment_names.values()] == ["stool"]
    (segment,) = view.viewer.model.selected
    assert int(last.ids[view.viewer.model.key(segment)]) == thing
    assert np.array_equal(superpoint_colors(view.viewer.model)[segment], color)
    page.locator("xpath=//*[text()='Name']/following::input[1]").fill("chair")
    edits = tmp_path / "edits.json"
    wait(lambda: edits.exists() and "chair" in edits.read_text())
    view.viewer.stop()


@pytest.fixture(scope="module")
def static(out, run, tmp_path_factory):
    file = tmp_path_factory.mktemp("static") / "page.html"
    run("show", out, "--static", file)
    return file.as_uri()


def test_the_static_page(tab, out, static):
    page = tab
    page.goto(static)
    page.wait_for_selector("canvas")
    wait(lambda: (np.ptp(pixels(page)[:500], axis=2) > 60).sum() > 3000)
    result = tj.load_result(out)
    assert page.evaluate("cloud.tilt") > 0.3  # from above
    first = page.evaluate("cloud.away")
    shown = np.array(page.evaluate("[...cloud.points]")).reshape(-1, 3)
    up = np.array(json.loads((out / "segments.json").read_text())["up"])
    assert np.corrcoef(shown[:, 2], result.scene.points.numpy() @ up)[0, 1] > 0.9999
    before = pixels(page)
    page.select_option("#mode", "colours")
    wait(lambda: (np.abs(pixels(page)[:500] - before[:500]).max(2) > 30).sum() > 3000)
    page.select_option("#mode", "segments")
    picture = page.locator("canvas.picture").first
    wait(lambda: picture.evaluate("e => e.height") == 120)
    row, column = 60, 80
    label = int(result.images[0][row, column])
    picture.click(position={"x": column + 0.5, "y": row + 0.5})
    wait(lambda: page.inner_text("#told") == f"segment {label}")
    # What is lit in a picture and in the cloud is the segment.
    wait(lambda: lit(page, 1) > 50)
    seen = result.images[1].numpy() == label
    inside = ~ndimage.binary_dilation(seen ^ ndimage.binary_erosion(seen), iterations=2)
    found = colorful(page, 1)
    assert found[seen & inside].mean() > 0.95
    assert found[~seen & inside].mean() < 0.05
    colors = np.array(page.evaluate("[...cloud.colors]")).reshape(-1, 3)
    np.testing.assert_array_equal(colors.min(1) > 199, result.points.numpy() != label)
    # A click in the cloud selects the segment of the point below, which lights up before.
    page.click("#clear")
    wait(lambda: "Click a segment" in page.inner_text("#told"))
    assert page.evaluate("Array.from(pieces, (piece) => now().ids[piece])") == result.points.tolist()
    ids, (column, row) = place_in_shared_cloud(page, result.points.numpy())
    page.mouse.move(column - 1, row)
    page.mouse.move(column, row)
    wait(lambda: page.inner_text("#tip") == f"segment {ids}")
    lighter = np.array(page.evaluate("[...cloud.colors]")).reshape(-1, 3).min(1) >= 127
    assert lighter[result.points.numpy() == ids].all()
    page.mouse.click(column, row)
    wait(lambda: page.inner_text("#told") == f"segment {ids}")
    # Turning, moving and coming nearer select nothing.
    for button, changed in (("left", "[cloud.turn, cloud.tilt]"), ("right", "cloud.center")):
        before = page.evaluate(changed)
        page.mouse.move(column, row)
        page.mouse.down(button=button)
        page.mouse.move(column + 50, row + 30, steps=4)
        page.mouse.up(button=button)
        assert np.abs(np.subtract(page.evaluate(changed), before)).min() > 1e-3
    before = page.evaluate("cloud.away")
    page.mouse.wheel(0, -300)
    wait(lambda: page.evaluate("cloud.away") == pytest.approx(before * np.exp(-0.3)))
    assert page.inner_text("#told") == f"segment {ids}"
    # What the mouse is at stays there, and keeps the colour of what is selected; one button leads back.
    page.click("#reset")
    assert page.evaluate("cloud.away") == pytest.approx(first)
    assert page.evaluate("hovered") is None
    colors = page.evaluate("cloud.colors.join()")
    page.mouse.move(column, row)
    wait(lambda: page.inner_text("#tip") == f"segment {ids}")
    assert page.evaluate("cloud.colors.join()") == colors
    beneath = f"cloud.at({{ offsetX: {column}, offsetY: {row} - cloud.canvas.offsetTop }})"
    point = page.evaluate(beneath)
    for _ in range(4):
        page.mouse.wheel(0, -300)
    wait(lambda: page.evaluate("cloud.away") == pytest.approx(first * np.exp(-1.2)))
    shown = np.array(page.evaluate("[...cloud.points]")).reshape(-1, 3)
    step = np.median(cKDTree(shown).query(shown, k=2)[0][:, 1])
    assert np.linalg.norm(shown[page.evaluate(beneath)] - shown[point]) < 3 * step
    page.click("#reset")
    # Another level has other segments.
    assert f"{result.num_point_segments} segments" in page.inner_text("#count")
    page.locator("#level").focus()
    page.keyboard.press("End")
    finest = result.at(1.0).num_point_segments
    wait(lambda: page.inner_text("#count") == f"{finest} segments")
    names = page.evaluate("Array.from(pieces, (piece) => now().ids[piece])")
    assert len(set(zip(names, result.at(1.0).points.tolist(), strict=True))) == finest == len(set(names))


@pytest.mark.parametrize(("width", "height"), [(1400, 700), (390, 844)])
def test_the_static_page_shows_the_whole_cloud(tab, out, static, width, height):
    page = tab
    page.set_viewport_size({"width": width, "height": height})
    page.goto(static)
    box = page.locator("#cloud").bounding_box()
    assert page.locator("#level").is_visible() == (tj.load_result(out).hierarchy is not None)
    assert not page.locator("#clear").is_visible()

    def seen():  # the first and the last column and row of the cloud, in shares of its part of the page
        shot = page.screenshot(clip=box)
        shot = np.array(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)
        rows, columns = np.nonzero(np.ptp(shot, axis=2) > 10)  # not the border of the header
        return np.array([columns, rows]) / [[box["width"]], [box["height"]]] if len(rows) else np.zeros((2, 1))

    wait(lambda: np.ptp(seen(), axis=1).max() > 0.8)
    time.sleep(1)
    assert np.ptp(seen(), axis=1).max() > 0.8
    assert seen().min() > 0.002
    assert seen().max() < 0.998
    page.set_viewport_size({"width": height, "height": width})  # as a phone that is turned
    box = page.locator("#cloud").bounding_box()
    wait(lambda: np.ptp(seen(), axis=1).max() > 0.8)


def place_in_shared_cloud(page, of_point):
    """A label in the shared page, and column and row of a pixel whose neighbours all show points that have it."""
    eye, axes, away = page.evaluate(
        "[sum([1, cloud.center], [-cloud.away, cloud.axes()[2]]), cloud.axes(), cloud.away]"
    )
    points = np.array(page.evaluate("[...cloud.points]")).reshape(-1, 3) / 32767
    x, y, z = np.array(axes) @ (points - eye).T
    box = page.locator("#cloud").bounding_box()
    focal = box["height"] / 2 / np.tan(0.4)
    places = np.stack([box["width"] / 2 + focal * x / z, box["height"] / 2 - focal * y / z], axis=1)
    near = cKDTree(places).query(places, k=60)[1]
    inside = (of_point[near] == of_point[:, None]).all(1) & (z > 0)
    first = np.nonzero(inside & (z[near].max(1) - z[near].min(1) < 0.04 * away))[0]
    chosen = first[np.argmin(np.abs(places[first] - places[first].mean(0)).sum(1))]
    return of_point[chosen], (places[chosen] + [box["x"], box["y"]]).tolist()


def colorful(page, index):
    """[H, W] where a picture of the static page is lit: its colours differ from the faded photo's."""
    code = "([i]) => pictures[i].canvas.getContext('2d').getImageData(0, 0, 160, 120).data.join()"
    shown = np.array(page.evaluate(code, [index]).split(","), dtype=float).reshape(120, 160, 4)[..., :3]
    photo = np.array(page.evaluate("([i]) => pictures[i].photo.join()", [index]).split(","), dtype=float)
    return np.abs(shown - (0.5 * photo.reshape(120, 160, 4)[..., :3] + 64)).max(2) > 2


def lit(page, index):
    return int(colorful(page, index).sum())


def test_a_tap_selects_in_the_shared_page(phone, out, static):
    page = phone
    page.goto(static)
    page.wait_for_selector("canvas")
    wait(lambda: page.evaluate("cloud.center !== undefined"))
    labels = tj.load_result(out).points.numpy()
    label, (column, row) = place_in_shared_cloud(page, labels)
    box = page.locator("#cloud").bounding_box()
    page.touchscreen.tap(column, row)
    wait(lambda: page.inner_text("#told") == f"segment {label}")
    assert page.locator("#cloud").bounding_box() == box  # the button to clear makes no row of its own
    # Two fingers that part come nearer; one that moves turns. Both select nothing.
    fingers = page.context.new_cdp_session(page)

    def touch(kind, *places):
        points = [{"x": x, "y": y, "id": index} for index, (x, y) in enumerate(places)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    away, turn = page.evaluate("[cloud.away, cloud.turn]")
    touch("touchStart", (150, 300), (250, 300))
    touch("touchMove", (100, 300), (300, 300))
    touch("touchEnd")
    wait(lambda: page.evaluate("cloud.away") == pytest.approx(away / 2))
    assert page.evaluate("cloud.turn") == turn
    touch("touchStart", (150, 300))
    touch("touchMove", (200, 300))
    touch("touchEnd")
    wait(lambda: page.evaluate("cloud.turn") == pytest.approx(turn - 0.4))
    assert page.inner_text("#told") == f"segment {label}"
