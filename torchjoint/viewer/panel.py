"""The panel of the viewer's page: its elements from top to bottom. Their actions are in app.py."""

from typing import Any

from torchjoint.results.folder import read_granularity
from torchjoint.viewer.html import LEGEND, PREFIX, page_html, panel_html
from torchjoint.viewer.model import Model
from torchjoint.viewer.shown import Shown

#: The buttons of the group "View".
RESET, CLEAR = "Reset view", "Clear selection"
CLICKS = "click: this belongs to it, too; with shift: this does not; Undo takes the last click back"
CORRECT = "join the selected segments; split the selected one in two; undo joins, splits and names"
EXPORT = "download the points, the masks (ZIP), or the masks as JSON of the selected segments"
LEVEL = "0: coarse, 1: fine; only Save the level keeps it for the next time"
RELATIONS = "what stands on (green), hangs on (orange), contains (blue), touches (grey) the selected"
SAVE = "the granularity, in edits.json; corrections are saved there as they are made"
SHARE = {"min": 0.0, "max": 1.0}
FRONT = "hides walls that are in the way"


class Panel:
    """Elements of viser.

    Args:
        gui: of the server; its earlier elements are removed.
        model: the state of the viewer.
        shown: folder and run of the result.
        frame: index of the first shown frame.
        cameras: whether cameras are drawn.
    """

    def __init__(self, gui: Any, model: Model, shown: Shown, frame: int = 0, cameras: bool = False) -> None:
        gui.reset()
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()  # beside the cloud, not over it; it can be collapsed
        self.bridge = gui.add_text("events", PREFIX)  # the messages of the elements of html.py
        gui.add_html(page_html(model.result.scene.name))
        self.note = gui.add_html("", visible=shown.is_running)
        self.view = gui.add_button_group("View", (RESET, CLEAR))
        self.mode = gui.add_dropdown("Colour by", model.modes, initial_value=model.mode)
        self.legend = gui.add_html(LEGEND, visible=False)
        self.level: Any = None
        if model.result.hierarchy is not None:
            stored = None if shown.folder is None else read_granularity(shown.folder)
            at = next(level for level in (model.edits.granularity, stored, 0.5) if level is not None)
            self.level = gui.add_slider("Granularity", **SHARE, step=0.01, initial_value=at, hint=LEVEL)
        with gui.add_folder("Selection"):
            self.selection = gui.add_html(panel_html((), ()))
            self.several = gui.add_checkbox("Select several", False, hint="each click adds one, as with shift")
            self.by_clicks = gui.add_checkbox("Thing from clicks", False, visible=self.level is not None, hint=CLICKS)
            self.keep = gui.add_button("Make it one thing", visible=False, hint="a segment of its own, at every level")
            can_save = shown.folder is not None
            hint = "of the selected segment; the result will have it" if shown.is_running else "of the selected segment"
            self.name = gui.add_text("Name", "", hint=hint, visible=can_save or shown.is_running)
            self.correct = gui.add_button_group("Correct", ("Join", "Split", "Undo"), visible=can_save, hint=CORRECT)
            kinds = ("PLY", "PNG", "COCO") if len(model.result.scene.frames) else ("PLY",)
            self.export = gui.add_button_group("Export", kinds, hint=EXPORT)
            self.save = gui.add_button("Save the level", visible=can_save, hint=SAVE)
            self.relations = gui.add_checkbox("Relations", False, visible=not shown.is_running, hint=RELATIONS)
        pane = gui.add_panel()  # of its own: it is in view, whatever the panel above shows
        pane.dock_below(gui.main_panel)
        if len(model.result.scene.frames):
            with pane.add_tab("Photo"):
                self._add_image(gui, len(model.result.scene.frames) - 1, frame, cameras)
        elif shown.has_camera:
            with pane.add_tab("Photo"):
                self.image = gui.add_html("")
        with pane.add_tab("Segments"):
            can_find = shown.text_encoder is not None and model.result.saved_embeddings is not None
            self.words = gui.add_text("Words", "", hint="of a thing, such as: a red chair", visible=can_find)
            self.find = gui.add_button("Find the words", color="gray", visible=can_find)
            self.found = gui.add_html("", visible=can_find)
            self.search = gui.add_text("Search", "", hint="a part of a name, or an id")
            self.table = gui.add_html("")
        self.size = gui.add_slider("Point size", min=0.2, max=4.0, step=0.1, initial_value=1.0)
        self.front = gui.add_slider("Cut the front", **SHARE, step=0.02, initial_value=0.0, hint=FRONT)
        self.parameters: dict[str, Any] = {}
        if shown.run is not None:
            with gui.add_folder("Parameters"):
                self.parameters = {name: gui.add_number(name, value) for name, value in shown.run.parameters.items()}
                self.compute = gui.add_button("Compute again")

    def _add_image(self, gui: Any, last: int, frame: int, cameras: bool) -> None:
        self.image = gui.add_html("")
        self.frame = gui.add_slider("Frame", min=0, max=max(last, 1), step=1, initial_value=frame, visible=last > 0)
        hint = "0: the image alone, 1: the labels alone"
        self.opacity = gui.add_slider("Labels", **SHARE, step=0.05, initial_value=0.5, hint=hint)
        self.stand = gui.add_button("Stand at this camera", color="gray")
        self.cameras = gui.add_checkbox("Cameras", cameras, hint="draw them in the cloud")
