"""What the viewer shows, without a browser: a level, corrections, what is selected, and the colours that follow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch

from torchjoint.results.confidence import confidence
from torchjoint.results.edits import Edit, Edits, Table
from torchjoint.results.label_colors import label_colors
from torchjoint.results.oriented_box import oriented_box
from torchjoint.results.overlays import borders
from torchjoint.results.parts import Parts
from torchjoint.results.result import Result
from torchjoint.runtime.threads import parallel_map

Bytes = npt.NDArray[np.uint8]
Mode = Literal["segments", "colours", "confidence", "initial", "truth"]
#: What is not selected keeps this share of its colour; the rest is the light grey of the background.
FADED, PALE = 0.15, 235.0


@dataclass(frozen=True)
class Row:
    """One segment in the table."""

    key: int  #: see :class:`~torchjoint.results.parts.Parts`
    name: str
    points: int
    size: tuple[float, float, float]  #: metres, of its upright box
    frames: int | None  #: that see it; None until all frames were read


class Model:
    """The state of the viewer; every change keeps the steps before it, for :meth:`undo`.

    Args:
        result: as on disk, without corrections.
        edits: corrections to start with.
        up: [3] upward direction, unit length.
    """

    def __init__(self, result: Result, edits: Edits, up: npt.NDArray[np.float64]) -> None:
        self.parts, self.up = Parts(result), up
        self.result = result
        self.edits = edits
        self.selected: tuple[int, ...] = ()  # first pieces of segments
        self.mode: Mode = "segments"
        self._table = self.parts.table(edits)
        self._frames: list[tuple[Table, Table]] | None = None  # per frame: pieces, and the pixels of each
        self._rows: dict[int, Row] = {}

    def of_result(self, result: Result, edits: Edits | None = None) -> Model:
        """The same view of another result of the scene: what was selected still is, as far as it is the same.

        Args:
            result: the other result.
            edits: its corrections; default: those of this one, if the pieces are the same.
        """
        parts = Parts(result)
        if edits is None:
            same = np.array_equal(parts.of_point, self.parts.of_point)
            edits = self.edits if same else replace(self.edits, num_pieces=parts.count, steps=())
        model = Model(result, edits, self.up)
        model.mode = self.mode if self.mode in model.modes else "segments"
        here, there = self._table[self.parts.of_point], model.table[parts.of_point]
        same_place = [int(np.bincount(there[here == segment]).argmax()) for segment in self.selected]
        model.select(tuple(same_place))
        return model

    # What is shown

    @property
    def table(self) -> Table:
        """[P] the segment of each piece: the number of its first piece."""
        return self._table

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The colours that this result has."""
        scene, hierarchy = self.result.scene, self.result.hierarchy
        has = {
            "colours": scene.colors is not None,
            "confidence": hierarchy is not None,
            "initial": hierarchy is not None,
        }
        has["truth"] = scene.truth is not None and scene.truth.points is not None
        modes: tuple[Mode, ...] = ("segments", "colours", "confidence", "initial", "truth")
        return tuple(mode for mode in modes if has.get(mode, True))

    def key(self, segment: int) -> int:
        """The id that is shown for a segment."""
        return int(self.parts.keys[segment])

    def segment_of_key(self, key: int) -> int | None:
        """The segment with an id that is shown; None if there is none at this level."""
        firsts = np.unique(self._table)
        found = firsts[self.parts.keys[firsts] == key]
        return int(found[0]) if len(found) else None

    def names(self) -> dict[int, str]:
        """Names by segment."""
        return self.edits.names(self._table)

    # Changes

    def select(self, segments: tuple[int, ...]) -> None:
        """Selects segments of the table; others fade."""
        self.selected = tuple(dict.fromkeys(segments))

    def set_granularity(self, granularity: float | None) -> None:
        """Shows another level; corrections stay."""
        self._edit(replace(self.edits, granularity=granularity))

    def join(self) -> None:
        """Joins the selected segments.

        Raises:
            ValueError: fewer than two are selected.
        """
        if len(self.selected) < 2:
            raise ValueError("join: select two segments or more, with shift")
        first, *others = self.selected
        self._add(*(Edit("join", (first, other)) for other in others))

    def split(self) -> None:
        """Splits the selected segment at its last merge.

        Raises:
            ValueError: none or several are selected, or it cannot be split.
        """
        self._add(Edit("split", (self._the_selected("split"),)))

    def name(self, name: str) -> None:
        """Names the selected segment; an empty name takes its name away.

        Raises:
            ValueError: none or several are selected.
        """
        self._add(Edit("name", (self._the_selected("name"),), name))

    def undo(self) -> bool:
        """Takes the last correction back; returns False if there is none."""
        if not self.edits.steps:
            return False
        self._edit(replace(self.edits, steps=self.edits.steps[:-1]))
        return True

    def _the_selected(self, action: str) -> int:
        if len(self.selected) != 1:
            raise ValueError(f"{action}: select one segment, got {len(self.selected)}")
        return self.selected[0]

    def _add(self, *steps: Edit) -> None:
        self._edit(replace(self.edits, steps=(*self.edits.steps, *steps)))

    def _edit(self, edits: Edits) -> None:
        before = self._table
        self._table = self.parts.table(edits)  # raises before anything changes
        self.edits = edits
        if not np.array_equal(before, self._table):
            self.selected = tuple(dict.fromkeys(int(self._table[segment]) for segment in self.selected))
            self._rows.clear()

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
        """[N, 3] RGB of each point; what is not selected is faded."""
        scene = self.result.scene
        if self.mode == "colours" and scene.colors is not None:
            colors = scene.colors.numpy() * 255.0
        elif self.mode == "truth" and scene.truth is not None and scene.truth.points is not None:
            colors = label_colors(scene.truth.points).numpy() * 255.0
        else:
            colors = self.piece_colors()[self.parts.of_point]
        if self.selected:
            lit = np.isin(self._table, self.selected)[self.parts.of_point]
            colors = np.where(lit[:, None], colors, FADED * colors + (1 - FADED) * PALE)
        return colors.round().astype(np.uint8)

    def painted(self, index: int, opacity: float) -> Bytes:
        """[H, W, 3] a frame with its labels over it; if segments are selected, with these alone, and outlined."""
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
        if hierarchy is None:
            raise ValueError("confidence: the result has no hierarchy")
        from matplotlib import colormaps

        granularity = 0.5 if self.edits.granularity is None else self.edits.granularity
        sure = confidence(hierarchy, hierarchy.height_of(granularity))
        return torch.from_numpy(colormaps["viridis"](sure.numpy())[:, :3])

    # Measures

    def read_frames(self) -> None:
        """Counts the pixels of each piece in all frames; until then no frame sees anything."""

        def count(index: int) -> tuple[Table, Table]:
            pieces, pixels = np.unique(self.parts.image(index), return_counts=True)
            return pieces[pieces >= 0], pixels[pieces >= 0]

        self._frames = parallel_map(count, range(len(self.result.images)))
        self._rows.clear()

    def frames_of(self, segment: int) -> list[tuple[int, int]]:
        """(frame, pixels) of the frames that see a segment, most pixels first."""
        found = []
        for index, (pieces, pixels) in enumerate(self._frames or []):
            of_segment = int(pixels[self._table[pieces] == segment].sum())
            if of_segment:
                found.append((index, of_segment))
        return sorted(found, key=lambda one: (-one[1], one[0]))

    def row(self, segment: int) -> Row:
        """What the table says of a segment."""
        if segment not in self._rows:
            points = self._points[self._table[self.parts.of_point] == segment]
            size = oriented_box(points, self.up).size
            self._rows[segment] = Row(
                self.key(segment),
                self.names().get(segment, ""),
                len(points),
                (float(size[0]), float(size[1]), float(size[2])),
                None if self._frames is None else len(self.frames_of(segment)),
            )
        return replace(self._rows[segment], name=self.names().get(segment, ""))

    def rows(self, search: str = "", order: str = "points", most: int = 100) -> tuple[list[Row], int]:
        """Rows of the table: the first of those that fit, and how many fit.

        Args:
            search: part of a name, or an id; empty: all segments.
            order: points, id, name, size or frames.
            most: largest number of rows.
        """
        firsts, counts = np.unique(self._table[self.parts.of_point], return_counts=True)
        names = self.names()
        found = [
            (int(first), int(count))
            for first, count in zip(firsts, counts, strict=True)
            if not search or search.lower() in names.get(int(first), "").lower() or search == str(self.key(int(first)))
        ]
        if order in ("size", "frames"):
            rows = [self.row(first) for first, _ in found]
            rows.sort(key=lambda row: (-((row.frames or 0) if order == "frames" else np.prod(row.size)), row.key))
            return rows[:most], len(rows)
        sort = {
            "id": lambda one: (0, self.key(one[0])),
            "name": lambda one: (names.get(one[0], "\uffff").lower(), self.key(one[0])),
        }.get(order, lambda one: (-one[1], self.key(one[0])))
        found.sort(key=sort)
        return [self.row(first) for first, _ in found[:most]], len(found)

    @cached_property
    def _points(self) -> npt.NDArray[np.float64]:
        return self.result.scene.points.double().numpy()
