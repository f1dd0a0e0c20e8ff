"""The state of the viewer, independent of the browser: level, corrections, selection, clicks."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt
import torch
from PIL import Image
from torch import Tensor

from torchjoint.datasets.files.ply import write_cloud
from torchjoint.results.edits import LONGEST, Edit, Edits, Table, place_to_split
from torchjoint.results.exports.masks import export_coco
from torchjoint.results.parts import Parts
from torchjoint.results.render import Shading
from torchjoint.results.result import Result
from torchjoint.runtime.files import frame_files, portable_name
from torchjoint.runtime.threads import LazySequence
from torchjoint.viewer.measures import Measures, Row, kept_numbers


class Click(NamedTuple):
    """A click on a point of the cloud."""

    point: int
    belongs: bool  #: to the thing; False: the thing ends before it


def superpoints_of_clicks(parts: Parts, edits: Edits, clicks: Sequence[Click]) -> Table:
    """The superpoints of the thing of one or more clicks, ascending; those on one segment give it, with corrections."""
    table = parts.table(edits)
    segments = np.unique(table[parts.of_point[[one.point for one in clicks]]])
    if len(segments) == 1 and all(one.belongs for one in clicks):
        return np.flatnonzero(table == segments)
    points = ([one.point for one in clicks if one.belongs == of] for of in (True, False))
    on, off = (torch.tensor(each, dtype=torch.int64) for each in points)
    result, level = parts.result, edits.granularity
    if result.hierarchy is not None and level is not None:  # its labels and default level become the shown ones
        default = result.hierarchy.height_of(level)
        result = replace(result.at(level), hierarchy=replace(result.hierarchy, default=default))
    return result.pick(on, negative=off).superpoints.numpy()


Bytes = npt.NDArray[np.uint8]
Mode = Literal["segments", "colours", "confidence", "initial", "truth"]


class Model:
    """The state of the viewer; it keeps the corrections before each change, for :meth:`undo`.

    Args:
        result: the result as on disk, without corrections.
        edits: corrections to start with.
        up: [3] upward direction, unit length.

    Attributes:
        pale: grey of what is not selected, 0 to 255; nearly the page's background.
        shading: of the points, once it is computed; without it colours are flat.
        table: [P] the segment of each superpoint; the number of a segment is that of its first superpoint.
        names: by segment.
        measures: of the segments.
        clicks: on the thing that is being picked.
    """

    def __init__(self, result: Result, edits: Edits, up: npt.NDArray[np.float64]) -> None:
        self.parts, self.up = Parts(result), up
        self.result = result
        self.edits = edits
        self.selected: tuple[int, ...] = ()  # first superpoints of segments
        self.mode: Mode = "segments"
        self.shading: Shading | None = None
        self.pale = 235.0
        self.table, self.names = self.parts.table(edits), self.parts.names(edits)
        self.clicks: tuple[Click, ...] = ()
        self.waiting: list[tuple[str, int, Table]] = []  # names of things that are gone, their colours and points
        self._picked: tuple[Edit, ...] = ()  # shown as if it were a correction
        self._before: list[tuple[Edit, ...]] = []  # the corrections before each change, for undo
        self.measures = Measures(self.parts, up)
        self.measures.of_table(self.table, self.parts.ids(edits))

    def of_result(self, result: Result, edits: Edits | None = None) -> Model:
        """The same view of another result of the scene; selection and colours are kept as far as segments match.

        Args:
            result: the other result.
            edits: its corrections; default: those of this one, if the superpoints are the same.
        """
        parts = Parts(result)
        if edits is None:
            same = np.array_equal(parts.of_point, self.parts.of_point)
            edits = self.edits if same else replace(self.edits, num_superpoints=parts.count, steps=())
        model = Model(result, edits, self.up)
        model.shading, model.pale = self.shading, self.pale
        model.mode = self.mode if self.mode in model.modes else "segments"
        here, there = self.table[self.parts.of_point], model.table[parts.of_point]
        model.select(tuple(int(np.bincount(there[here == segment]).argmax()) for segment in self.selected))
        before = self.measures.hues[here]
        # segments of other levels get numbers that no segment of this level has
        model.measures.hues = kept_numbers(there, before, parts.keys + before.max() + parts.count)
        if model.edits.steps == self.edits.steps:
            model._before = self._before
        return model

    # The shown segments

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The colours that this result has."""
        scene, hierarchy = self.result.scene, self.result.hierarchy
        has = {
            "colours": scene.colors is not None,
            "confidence": hierarchy is not None and hierarchy.votes is not None,
            "initial": hierarchy is not None,
            "truth": scene.truth is not None and scene.truth.points is not None,
        }
        return tuple(mode for mode in get_args(Mode) if has.get(mode, True))

    def color_by(self, mode: Mode) -> None:
        """Colours the points in another way."""
        if mode not in self.modes:
            raise ValueError(f"colours: expected one of {', '.join(self.modes)}, got {mode}")
        self.mode = mode

    def key(self, segment: int) -> int:
        """The displayed id of a segment."""
        return int(self.measures.ids[segment])

    def segment_of_hue(self, hue: int) -> int | None:
        """The segment of a colour, which stays that of a thing when ids change; None: this level has no such one."""
        firsts = np.unique(self.table)
        found = firsts[self.measures.hues[firsts] == hue]
        return int(found[0]) if len(found) else None

    # Changes

    def select(self, segments: tuple[int, ...]) -> None:
        """Selects segments of the table; others fade. What was picked by clicks is dropped."""
        self.selected = tuple(dict.fromkeys(segments))
        if self._picked:
            self._edit(self.edits)

    def click(self, point: int, belongs: bool = True) -> None:
        """Selects the thing of all clicks so far: see :meth:`torchjoint.results.result.Result.pick`.

        A single click shows the segment of the table. The thing is no correction until :meth:`keep`, or until it is
        named, joined or split.

        Args:
            point: index of the point that was clicked.
            belongs: False: the thing ends before it.
        """
        self._pick((*self.clicks, Click(point, belongs)))

    def unclick(self) -> None:
        """Takes the last click back."""
        self._pick(self.clicks[:-1])

    def keep(self) -> None:
        """Makes the thing of the clicks a segment of its own, at every level."""
        if not self._picked:
            raise ValueError("one thing: expected clicks on a thing, got none")
        self._add()

    def set_granularity(self, granularity: float | None) -> None:
        """Shows another level; corrections stay."""
        self._edit(replace(self.edits, granularity=granularity))

    def join(self) -> None:
        """Joins the selected segments."""
        if len(self.selected) < 2:
            raise ValueError("join: select two or more segments, with shift or `Select several`")
        first, *others = self.selected
        self._add(*(Edit("join", (first, other)) for other in others))

    def split(self) -> None:
        """Splits the selected segment at the place that :func:`place_to_split` chooses, and selects both parts."""
        segment = self._the_selected("split")
        of_superpoint = self.table == segment
        self._add(Edit("split", place_to_split(self.table, segment, self.parts.sizes, self.result.hierarchy)))
        self.select(tuple(int(part) for part in np.unique(self.table[of_superpoint])))

    def name(self, name: str) -> None:
        """Names the selected segment; an empty name removes its name. Consecutive names are one change."""
        place = self._place_of(self._the_selected("name"), self.table)
        if len(name) > LONGEST:
            raise ValueError(f"name: expected at most {LONGEST} characters, got {len(name)}")
        step, steps = Edit("name", (place,), name, self.edits.granularity), self.edits.steps
        if self._before and steps and steps[-1] == replace(step, name=steps[-1].name):
            self._edit(replace(self.edits, steps=(*steps[:-1], step)))  # replaces the name while the user types
        else:
            self._add(step)

    def take_names(self, before: Model, has_grown: bool) -> None:
        """Gives each name of an earlier model to the segment of the same thing; without one, it waits in `waiting`.

        It is the segment of most of the thing's points, if most of its points are theirs, or if it has the thing's
        colour. If the cloud `has_grown`, it is the segment of the same colour.
        """
        here, now = before.table[before.parts.of_point], self.table[self.parts.of_point]
        old, hues, taken = before.measures.hues.tolist(), self.measures.hues, set[int]()
        named = [(name, old[one], np.flatnonzero(here == one)) for one, name in before.names.items()]
        for name, hue, points in (*sorted(named, key=lambda one: -len(one[2])), *before.waiting):
            shared = np.bincount(now[hues[now] == hue if has_grown else points], minlength=len(hues))
            found = int(shared.argmax())
            whole = min((now == found).sum(), shared.sum() if hues[found] == hue else len(now))
            if found in taken or 2 * shared[found] <= whole:
                self.waiting.append((name, hue if has_grown else -1, points))
                continue
            taken.add(found)
            if self.names.get(found) != name:
                self._add(Edit("name", (self._place_of(found, self.table),), name, self.edits.granularity))

    def undo(self) -> str:
        """Undoes the last change, or the last correction of edits.json; says which; "": there is nothing to undo."""
        if not self.edits.steps:
            return ""
        last, steps = self.edits.steps[-1], self._before.pop() if self._before else self.edits.steps[:-1]
        joined = [one for step in self.edits.steps[len(steps) :] if step.kind == "join" for one in step.superpoints]
        self._edit(replace(self.edits, steps=steps))
        self.select(tuple(self.table[joined].tolist()) or self.selected)
        return {"name": f"name {last.name!r}", "gather": "one thing"}.get(last.kind, last.kind)

    def take(self, edits: Edits) -> None:
        """Takes corrections that were saved together with those of others; each of them can be undone."""
        self._edit(edits)
        self._before = []

    def _the_selected(self, action: str) -> int:
        if len(self.selected) != 1:
            raise ValueError(f"{action}: expected one selected segment, got {len(self.selected)}")
        return self.selected[0]

    def _place_of(self, segment: int, table: Table) -> int:
        """The superpoint that stands for a segment of a table when it changes."""
        return self.parts.largest(np.flatnonzero(table == segment))

    def _pick(self, clicks: tuple[Click, ...]) -> None:
        if not clicks:
            self.select(())
            return
        superpoints = superpoints_of_clicks(self.parts, self.edits, clicks)
        self._edit(self.edits, (Edit("gather", tuple(superpoints.tolist())),))
        self.clicks, self.selected = clicks, (int(superpoints[0]),)

    def _add(self, *steps: Edit) -> None:
        before = self.edits.steps
        self._edit(replace(self.edits, steps=(*before, *self._picked, *steps)))
        self._before.append(before)

    def _edit(self, edits: Edits, picked: tuple[Edit, ...] = ()) -> None:
        before, shown = self.table, replace(edits, steps=edits.steps + picked)
        self.table, self.names = self.parts.table(shown), self.parts.names(shown)  # raise before anything changes
        self.edits, self._picked, self.clicks = edits, picked, ()
        ids = self.parts.ids(shown)
        if not (np.array_equal(before, self.table) and np.array_equal(ids, self.measures.ids)):
            places = [self._place_of(segment, before) for segment in self.selected]
            self.selected = tuple(dict.fromkeys(self.table[places].tolist()))
            self.measures.of_table(self.table, ids)

    # Words

    def find(self, query: torch.Tensor, k: int = 5) -> list[tuple[int, float]]:
        """The segments that are most similar to a vector, and the cosines, best first; none without embeddings.

        Raises:
            ValueError: the vector has another dimension than the embeddings, is zero or not finite.
        """
        if self.result.saved_embeddings is None:
            return []
        firsts, number = np.unique(self.table, return_inverse=True)
        vectors = self.result.saved_embeddings.of(torch.from_numpy(number[self.parts.of_point]))
        return [(int(firsts[segment]), cosine) for segment, cosine in vectors.find(query, k)]

    # Rows of the table

    def row(self, segment: int) -> Row:
        """The row of a segment in the table."""
        return self.measures.row(segment, self.names.get(segment, ""))

    def rows(self, search: str = "", order: str = "points", most: int = 1000) -> tuple[list[Row], int]:
        """Returns the first rows of the table that match the search, and the number of all that match.

        Args:
            search: part of a name, or an id; empty: all segments.
            order: points, id, name, size, frames or sure.
            most: largest number of rows.
        """
        return self.measures.rows(self.names, search, order, most)


