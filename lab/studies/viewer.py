"""Draws docs/viewer.webp, clicks.jpg and live.jpg, the viewer at work on the demo: `python lab/studies/viewer.py`.

A browser of the system (Chromium, by Playwright) clicks in the photo, turns the cloud, names the thing and exports it.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

import torchjoint as tj
from torchjoint.cli.demo import RECORDING
from torchjoint.results.folder import write_result
from torchjoint.viewer.app import Viewer
from torchjoint.viewer.live import GrowingView
from torchjoint.viewer.server import Page
from torchjoint.viewer.shown import Shown

DOCS = Path(__file__).parents[2] / "docs"
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
#: WebGL in software.
FLAGS = ["--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--no-sandbox"]
#: Pixels of the page, and of the picture.
PAGE, SIZE = (900, 660), (800, 587)
#: Where the thing is in the photo, in shares of its width and height; and its name.
PLACE, NAME = (0.24, 0.87), "chair"
#: Where the thing is in the page of a live run.
THING = (418, 412)
#: Where a click says "this, too", twice, and where "not this", in pixels of the page.
CLICKS = (290, 250), (385, 245), (260, 165)
#: A screenshot has no mouse: an arrow that follows it.
ARROW = """
addEventListener("DOMContentLoaded", () => {
  const arrow = document.createElement("div");
  arrow.style = "position:fixed;z-index:9999;pointer-events:none;left:450px;top:330px";
  arrow.innerHTML = `<svg width="22" height="30" viewBox="0 0 11 15">
    <path d="M0 0v12l3-3 2.5 5.5 2-1L5 8h4z" fill="#000" stroke="#fff" stroke-width=".8"/></svg>`;
  document.body.append(arrow);
  const style = document.createElement("style");
  // They would hide the cloud.
  style.textContent = ".mantine-Tooltip-tooltip, .mantine-Notifications-root { display: none !important }";
  document.head.append(style);
  addEventListener("pointermove", (event) => {
    arrow.style.left = `${event.clientX}px`;
    arrow.style.top = `${event.clientY}px`;
  }, true);
});
"""


class Film:
    """The frames so far, each with its milliseconds."""

    def __init__(self, page: Any) -> None:
        self._page, self._at = page, (450.0, 330.0)
        self.frames: list[Image.Image] = []
        self.durations: list[int] = []

    def show(self, milliseconds: int, wait: int = 0) -> None:
        """Adds what the page shows after it was left alone for a while."""
        self._page.wait_for_timeout(wait)
        frame = Image.open(io.BytesIO(self._page.screenshot())).convert("RGB")
        self.frames.append(frame.resize(SIZE, Image.Resampling.LANCZOS))
        self.durations.append(milliseconds)

    def go(self, x: float, y: float, steps: int = 4) -> None:
        """Moves the mouse in a straight line."""
        before = self._at
        for step in range(1, steps + 1):
            self._at = tuple(a + (b - a) * step / steps for a, b in zip(before, (x, y), strict=True))
            self._page.mouse.move(*self._at)
            self.show(90)

    def go_to(self, element: Any, place: tuple[float, float] = (0.5, 0.5)) -> None:
        """Moves the mouse to a place in an element, in shares of its width and height."""
        element.scroll_into_view_if_needed()
        box = element.bounding_box()
        self.go(box["x"] + place[0] * box["width"], box["y"] + place[1] * box["height"])

    def click(self) -> None:
        """Clicks where the mouse is."""
        self._page.mouse.click(*self._at)


def play(page: Any) -> Film:
    """Selects a thing in the photo, turns the cloud, names the thing and exports it."""
    film = Film(page)
    film.show(1500)
    film.go_to(page.locator("#tj-image"), PLACE)
    film.click()
    film.show(1600, wait=2500)
    film.go(330, 420)
    page.mouse.down()
    film.go(200, 440, steps=9)
    page.mouse.up()
    film.show(700, wait=500)
    film.go_to(page.locator("xpath=//*[text()='Name']/following::input[1]"))
    film.click()
    for letter in NAME:
        page.keyboard.type(letter)
        film.show(220, wait=700)
    film.show(600, wait=1000)
    film.go_to(page.get_by_role("button", name="PLY"))
    with page.expect_download():
        film.click()
    film.show(2500, wait=1000)
    return film


def draw_clicks(page: Any) -> None:
    """Makes one thing of clicks."""
    page.get_by_role("button", name="Clear selection").click()
    page.get_by_role("button", name="Reset view").click()
    page.get_by_role("checkbox", name="Thing from clicks").check()
    page.wait_for_timeout(1000)
    for place in CLICKS:
        if place == CLICKS[-1]:
            page.keyboard.down("Shift")
        page.mouse.click(*place)
        page.wait_for_timeout(1500)
    page.keyboard.up("Shift")
    page.mouse.move(890, 400)
    page.wait_for_timeout(1000)
    Image.open(io.BytesIO(page.screenshot())).convert("RGB").save(DOCS / "clicks.jpg", quality=85)


def draw(out: Path) -> None:
    """Writes the pictures of a result."""
    viewer = Viewer(tj.load_result(out, edits=False), Shown(out), page=Page(port=8940))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=FLAGS)
        page = browser.new_page(viewport={"width": PAGE[0], "height": PAGE[1]})
        page.add_init_script(ARROW)
        page.goto(viewer.page.url)
        page.wait_for_selector("#tj-image")
        page.wait_for_timeout(6000)
        film = play(page)
        draw_clicks(page)
        browser.close()
    viewer.stop()
    first, *others = film.frames
    picture = DOCS / "viewer.webp"
    first.save(picture, save_all=True, append_images=others, duration=film.durations, loop=0, quality=70, method=6)
    seconds, size = sum(film.durations) / 1000, picture.stat().st_size / 1e6
    print(f"{picture.name}: {len(film.frames)} frames, {seconds:.1f} seconds, {size:.2f} MB")


def draw_live(work: Path) -> None:
    """Writes the page of a live run, in the middle and at the end: two screenshots side by side."""
    frames = tj.load_scene(RECORDING, fuse=False).frames
    view, segmenter, shots = GrowingView(Page(port=8941)), tj.LiveSegmenter(), []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=FLAGS)
        page = browser.new_page(viewport={"width": 965, "height": 600})
        page.add_init_script(ARROW)
        page.goto(view.page.url)
        for count in (len(frames) // 2, len(frames)):
            segmenter.update(frames[len(segmenter.names) : count])
            result = segmenter.result()
            seen = tj.Scene(result.cloud.points, [*frames[:count]], result.cloud.colors)
            view.show(result, seen, f"after {count} frames: {len(result.ids)} things")
            view.camera(frames[count - 1])
            if count == len(frames):
                write_result(work, seen, result.segmentation, segmenter.config, "live")
                view.finish(work, result)
            page.wait_for_timeout(8000)
            if not shots:
                page.mouse.click(*THING)
                page.wait_for_timeout(2000)
                page.locator("xpath=//*[text()='Name']/following::input[1]").fill(NAME)
                page.wait_for_timeout(3000)
            shots.append(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))
        browser.close()
    view.viewer.stop()
    both = Image.new("RGB", (2 * shots[0].width, shots[0].height))
    for place, shot in enumerate(shots):
        both.paste(shot, (place * shot.width, 0))
    both.save(DOCS / "live.jpg", quality=85)


def main() -> None:
    with tempfile.TemporaryDirectory() as work:
        out = Path(work, "demo")
        subprocess.run([sys.executable, "-m", "torchjoint", "demo", "-o", str(out)], check=True)
        draw(out)
        draw_live(Path(work))


if __name__ == "__main__":
    main()
