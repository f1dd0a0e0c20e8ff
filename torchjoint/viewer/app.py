"""The viewer's page: a panel of controls beside the cloud, and the reaction to each click."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from torchjoint.results.edits import Table
from torchjoint.results.render import Shading
from torchjoint.results.result import Result
from torchjoint.results.shared_edits import save_edits
from torchjoint.results.upright import up_direction
from torchjoint.runtime.messages import counted, printable, say
from torchjoint.viewer.cloud import CloudView, pick_point
from torchjoint.viewer.html import COLUMNS, PREFIX, found_html, image_html, note_html, panel_html, table_html
from torchjoint.viewer.measures import hues_of_keys
from torchjoint.viewer.model import Bytes, Model, export_selected
from torchjoint.viewer.painting import RelationLines, painted, point_colors
from torchjoint.viewer.panel import RESET, Panel
from torchjoint.viewer.server import Cameras, Eyes, FairLock, Page, Viewpoint, add_camera, ray_of, viewpoint
from torchjoint.viewer.shown import Shown


class Viewer:
    """A result in the browser: cloud, images, a table of segments, levels, and corrections by hand.

    Args:
        result: the result as on disk, without corrections.
        shown: folder and run of the result; default: neither.
        granularity: level to start with, 0 (coarse) to 1 (fine); None: as on disk, or as corrected.
        page: shows it; default: a new page.

    Raises:
        ModuleNotFoundError: viser is not installed.
        ValueError: edits.json is damaged, or belongs to another result.
    """

    def __init__(
        self, result: Result, shown: Shown | None = None, *, granularity: float | None = None, page: Page | None = None
    ) -> None:
        self._shown = shown or Shown()
        self._saved = self._shown.edits(result, granularity)  # the corrections as they were read or saved last
        self.model = Model(result, self._saved, up_direction(result.scene).numpy())
        self._chooser: Any = None  # the page that chose what is selected; others may still mean something else
        self._lock = FairLock()  # viser calls the functions below on several threads
        self._order = "points"
        self._made = self._saved.steps  # the corrections after the last action
        self.page = page or Page()
        self.server, self.page.not_kept = self.page.server, self.not_kept
        self._eyes = Eyes(self.server, result.scene, self.model.up)
        self._cloud = CloudView(self.server, result.scene.points.numpy(), point_colors(self.model))
        self._relations = RelationLines(self.server)
        self._cameras: Any = None  # where there are frames
        with self._lock:
            self._add_panel()
            self._connect_scene()
        self._work_behind()

    @property
    def result(self) -> Result:
        """The shown result, without corrections."""
        return self.model.result

    @property
    def _has_frames(self) -> bool:
        return len(self.result.scene.frames) > 0

    @property
    def folder(self) -> Path | None:
        """The folder in which corrections are saved; None: they cannot be saved."""
        return self._shown.folder

    def replace(self, result: Result, shown: Shown | None = None) -> None:
        """Shows another result of the same scene.

        Args:
            result: the other result. Corrections stay if it has the same superpoints, and names while a run goes on.
            shown: its folder and run, if it is the last one: with their corrections, and the controls that they allow.

        Raises:
            ValueError: edits.json is damaged, or belongs to another result.
        """
        with self._lock:
            self._show(self.model.of_result(result, None if shown is None else shown.edits(result)), shown, False)

    def grow(self, result: Result, shading: Shading, shown: Shown | None = None, hues: Table | None = None) -> None:
        """Shows a result with another cloud; what is selected or named stays so, by the colours of the segments.

        Args:
            result: the other result.
            shading: of its points.
            shown: as of :meth:`replace`.
            hues: [S] numbers of the colours of its segments; default: their own numbers.
        """
        with self._lock:
            chosen = self.model.measures.hues[[*self.model.selected]]
            model = Model(result, (shown or self._shown).edits(result), self.model.up)
            if hues is not None:
                model.measures.hues = hues_of_keys(hues, model.parts.keys)
            model.mode, model.pale, model.shading = self.model.mode, self.model.pale, shading
            model.select(tuple(np.unique(model.table[np.isin(model.measures.hues[model.table], chosen)]).tolist()))
            self._cloud.remove()
            self._cloud = CloudView(self.server, result.scene.points.numpy(), point_colors(model))
            self._eyes.show_more(result.scene)
            self._show(model, shown, True)

    def _show(self, model: Model, shown: Shown | None, has_grown: bool) -> None:
        read = model.edits  # without names of a run, which are not saved yet
        if self._shown.is_running:
            model.take_names(self.model, has_grown)
            if shown is not None and model.waiting:
                say(f"not kept: names of things that are gone: {', '.join(name for name, *_ in model.waiting)}")
        kept = (self._frame_index(), self._panel.cameras.value) if self._has_frames else ()
        self.model = model
        if shown is not None:
            self._shown, self._saved, self._made = shown, read, read.steps
            self._add_panel(*kept)
            self._work_behind()
        self._guarded(self._draw)

    def draw_camera(self, view: Viewpoint, share: float, photo: Bytes) -> None:
        """Draws a camera, in the place of the last one; its size is a share of the distance of the first view."""
        with self._lock:
            add_camera(self.server, "/camera", view, share * self._eyes.distance, (230, 90, 0))
            self._panel.image.content = image_html(photo, "camera")

    def tell(self, note: str) -> None:
        """Writes a line at the top of the panel of a run that is not finished."""
        with self._lock:
            self._panel.note.content = note_html(note)

    def not_kept(self) -> str:
        """What the page has and edits.json has not, in words; "": nothing."""
        now, kept = self.model.edits, self._saved
        if now.steps != kept.steps:
            running = "names of a run that has not ended; its result would have had them"
            return running if self._shown.is_running else "corrections after those in edits.json"
        return f"level {now.granularity}, which Save the level keeps" if now.granularity != kept.granularity else ""

    def stop(self) -> None:
        """Ends the page, after what works behind it."""
        self.page.stop()

    def _add_panel(self, frame: int = 0, cameras: bool = False) -> None:
        """Builds a new panel, and connects its elements to their actions."""
        panel = self._panel = Panel(self.server.gui, self.model, self._shown, frame, cameras)
        self._query: Tensor | None = None  # the vector of the words that were searched
        self._named = ""  # what the field of the name has, but for letters that wait for another action

        def then(action: Any) -> Any:
            return lambda _: self._guarded(action)

        # What was clicked is read at once: while another action works, the next click may change it.
        panel.bridge.on_update(lambda event: self._guarded(self._on_event, panel.bridge.value, event.client))
        panel.mode.on_update(then(lambda: self._change(lambda: self.model.color_by(panel.mode.value))))
        panel.name.on_update(self._on_typed)
        panel.relations.on_update(then(self._draw_relations))
        panel.search.on_update(then(self._draw_table))
        panel.find.on_click(lambda event: self._guarded(self._on_find, event.client))
        panel.correct.on_click(lambda event: self._guarded(self._on_correct, panel.correct.value, event.client))
        panel.by_clicks.on_update(lambda _: setattr(panel.keep, "visible", panel.by_clicks.value and bool(self.folder)))
        panel.keep.on_click(lambda event: self._guarded(self._on_correct, "Keep", event.client))
        panel.export.on_click(lambda event: self._guarded(self._on_export, panel.export.value, event.client))
        panel.save.on_click(then(self._on_save))
        panel.view.on_click(lambda event: self._guarded(self._on_view, panel.view.value, event.client))
        panel.size.on_update(then(lambda: self._cloud.resize(panel.size.value)))
        panel.front.on_update(then(lambda: self._eyes.cut_front(panel.front.value)))
        if panel.level is not None:
            panel.level.on_update(lambda event: self._guarded(self._on_level, panel.level.value, event.client))
        if panel.parameters:
            panel.compute.on_click(then(self._on_parameters))
        if self._has_frames:
            seen = self._cameras = self._cameras or Cameras(self.server, self.result.scene, 0.02 * self._eyes.distance)
            seen.mark(frame)
            panel.frame.on_update(then(self._on_frame))
            panel.cameras.on_update(then(lambda: seen.show(panel.cameras.value)))
            panel.opacity.on_update(then(self._draw_image))
            panel.stand.on_click(lambda event: self._guarded(self._stand_at, self._frame_index(), event.client))
        self._draw()

    def _connect_scene(self) -> None:
        for modifier, more in ((None, False), ("shift", True)):
            clicked = self.server.scene.on_click(modifier=modifier)
            clicked(lambda event, more=more: self._guarded(self._on_ray, event, more))

        @self.server.on_client_connect
        def _(client: Any) -> None:
            client.camera.on_update(lambda _: self._guarded(self._on_camera, client))
            self._guarded(self._on_camera, client)  # the first camera is told before this

        self.server.on_client_disconnect(lambda one: self._guarded(self._on_leave, one, self.server.get_clients()))

    # Reactions to events

    def _guarded(self, action: Any, *arguments: Any) -> None:
        """Runs an action, one at a time; shows the message of an error on the page."""
        with self._lock:
            if self.page.has_stopped:
                return
            try:
                try:
                    action(*arguments)
                finally:  # a correction is made before it is drawn, which may fail
                    self._save_what_was_made()
            except Exception as error:
                self._say(str(error) or repr(error), "red")
                if not isinstance(error, (ValueError, OSError, ModuleNotFoundError)):
                    raise  # a mistake of the program: with its place, in the terminal

    def _say(self, text: str, color: str = "green") -> None:
        for client in self.server.get_clients().values():
            stays = 30.0 if color == "red" else 6.0  # who looks elsewhere must not miss an error
            client.add_notification("torchjoint", printable(text), color=color, auto_close_seconds=stays)

    def _on_event(self, event: str, client: Any) -> None:
        kind, *values = event.removeprefix(PREFIX).split()[:-1] or [""]  # the last word is the time
        if kind == "sort" and values[0] in COLUMNS:
            self._order = values[0]
            self._draw_table()
        elif kind == "dark":
            client.gui.configure_theme(dark_mode=values[0] == "1", show_logo=False, show_share_button=False)
            before, self.model.pale = self.model.pale, 40.0 if values[0] == "1" else 235.0
            if self.model.selected and self.model.pale != before:
                self._draw()
        elif kind == "hover":
            self._on_hover(client, [*map(float, values)])
        elif kind == "row":
            self._choose(self.model.segment_of_hue(int(values[0])), values[1] == "1", client)
        elif kind == "image" and self._has_frames:
            superpoints = self.model.parts.image(self._frame_index())
            # An edge may give -1.
            column, row = np.clip([*map(int, values[:2])], 0, np.array(superpoints.shape[::-1]) - 1)
            superpoint = int(superpoints[row, column])
            self._on_point(None if superpoint < 0 else self.model.parts.middle(superpoint), values[2] == "1", client)

    def _on_ray(self, event: Any, more: bool) -> None:
        ray = np.array(event.ray_origin), np.array(event.ray_direction)
        self._on_point(pick_point(self.result.scene.points.numpy(), *ray, 0.5 * self._cloud.size), more, event.client)

    def _on_point(self, point: int | None, more: bool, client: Any) -> None:
        """A click on a point of the cloud: selects its segment, or belongs to the thing that is being picked."""
        if self._panel.by_clicks.value and point is not None:
            self._chooser = client
            self._change(lambda: self.model.click(point, not more))
        else:
            segment = None if point is None else int(self.model.table[self.model.parts.of_point[point]])
            self._choose(segment, more, client)

    def _on_hover(self, client: Any, place: list[float]) -> None:
        """Lights up what is under the mouse, which rests at a place of the canvas, [2] shares; []: it is elsewhere."""
        ray = ray_of(client.camera, *place) if place else None
        point = None if ray is None else pick_point(self.result.scene.points.numpy(), *ray, 0.5 * self._cloud.size)
        self._cloud.unlight()
        if point is not None:
            segments = self.model.table[self.model.parts.of_point]
            members = np.flatnonzero((segments == segments[point]) & ~np.isin(segments, self.model.selected))
            name = f"{self.model.key(segments[point])} {self.model.names.get(segments[point], '')}"
            self._cloud.light(client, name, point, members)

    def _on_camera(self, client: Any) -> None:
        if self._eyes.follow(client, self.result.scene):
            self._draw()
        self._cloud.look_from(client.camera.position)

    def _on_leave(self, client: Any, others: Any) -> None:
        if not others:  # then: the next page is the same one, loaded again, perhaps while another action worked
            self._chooser = None
        if self._eyes.forget(client):
            self._draw()

    def _change(self, change: Callable[[], object]) -> None:
        """Changes the model, and draws what it is now."""
        change()
        self._draw()

    def _check(self, client: Any) -> None:
        """Raises if what is selected was chosen by another page: this one may still mean what was selected before."""
        if self._chooser not in (None, client):
            raise ValueError("another page has chosen what is selected: select here what you mean, and try again")

    def _choose(self, segment: int | None, more: bool, client: Any) -> None:
        """Selects a segment; with shift, adds it to the selection or removes it. None clears the selection."""
        before = self.model.selected
        if not (more or self._panel.several.value):
            self._select(() if segment is None else (segment,), client)
        elif segment is not None:
            self._select(tuple(s for s in before if s != segment) if segment in before else (*before, segment), client)

    def _select(self, segments: tuple[int, ...], client: Any) -> None:
        self._chooser = client
        self._change(lambda: self.model.select(segments))
        frames = [index for index, _ in self.model.measures.frames_of(segments[0])] if len(segments) == 1 else []
        if frames and self._frame_index() not in frames:
            self._panel.frame.value = frames[0]  # which draws the image

    def _on_parameters(self) -> None:
        """Shows the result of other parameters, which is in no folder: it cannot be corrected."""
        assert self._shown.run is not None  # without a run there are no parameters
        self._say("computing again ...", "blue")
        result = self._shown.run.compute({name: float(field.value) for name, field in self._panel.parameters.items()})
        self._shown = replace(self._shown, folder=None)
        for control in (self._panel.name, self._panel.correct, self._panel.keep, self._panel.save):
            control.visible = False
        self.replace(result)
        self._work_behind()
        found = counted(result.num_point_segments, "segment")
        self._say(f"{found}; not written to OUT, nor corrected: run `segment` with --set to write this")

    def _on_view(self, action: str, client: Any) -> None:
        self._eyes.show_all(client, self.result.scene) if action == RESET else self._select((), client)

    def _on_frame(self) -> None:
        self._draw_image()
        self._cameras.mark(self._frame_index())

    def _on_typed(self, event: Any) -> None:
        if event.client is not None:  # else it was drawn, perhaps by an action that letters wait for
            name = printable(self._panel.name.value)  # a field takes what was pasted
            self._guarded(self._on_name, name, event.client)

    def _on_name(self, name: str, client: Any) -> None:
        if name != (before := self._selected_name()):
            try:
                self._check(client)
                self.model.name(name)
            except ValueError:  # only then: after a success the user may have typed on
                self._panel.name.value = before
                raise
            self._named = name
            if self._panel.name.value == before:  # the action that the letters waited for has drawn it
                self._panel.name.value = name
            self._draw_lists()

    def _selected_name(self) -> str:
        selected = self.model.selected
        return self.model.names.get(selected[0], "") if len(selected) == 1 else ""

    def _on_correct(self, action: str, client: Any) -> None:
        self._check(client)
        if action == "Undo" and self.model.clicks:
            self.model.unclick()
        elif action == "Undo":
            self._say(f"undone: {self.model.undo() or 'nothing is left to undo'}", "blue")
        else:
            {"Join": self.model.join, "Split": self.model.split, "Keep": self.model.keep}[action]()
        self._draw()

    def _on_level(self, level: float, client: Any) -> None:
        self._chooser = client
        self._change(lambda: self.model.set_granularity(level))

    def _on_find(self, client: Any) -> None:
        assert self._shown.text_encoder is not None  # without it there is no button
        query = self._shown.text_encoder(self._panel.words.value)
        best = self.model.find(query, 1)  # raises before the list is made of it
        self._query = query
        self._select(tuple(segment for segment, _ in best), client)

    def _on_save(self) -> None:
        assert self.folder is not None  # without a folder there is no button
        self._save(self.folder)
        self._say(f"level saved with {counted(len(self._saved.steps), 'correction')}, in {self.folder / 'edits.json'}")

    def _save_what_was_made(self) -> None:
        """Saves each correction as it is made: a closed page or Ctrl-C loses nothing. A level alone is none.

        What cannot be saved, as in a folder of others, is told once, not with each movement of the camera.
        """
        before, self._made = self._made, self.model.edits.steps
        if self.folder is not None and self._made not in (self._saved.steps, before):
            self._save(self.folder)

    def _save(self, folder: Path) -> None:
        saved = save_edits(folder, self.model.edits, self._saved, self.model.parts)
        if saved.steps != self.model.edits.steps:
            self._say("others have corrected this result, too; their corrections are shown now", "blue")
            self._change(lambda: self.model.take(saved))
        self._saved, self._made = saved, saved.steps

    def _on_export(self, kind: str, client: Any) -> None:
        if self.model.selected:
            self._say(f"{kind}: the download comes ...", "blue")
        client.send_file_download(*export_selected(self.model, kind), save_immediately=True)

    def _stand_at(self, index: int, client: Any) -> None:
        photo = painted(self.model, index, 0.0)
        self._eyes.stand_at(client, viewpoint(self.result.scene.frames[index]), photo, self.model.pale < 100)
        self._draw()
        if self._frame_index() != index:
            self._panel.frame.value = index  # which draws the image

    def _frame_index(self) -> int:
        return min(int(self._panel.frame.value), len(self.result.scene.frames) - 1)

    def _draw(self) -> None:
        self._cloud.unlight()
        lit = np.isin(self.model.table, self.model.selected)[self.model.parts.of_point]
        # A photo is seen between the points, and only the selected ones are before it.
        self._cloud.resize((0.24 if self._eyes.standing else 1.0) * self._panel.size.value)
        self._cloud.recolor(point_colors(self.model), lit if self._eyes.standing and self.model.selected else None)
        self._cloud.mark(self.model.clicks)
        self._panel.legend.visible = self.model.mode == "confidence"
        if (name := self._selected_name()) != self._named:  # else what is typed right now would lose letters
            self._named = self._panel.name.value = name
        self._draw_lists()
        self._draw_relations()
        if self._has_frames:
            self._draw_image()

    def _draw_relations(self) -> None:
        self._relations.show(self.model if self._panel.relations.value else None)

    def _draw_lists(self) -> None:
        selected = self.model.selected
        frames = self.model.measures.frames_of(selected[0]) if len(selected) == 1 else []
        seen = [(self.result.names[index], pixels) for index, pixels in frames]
        self._panel.selection.content = panel_html([self.model.row(segment) for segment in selected[:10]], seen)
        found = [] if self._query is None else self.model.find(self._query)
        self._panel.found.content = found_html([(self.model.row(segment), cosine) for segment, cosine in found])
        self._draw_table()

    def _draw_table(self) -> None:
        rows, count = self.model.rows(self._panel.search.value, self._order)
        self._panel.table.content = table_html(rows, count, self._order, [*map(self.model.key, self.model.selected)])

    def _draw_image(self) -> None:
        index = self._frame_index()
        image = painted(self.model, index, self._panel.opacity.value)
        self._panel.image.content = image_html(image, self.result.names[index])

    def _work_behind(self) -> None:
        """Shades the points and counts each frame's pixels in the background; the page can already be used."""
        model, is_running = self.model, self._shown.is_running

        def work() -> None:
            if model.shading is None and not self.page.has_stopped:
                self._guarded(self._shade, model, Shading(model.result.scene.points, model.up))
            if not is_running and not self.page.has_stopped:  # labelling all frames is most of a run's work
                with suppress(ValueError, OSError):  # the page tells of an image that cannot be read where it is drawn
                    model.measures.read_frames(lambda: self.page.has_stopped)
                self._guarded(self._draw_lists)

        self.page.work(work)

    def _shade(self, model: Model, shading: Shading) -> None:
        if len(model.parts.of_point) == len(self.model.parts.of_point):  # else another cloud is shown by now
            self.model.shading = shading
            self._cloud.recolor(point_colors(self.model))
