"""Boxes around things, as programs for 3D annotation and networks for 3D detection take and give them.

Their boxes turn about z alone, which must point up.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from torchjoint.results.oriented_box import oriented_box
from torchjoint.results.result import Result
from torchjoint.runtime.messages import printable

Array = npt.NDArray[np.float64]
#: The name of a thing without a name.
UNNAMED = "thing"
#: Metres: a point so near to a side is inside. Files hold millimetres.
TOLERANCE = 1e-3
_UP = np.array([0.0, 0.0, 1.0])


class Box(NamedTuple):
    """A box that stands upright."""

    name: str
    center: tuple[float, float, float]  #: metres
    size: tuple[float, float, float]  #: metres, along its own x, y and z
    yaw: float  #: radians, from the world's x to its own x, counterclockwise as seen from above

    def holds(self, points: Array) -> npt.NDArray[np.bool_]:
        """Which of points [N, 3] are inside."""
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        x, y, z = (points - self.center).T
        own = np.stack([cosine * x + sine * y, cosine * y - sine * x, z], 1)
        inside: npt.NDArray[np.bool_] = (np.abs(own) <= np.array(self.size) / 2 + TOLERANCE).all(1)
        return inside


def boxes_of(result: Result) -> dict[int, Box]:
    """The box with the smallest base around each segment that has points, by its id."""
    points, labels = result.scene.points.double().numpy(), result.points.numpy()
    boxes = {}
    for segment in np.unique(labels[labels >= 0]).tolist():
        found = oriented_box(points[labels == segment], _UP)
        yaw = math.atan2(found.axes[0, 1], found.axes[0, 0])
        name = result.segment_names.get(segment, UNNAMED)
        boxes[segment] = Box(name, _three(found.center.tolist()), _three(found.size.tolist()), yaw)
    return boxes


def openpcdet_lines(boxes: Iterable[Box]) -> str:
    """The text of a label file of OpenPCDet's custom data sets: x y z dx dy dz heading name."""
    rows = (f"{_numbers((*box.center, *box.size, box.yaw))} {'_'.join(box.name.split()) or UNNAMED}" for box in boxes)
    return "".join(f"{row}\n" for row in rows)


def labelcloud_record(boxes: Iterable[Box], file: Path) -> dict[str, Any]:
    """The record of labelCloud's format centroid_abs: angles are degrees."""

    def named(names: str, values: Sequence[float]) -> dict[str, float]:
        return {name: round(value, 6) for name, value in zip(names.split(), values, strict=True)}

    objects = [
        {
            "name": box.name,
            "centroid": named("x y z", box.center),
            "dimensions": named("length width height", box.size),
            "rotations": named("x y z", (0.0, 0.0, math.degrees(box.yaw) % 360)),
        }
        for box in boxes
    ]
    return {"folder": file.parent.name, "filename": file.name, "path": str(file), "objects": objects}


def read_boxes(file: Path) -> list[Box]:
    """Reads boxes of either format; a .json is labelCloud's centroid_abs, anything else has lines of OpenPCDet.

    Raises:
        OSError: the file cannot be read.
        ValueError: it has another content; the message names the file and the box.
    """
    text = file.read_text(encoding="utf-8", errors="replace")
    if file.suffix.lower() != ".json":
        rows = [(number, line.split(maxsplit=7)) for number, line in enumerate(text.splitlines(), start=1)]
        return [_box(row[7:], row[:7], f"{file}, line {number}") for number, row in rows if row]
    try:
        objects = json.loads(text)["objects"]
        if not isinstance(objects, list):
            raise TypeError(f"objects is {type(objects).__name__}")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"{file}: expected boxes of labelCloud, with a list `objects` ({error!r})") from error
    return [_of_labelcloud(one, f"{file}, object {number}") for number, one in enumerate(objects)]


def _of_labelcloud(record: Any, where: str) -> Box:
    try:
        center = [record["centroid"][name] for name in "xyz"]
        size = [record["dimensions"][name] for name in ("length", "width", "height")]
        turns = [float(record["rotations"][name]) for name in "xyz"]
        name = [record["name"]]
    except (KeyError, TypeError, ValueError) as error:
        expected = "expected name, centroid (x, y, z), dimensions (length, width, height), rotations (x, y, z)"
        raise ValueError(f"{where}: {expected}; {error!r}") from error
    if any(math.sin(math.radians(turn / 2)) > 1e-3 for turn in turns[:2]):
        raise ValueError(f"{where}: expected a box that turns about z alone, got rotations {turns}")
    return _box(name, [*center, *size, math.radians(turns[2])], where)


def _box(name: Sequence[Any], numbers: Sequence[Any], where: str) -> Box:
    try:
        values = [float(value) for value in numbers]
    except (TypeError, ValueError) as error:
        raise ValueError(f"{where}: expected seven numbers, got {list(numbers)}") from error
    if len(values) != 7 or len(name) != 1 or not isinstance(name[0], str):
        raise ValueError(f"{where}: expected x y z dx dy dz heading name, got {[*numbers, *name]}")
    if not all(map(math.isfinite, values)) or min(values[3:6]) < 0:
        raise ValueError(f"{where}: expected finite numbers and sizes of at least 0, got {values}")
    if printable(name[0]) != name[0]:
        raise ValueError(f"{where}: name: expected a text, got {name[0]!r}")
    return Box(name[0].strip(), _three(values[:3]), _three(values[3:6]), values[6])


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.4f}" for value in values)
