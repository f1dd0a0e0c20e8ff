"""The state of the viewer, independent of the browser: level, corrections, selection, and the resulting colours."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.results.edits import Edit, Edits, Table
from torchjoint.results.label_colors import label_colors
from torchjoint.results.overlays import borders
from torchjoint.results.parts import Parts
from torchjoint.results.result import Result
from torchjoint.results.shading import Shading
from torchjoint.results.splits import place_to_split
from torchjoint.viewer.measures import Measures, Row

Bytes = npt.NDArray[np.uint8]
Mode = Literal["segments", "colours", "confidence", "initial", "truth"]
#: Share of its own colour that an unselected segment keeps; the rest is the light grey of the background.
FADED, PALE = 0.15, 235.0
#: Most characters of a segment's name.
LONGEST = 200


class Model:
    """The state of the viewer; it keeps the corrections before each change, for :meth:`undo`.

    Args:
        result: the result as on disk, without corrections.
        edits: corrections to start with.
        up: [3] upward direction, unit length.

    Attributes:
        shading: of the points, once it is computed; without it colours are flat.
        clicks: (point, whether it belongs to it) of the thing that is being picked.
    """

    def __init__(self, result: Result, edits: Edits, up: npt.NDArray[np.float64]) -> None:
        self.parts, self.up = Parts(result), up
        self.result = result
        self.edits = edits
        self.selected: tuple[int, ...] = ()  # first pieces of segments
        self.mode: Mode = "segments"
        self.shading: Shading | None = None
        self._table, self._names = self.parts.table(edits), self.parts.names(edits)
        self.clicks: tuple[tuple[int, bool], ...] = ()
        self._picked: tuple[Edit, ...] = ()  # shown as if it were a correction
        self._before: list[tuple[Edit, ...]] = []  # the corrections before each change, for undo
        self._measures = Measures(self.parts, up)
        self._measures.of_table(self._table)

    def of_result(self, result: Result, edits: Edits | None = None) -> Model:
        """The same view of another result of the scene; the selection is kept as far as its segments are the same.

        Args:
            result: the other result.
            edits: its corrections; default: those of this one, if the pieces are the same.
        """
        parts = Parts(result)
        if edits is None:
            same = np.array_equal(parts.of_point, self.parts.of_point)
            edits = self.edits if same else replace(self.edits, num_pieces=parts.count, steps=())
        model = Model(result, edits, self.up)
        model.shading = self.shading
        model.mode = self.mode if self.mode in model.modes else "segments"
        here, there = self._table[self.parts.of_point], model.table[parts.of_point]
        same_place = [int(np.bincount(there[here == segment]).argmax()) for segment in self.selected]
        model.select(tuple(same_place))
        if model.edits.steps == self.edits.steps:
            model._before = self._before
        return model

    # The shown segments

    @property
    def table(self) -> Table:
        """[P] the segment of each piece; the number of a segment is that of its first piece."""
        return self._table

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The colours that this result has."""
        scene, hierarchy = self.result.scene, self.result.hierarchy
        has = {
            "colours": scene.colors is not None,
            "confidence": hierarchy is not None and hierarchy.votes is not None,
            "initial": hierarchy is not None,
        }
        has["truth"] = scene.truth is not None and scene.truth.points is not None
        modes: tuple[Mode, ...] = ("segments", "colours", "confidence", "initial", "truth")
        return tuple(mode for mode in modes if has.get(mode, True))

    def key(self, segment: int) -> int:
        """The displayed id of a segment."""
        return int(self.parts.keys[segment])

    def segment_of_key(self, key: int) -> int | None:
        """The segment with a displayed id; None if this level has no such segment."""
        firsts = np.unique(self._table)
        found = firsts[self.parts.keys[firsts] == key]
        return int(found[0]) if len(found) else None

    def names(self) -> dict[int, str]:
        """Names by segment."""
        return self._names

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

        Raises:
            ValueError: no click is on the thing, or two that disagree are in one piece.
        """
        self._show((*self.clicks, (point, belongs)))

    def unclick(self) -> None:
        """Takes the last click back."""
        self._show(self.clicks[:-1])

    def keep(self) -> None:
        """Makes the thing of the clicks a segment of its own, at every level.

        Raises:
            ValueError: there were no clicks.
        """
        if not self._picked:
            raise ValueError("one thing: expected clicks on a thing, got none")
        self._add()

    def _show(self, clicks: tuple[tuple[int, bool], ...]) -> None:
        if not clicks:
            self.select(())
            return
        if len(clicks) == 1 and clicks[0][1]:
            table = self.parts.table(self.edits)
            pieces = np.flatnonzero(table == table[self.parts.of_point[clicks[0][0]]])
        else:
            on, off = (
                torch.tensor([p for p, belongs in clicks if belongs == wanted], dtype=torch.int64)
                for wanted in (True, False)
            )
            pieces = self._at_level.pick(on, negative=off).pieces.numpy()
        self._edit(self.edits, (Edit("gather", tuple(pieces.tolist())),))
        self.clicks, self.selected = clicks, (int(pieces[0]),)

    @property
    def _at_level(self) -> Result:
        """The result whose default level is the shown one."""
        hierarchy, level = self.result.hierarchy, self.edits.granularity
        if hierarchy is None or level is None:
            return self.result
        return replace(self.result, hierarchy=replace(hierarchy, default=hierarchy.height_of(level)))

    def set_granularity(self, granularity: float | None) -> None:
        """Shows another level; corrections stay."""
        self._edit(replace(self.edits, granularity=granularity))

    def join(self) -> None:
        """Joins the selected segments.

        Raises:
            ValueError: fewer than two are selected.
        """
        if len(self.selected) < 2:
            raise ValueError("join: select two or more segments with shift")
        first, *others = self.selected
        self._add(*(Edit("join", (first, other)) for other in others))

    def split(self) -> None:
        """Splits the selected segment at the place that :func:`place_to_split` chooses, and selects both parts.

        Raises:
            ValueError: not exactly one segment is selected, or it cannot be split.
        """
        segment = self._the_selected("split")
        sizes = np.bincount(self.parts.of_point, minlength=self.parts.count)
        of_piece = self._table == segment
        self._add(Edit("split", place_to_split(self._table, segment, sizes, self.result.hierarchy)))
        self.select(tuple(int(part) for part in np.unique(self._table[of_piece])))

    def name(self, name: str) -> None:
        """Names the selected segment; an empty name removes its name. Consecutive names are one change.

        Raises:
            ValueError: not exactly one segment is selected, or the name is longer than LONGEST.
        """
        segment = self._the_selected("name")
        if len(name) > LONGEST:
            raise ValueError(f"name: expected at most {LONGEST} characters, got {len(name)}")
        step, steps = Edit("name", (segment,), name, self.edits.granularity), self.edits.steps
        if self._before and steps and steps[-1] == replace(step, name=steps[-1].name):
            self._edit(replace(self.edits, steps=(*steps[:-1], step)))  # replaces the name while the user types
        else:
            self._add(step)

    def undo(self) -> bool:
        """Undoes the last change, or the last correction of edits.json; returns False if there is nothing to undo."""
        if not self.edits.steps:
            return False
        self._edit(replace(self.edits, steps=self._before.pop() if self._before else self.edits.steps[:-1]))
        return True

    def _the_selected(self, action: str) -> int:
        if len(self.selected) != 1:
            raise ValueError(f"{action}: expected one selected segment, got {len(self.selected)}")
        return self.selected[0]

    def _add(self, *steps: Edit) -> None:
        before = self.edits.steps
        self._edit(replace(self.edits, steps=(*before, *self._picked, *steps)))
        self._before.append(before)

    def _edit(self, edits: Edits, picked: tuple[Edit, ...] = ()) -> None:
        before, shown = self._table, replace(edits, steps=edits.steps + picked)
        self._table = self.parts.table(shown)  # raises before anything changes
        self.edits, self._names = edits, self.parts.names(shown)
        self._picked, self.clicks = picked, ()
        if not np.array_equal(before, self._table):
            self.selected = tuple(dict.fromkeys(int(self._table[segment]) for segment in self.selected))
            self._measures.of_table(self._table)

    # Words

    def find(self, query: torch.Tensor, k: int = 5) -> list[tuple[int, float]]:
        """The segments that are most similar to a vector, and the cosines, best first; none without embeddings.

        Raises:
            ValueError: the vector has another dimension than the embeddings, is zero or not finite.
        """
        if self.result.saved_embeddings is None:
            return []
        firsts, number = np.unique(self._table, return_inverse=True)
        vectors = self.result.saved_embeddings.of(torch.from_numpy(number[self.parts.of_point]))
        return [(int(firsts[segment]), cosine) for segment, cosine in vectors.find(query, k)]

    # Colours

    def piece_colors(self) -> npt.NDArray[np.float64]:
        """[P, 3] RGB in 0 to 255 of each piece, in a mode that colours pieces."""
        number = torch.arange(self.parts.count)
        if self.mode == "initial":
            colors = label_colors(number)
        elif self.mode == "confidence":
            colors = self._confidence_colors
        else:
            colors = label_colors(torch.from_numpy(self.parts.keys[self._table]))
        return np.asarray(colors.numpy() * 255, dtype=np.float64)

    def point_colors(self) -> Bytes:
        """[N, 3] RGB of each point, unselected points faded. All but the cloud's own colours are shaded."""
        scene, labels = self.result.scene, self._table[self.parts.of_point]
        if self.mode == "truth" and scene.truth is not None and scene.truth.points is not None:
            labels = scene.truth.points.numpy()
            colors = label_colors(scene.truth.points).numpy() * 255.0
        else:
            colors = self.piece_colors()[self.parts.of_point]
        if self.mode == "colours" and scene.colors is not None:
            colors = scene.colors.numpy() * 255.0
        elif self.shading is not None:
            colors = colors * self.shading.of(labels)[:, None]
        if self.selected:
            lit = np.isin(self._table, self.selected)[self.parts.of_point]
            colors = np.where(lit[:, None], colors, FADED * colors + (1 - FADED) * PALE)
        return colors.round().astype(np.uint8)

    def painted(self, index: int, opacity: float) -> Bytes:
        """[H, W, 3] a frame under its labels; if segments are selected, only under these, with their outlines."""
        image = self.result.scene.frames[index].image.permute(1, 2, 0).numpy() * 255.0
        pieces = self.parts.image(index)
        if self.mode == "truth":
            truth = self._truth_image(index)
            return self._blend(image, truth, label_colors(torch.from_numpy(truth)).numpy() * 255.0, truth >= 0, opacity)
        segments = np.where(pieces < 0, -1, self._table[pieces])
        shown = np.isin(segments, self.selected) if self.selected else pieces >= 0
        if self.mode == "colours" and not self.selected:
            return image.round().astype(np.uint8)
        outlined = segments if self.mode != "initial" else pieces
        if self.selected:
            outlined, image = np.where(shown, segments, -1), np.where(shown[..., None], image, 0.5 * image + 64)
        colors = self.piece_colors()[pieces]
        return self._blend(image, outlined, colors, shown, opacity if self.mode != "colours" else 0.0)

    def _blend(self, image: Any, labels: Table, colors: Any, shown: Any, opacity: float) -> Bytes:
        blended = np.where(shown[..., None], image + (colors - image) * opacity, image)
        border = borders(torch.from_numpy(labels)).numpy()
        return np.where(border[..., None], 255.0, blended).round().astype(np.uint8)

    def _truth_image(self, index: int) -> Table:
        truth = self.result.scene.truth
        if truth is None or not len(truth.images):
            return np.full(self.result.scene.frames[index].size, -1, dtype=np.int64)
        return truth.images[index].numpy()

    @property
    def _confidence_colors(self) -> torch.Tensor:
        hierarchy = self.result.hierarchy
        if hierarchy is None or hierarchy.votes is None:
            raise ValueError("confidence: expected a result with the votes of judges, got none")
        from matplotlib import colormaps

        sure = hierarchy.votes.confidence(torch.from_numpy(np.unique(self._table, return_inverse=True)[1])).of_piece
        return torch.from_numpy(colormaps["viridis"](sure.numpy())[:, :3])

    # Measures

    def read_frames(self) -> None:
        """Counts the pixels of each piece in all frames; before this call, no frame is listed."""
        self._measures.read_frames()

    def frames_of(self, segment: int) -> list[tuple[int, int]]:
        """(frame, pixels) of the frames that see a segment, most pixels first."""
        return self._measures.frames_of(segment)

    def row(self, segment: int) -> Row:
        """The row of a segment in the table."""
        return self._measures.row(segment, self.names().get(segment, ""))

    def rows(self, search: str = "", order: str = "points", most: int = 100) -> tuple[list[Row], int]:
        """Returns the first rows of the table that match the search, and the number of all that match.

        Args:
            search: part of a name, or an id; empty: all segments.
            order: points, id, name, size or frames.
            most: largest number of rows.
        """
        return self._measures.rows(self.names(), search, order, most)
