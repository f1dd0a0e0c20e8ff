"""The viewer's page: a panel of controls beside the cloud, and what happens at each click."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchjoint.results.edits import Edits, read_edits, write_edits
from torchjoint.results.folder import read_granularity
from torchjoint.results.parts import Parts
from torchjoint.results.result import Result
from torchjoint.results.upright import up_direction
from torchjoint.runtime.extras import needed_for
from torchjoint.viewer.cameras import add_frustum, add_frustums, start, viewpoint
from torchjoint.viewer.cloud import CloudView
from torchjoint.viewer.html import HIDE_FIELD, PREFIX, image_html, panel_html, table_html
from torchjoint.viewer.model import Model
from torchjoint.viewer.parameters import LiveRun, add_parameters
from torchjoint.viewer.pick import pick_point
from torchjoint.viewer.selection import export_selected


class Viewer:
    """A result in the browser: cloud, images, a table of segments, levels, and corrections by hand.

    It serves a page until :meth:`stop`, or as long as the program runs.

    Args:
        result: as on disk, without corrections.
        folder: where corrections are read, saved (edits.json), and selections are exported; None: nowhere.
        run: the run that made the result, if it is still in memory: its parameters can then be changed on the page.
        granularity: level to start with, 0 (coarse) to 1 (fine); None: as on disk, or as corrected.
        up: [3] upward direction in the world frame; None: from the poses and the largest level plane.
        host, port: of the page. The default host is this machine alone; if the port is taken, the next one is used.

    Raises:
        ModuleNotFoundError: viser is not installed.
        ValueError: edits.json is damaged, or of another result.
    """

    def __init__(
        self,
        result: Result,
        folder: Path | None = None,
        *,
        run: LiveRun | None = None,
        granularity: float | None = None,
        up: Tensor | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        with needed_for("the viewer", "viser", "torchjoint[viewer]"):
            import viser
        upward = (
            up_direction(result.scene) if up is None else torch.nn.functional.normalize(up.double(), dim=0)
        ).numpy()
        count = Parts(result).count
        edits = Edits(count) if folder is None else read_edits(folder, count)
        if granularity is not None:
            edits = replace(edits, granularity=granularity)
        self.model, self.folder, self.result = Model(result, edits, upward), folder, result
        self._lock = threading.RLock()  # viser calls back from several threads
        self._order, self._can_save = "points", True
        self.server: Any = viser.ViserServer(host=host, port=port, label="torchjoint", verbose=False)
        self.server.scene.set_up_direction(tuple(upward))
        position, target = start(result.scene, upward)
        self.server.initial_camera.position, self.server.initial_camera.look_at = position, target
        self._points = result.scene.points.numpy()
        self._cloud = CloudView(self.server, self._points, self.model.point_colors())
        self._run = run
        self._build_panel()
        self._connect_scene(float(np.linalg.norm(position - target)))
        threading.Thread(target=self._read_frames, daemon=True).start()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self.server.get_host().replace('0.0.0.0', 'localhost')}:{self.server.get_port()}"

    def wait(self) -> None:
        """Serves the page until the program is interrupted."""
        self.server.sleep_forever()

    def stop(self) -> None:
        """Ends the page."""
        self.server.stop()

    # The page

    def _build_panel(self) -> None:
        gui, model = self.server.gui, self.model
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self._bridge = gui.add_text("events", PREFIX)
        self._bridge.on_update(lambda _: self._guarded(self._on_event, self._bridge.value))
        gui.add_html(HIDE_FIELD)
        self._mode = gui.add_dropdown("Colour by", model.modes, initial_value=model.mode)
        self._mode.on_update(lambda _: self._guarded(self._on_mode))
        if self.result.hierarchy is not None:
            stored = read_granularity(self.folder) if self.folder is not None else None
            at = next(level for level in (model.edits.granularity, stored, 0.5) if level is not None)
            self._level = gui.add_slider("Granularity", min=0.0, max=1.0, step=0.01, initial_value=at)
            self._level.on_update(lambda _: self._guarded(self._on_level))
        size = gui.add_slider("Point size", min=0.2, max=4.0, step=0.1, initial_value=1.0)
        size.on_update(lambda _: self._cloud.resize(size.value))
        if len(self.result.scene.frames):
            self._build_image()
        with gui.add_folder("Selection"):
            self._panel = gui.add_html(panel_html((), ()))
            self._build_buttons()
        if self._run is not None:
            add_parameters(gui, self._run, lambda values: self._guarded(self._on_parameters, values))
        with gui.add_folder("Segments"):
            self._search = gui.add_text("Search", "", hint="a part of a name, or an id")
            self._search.on_update(lambda _: self._guarded(self._draw_table))
            self._table = gui.add_html("")
        self._draw_table()

    def _build_image(self) -> None:
        gui, count = self.server.gui, len(self.result.scene.frames)
        with gui.add_folder("Images"):
            self._frame = gui.add_slider("Frame", min=0, max=max(count - 1, 1), step=1, initial_value=0)
            self._opacity = gui.add_slider("Labels", min=0.0, max=1.0, step=0.05, initial_value=0.5)
            self._image = gui.add_html("")
            here = gui.add_button("Stand at this camera")
        self._frame.on_update(lambda _: self._guarded(self._on_frame))
        self._opacity.on_update(lambda _: self._guarded(self._draw_image))
        here.on_click(lambda event: self._stand_at(self._frame_index(), event.client))
        self._draw_image()

    def _build_buttons(self) -> None:
        gui = self.server.gui
        self._name = gui.add_text("Name", "", hint="of the selected segment")
        self._name.on_update(lambda _: self._guarded(self._on_name))
        first = gui.add_button_group("Correct", ("Join", "Split", "Undo"))
        first.on_click(lambda _: self._guarded(self._on_correct, first.value))
        kinds = ("PLY", "PNG", "COCO")
        second = gui.add_button_group("Export", kinds, visible=self.folder is not None)
        second.on_click(lambda _: self._guarded(self._on_export, second.value))
        save = gui.add_button("Save corrections", visible=self.folder is not None)
        save.on_click(lambda _: self._guarded(self._on_save))
        clear = gui.add_button("Clear selection")
        clear.on_click(lambda _: self._guarded(self._select, ()))

    def _connect_scene(self, distance: float) -> None:
        self._camera_size = 0.02 * distance
        add_frustums(self.server, self.result.scene, self._camera_size, self._stand_at)
        if len(self.result.scene.frames):
            self._draw_camera()

        for modifier in (None, "shift"):
            self.server.scene.on_click(modifier=modifier)(
                lambda event, more=modifier is not None: self._guarded(self._on_ray, event, more)
            )

        @self.server.on_client_connect
        def _(client: Any) -> None:
            client.camera.on_update(lambda camera: self._guarded(self._cloud.look_from, camera.position))

    # What happens

    def _guarded(self, action: Any, *arguments: Any) -> None:
        """Runs an action, one at a time; says on the page what is not possible."""
        with self._lock:
            try:
                action(*arguments)
            except (ValueError, OSError, ModuleNotFoundError) as error:
                self._say(str(error), "red")

    def _say(self, text: str, color: str = "green") -> None:
        for client in self.server.get_clients().values():
            client.add_notification("torchjoint", text, color=color, auto_close_seconds=6.0)

    def _on_event(self, line: str) -> None:
        kind, *values = line.removeprefix(PREFIX).split()[:-1] or [""]  # the last word is the time
        if kind == "sort":
            self._order = values[0]
            self._draw_table()
        elif kind == "row":
            self._choose(self.model.segment_of_key(int(values[0])), values[1] == "1")
        elif kind == "image":
            pieces = self.model.parts.image(self._frame_index())
            piece = int(pieces[min(int(values[1]), len(pieces) - 1), min(int(values[0]), pieces.shape[1] - 1)])
            self._choose(None if piece < 0 else int(self.model.table[piece]), values[2] == "1")

    def _on_ray(self, event: Any, more: bool) -> None:
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        point = pick_point(self._points, origin, direction, 0.5 * self._cloud.size)
        self._choose(None if point is None else int(self.model.table[self.model.parts.of_point[point]]), more)

    def _choose(self, segment: int | None, more: bool) -> None:
        """Selects a segment, or with shift adds it or takes it away; nothing was hit: clears the selection."""
        before = self.model.selected
        if not more:
            self._select(() if segment is None else (segment,))
        elif segment is not None:
            self._select(tuple(s for s in before if s != segment) if segment in before else (*before, segment))

    def _select(self, segments: tuple[int, ...]) -> None:
        self.model.select(segments)
        self._name.value = self.model.names().get(segments[0], "") if len(segments) == 1 else ""
        self._draw()

    def _on_parameters(self, values: dict[str, float]) -> None:
        """Shows the result with other parameters; corrections of another result mean nothing here, and go."""
        assert self._run is not None  # without a run there are no parameters
        self._say("computing again ...", "blue")
        result = self._run.compute(values)
        self.model, self.result, self._can_save = self.model.of_result(result), result, False
        self.model.read_frames()
        self._draw()
        self._say(f"{result.num_point_segments} segments; OUT keeps its result: run `segment` with --set to write this")

    def _on_mode(self) -> None:
        self.model.mode = self._mode.value
        self._draw()

    def _on_level(self) -> None:
        self.model.set_granularity(self._level.value)
        self._draw()

    def _on_frame(self) -> None:
        self._draw_image()
        self._draw_camera()

    def _on_name(self) -> None:
        selected = self.model.selected
        if len(selected) == 1 and self._name.value != self.model.names().get(selected[0], ""):
            self.model.name(self._name.value)
            self._draw_lists()

    def _on_correct(self, action: str) -> None:
        if action == "Undo":
            if not self.model.undo():
                self._say("there is nothing to undo", "blue")
        elif action == "Join":
            self.model.join()
        else:
            self.model.split()
        self._draw()

    def _on_save(self) -> None:
        assert self.folder is not None  # without a folder the button is not shown
        if not self._can_save:
            raise ValueError("save: these are not the parameters of the result on disk")
        write_edits(self.folder, self.model.edits)
        self._say(f"{len(self.model.edits.steps)} corrections saved to {self.folder / 'edits.json'}")

    def _on_export(self, kind: str) -> None:
        assert self.folder is not None
        self._say(f"written: {export_selected(self.model, self.folder / 'selection', kind)}")

    def _stand_at(self, index: int, client: Any) -> None:
        view = viewpoint(self.result.scene.frames[index])
        with client.atomic():
            client.camera.wxyz, client.camera.position, client.camera.fov = view.wxyz, view.position, view.fov
        if self._frame_index() != index:
            self._frame.value = index  # which draws the image

    # Drawing

    def _frame_index(self) -> int:
        return min(int(self._frame.value), len(self.result.scene.frames) - 1)

    def _draw(self) -> None:
        self._cloud.recolor(self.model.point_colors())
        self._draw_lists()
        if len(self.result.scene.frames):
            self._draw_image()

    def _draw_lists(self) -> None:
        selected = self.model.selected
        frames = self.model.frames_of(selected[0]) if len(selected) == 1 else []
        seen = [(self.result.names[index], pixels) for index, pixels in frames]
        self._panel.content = panel_html([self.model.row(segment) for segment in selected[:10]], seen)
        self._draw_table()

    def _draw_table(self) -> None:
        rows, count = self.model.rows(self._search.value, self._order)
        self._table.content = table_html(rows, count, self._order, [self.model.key(s) for s in self.model.selected])

    def _draw_image(self) -> None:
        index = self._frame_index()
        self._image.content = image_html(self.model.painted(index, self._opacity.value), self.result.names[index])

    def _draw_camera(self) -> None:
        """Marks the camera of the frame that is shown."""
        index = self._frame_index()
        add_frustum(self.server, "/camera", self.result.scene.frames[index], 1.6 * self._camera_size, (230, 90, 0))

    def _read_frames(self) -> None:
        """Counts what each frame sees, while the page can already be used."""
        self.model.read_frames()
        self._guarded(self._draw_lists)