def export_selected(model: Model, kind: str) -> tuple[str, bytes]:
    """Returns a file of the selected segments: its name and its content.

    * PLY: one cloud of the selected points in their own colours; its property `label` is the displayed id;
    * PNG: a ZIP file with a mask for each frame that sees a selected segment, 255 = selected;
    * COCO: COCO's JSON of the selected segments in all frames, with the displayed ids and the names.
    """
    if not model.selected:
        raise ValueError("export: select a segment first")
    called = {model.key(segment): model.names.get(segment, "") for segment in model.selected}
    name = "-".join(f"{key}-{name}" if name else str(key) for key, name in [*called.items()][:5])
    name = portable_name(name + (f"-and-{len(called) - 5}-more" if len(called) > 5 else ""))
    result = model.result
    # Of superpoints; -1: of others, and the last one of pixels without a superpoint.
    keys = np.append(np.where(np.isin(model.table, model.selected), model.measures.ids, -1), -1)
    labels = torch.from_numpy(keys[model.parts.of_point])
    if kind == "PLY":
        chosen, ids = result.scene.select_points(labels >= 0), labels[labels >= 0]
        return _written(f"{name}.ply", lambda file: write_cloud(file, chosen.points, chosen.colors, ids))
    if kind not in ("PNG", "COCO"):
        raise ValueError(f"export: expected PLY, PNG or COCO, got {kind!r}")
    images = LazySequence(len(result.images), lambda index: torch.from_numpy(keys[model.parts.image(index)]))
    if kind == "PNG":
        return f"{name}-masks.zip", _masks(images, result.names)
    picked = replace(result, points=labels, images=images, hierarchy=None, superpoint_images=(), segment_names=called)
    votes = result.hierarchy and result.hierarchy.votes
    vars(picked)["_confidence"] = votes and votes.confidence(torch.from_numpy(model.measures.ids))
    return _written(f"{name}.json", lambda file: export_coco(file, picked))


def _written(name: str, write: Callable[[Path], object]) -> tuple[str, bytes]:
    with TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return name, (Path(folder) / name).read_bytes()


def _masks(images: Sequence[Tensor], names: Sequence[str]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        for name, labels in zip(frame_files(names), images, strict=True):
            if bool((labels >= 0).any()):
                mask = io.BytesIO()
                Image.fromarray(((labels >= 0) * 255).numpy().astype(np.uint8)).save(mask, "png")
                file.writestr(f"{name}.png", mask.getvalue())
    if not file.namelist():
        raise ValueError("export: expected a selected segment that a frame sees, got none")
    return stream.getvalue()
