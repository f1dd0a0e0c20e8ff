"""Boxes around things, as programs for 3D annotation and networks for 3D detection take and give them.

Their boxes turn about z alone, which must point up: they are those of a turned cloud if up in the scene is far from z.
"""

import math
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from torchjoint.results.objects import level_axes, members, oriented_box
from torchjoint.results.result import Result
from torchjoint.results.upright import Array, up_direction
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import read_json, read_text
from torchjoint.runtime.messages import printable
from torchjoint.scene import Scene

#: The name of a thing without a name.
UNNAMED = "thing"
#: Metres: a point so near to a side is inside. Files hold millimetres.
TOLERANCE = 1e-3
#: A segment of fewer points has no box: of so few points nobody draws one, and OpenPCDet leaves such boxes out.
FEWEST = 5
#: Metres: the least side of a box, for networks learn logarithms of sides.
THINNEST = 0.01
#: Up in a scene is near z if its z, of unit length, is at least this: 10 degrees.
LEVEL = math.cos(math.radians(10))


class Box(NamedTuple):
    """A box that stands upright."""

    name: str  #: "": not known
    center: tuple[float, ...]  #: x, y, z, metres
    size: tuple[float, ...]  #: metres, along its own x, y and z
    yaw: float  #: radians, from the world's x to its own x, counterclockwise as seen from above

    def holds(self, points: Array) -> npt.NDArray[np.bool_]:
        """Which of points [N, 3] are inside."""
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        x, y, z = (points - self.center).T
        own = np.stack([cosine * x + sine * y, cosine * y - sine * x, z], 1)
        return (np.abs(own) <= np.array(self.size) / 2 + TOLERANCE).all(1)


def has_level_axes(scene: Scene) -> bool:
    """Whether up in a scene is within 10 degrees of z."""
    return float(up_direction(scene)[2]) >= LEVEL


def upright_points(scene: Scene) -> Array:
    """The points [N, 3] of a scene, metres; turned so that z is up, if up is more than 10 degrees from it."""
    up, points = up_direction(scene).numpy(), scene.points.double().numpy()
    return points if up[2] >= LEVEL else points @ np.concatenate([level_axes(up), up[None]]).T


def boxes_of(result: Result) -> dict[int, Box]:
    """The upright box with the smallest base of each segment of FEWEST or more of the :func:`upright_points`, by id."""
    points, parts, boxes = upright_points(result.scene), members(result), {}
    if few := sum(0 < len(part) < FEWEST for part in parts):
        warnings.warn(f"segments of fewer than {FEWEST} points have no box: {few}", stacklevel=5)
    for segment in [number for number, part in enumerate(parts) if len(part) >= FEWEST]:
        found = oriented_box(points[parts[segment]], np.array([0.0, 0.0, 1.0]))
        yaw = math.atan2(found.axes[0, 1], found.axes[0, 0])
        numbers = np.array([*found.center, *found.size.clip(THINNEST), yaw]).round(6).tolist()  # as files have them
        name = result.segment_names.get(segment, UNNAMED)
        boxes[segment] = Box(name, tuple(numbers[:3]), tuple(numbers[3:6]), numbers[6])
    return boxes


def openpcdet_lines(boxes: Iterable[Box]) -> str:
    """The text of a label file of OpenPCDet's custom data sets: x y z dx dy dz heading name."""
    line = "{:.4f} " * 7 + "{}\n"
    return "".join(line.format(*box.center, *box.size, box.yaw, "_".join(box.name.split()) or UNNAMED) for box in boxes)


def labelcloud_record(boxes: Iterable[Box]) -> dict[str, Any]:
    """The record of labelCloud's format centroid_abs: angles are degrees. The cloud is that with the file's name."""
    objects = [
        {
            "name": box.name,
            "centroid": _named("x y z", box.center),
            "dimensions": _named("length width height", box.size),
            "rotations": _named("x y z", (0.0, 0.0, round(math.degrees(box.yaw) % 360, 6))),
        }
        for box in boxes
    ]
    return {"objects": objects}


def labelcloud_classes(names: Iterable[str]) -> dict[str, Any]:
    """The record of labelCloud's _classes.json: without it, it takes angles for radians, and offers no names."""
    known = [UNNAMED, *sorted({*names} - {UNNAMED})]
    classes = [{"name": one, "id": at, "color": f"#{(at + 3) * 0x9E3779 % 2**24:06x}"} for at, one in enumerate(known)]
    return {"classes": classes, "default": 0, "type": "object_detection", "format": "centroid_abs"}


def segmentsai_label(boxes: Mapping[int, Box]) -> dict[str, Any]:
    """A label of cuboids as Segments.ai takes it (docs.segments.ai, label types), of the boxes by their segments."""
    annotations = [
        segmentsai_object(segment, box.name)
        | {"type": "cuboid", "position": _named("x y z", box.center), "dimensions": _named("x y z", box.size)}
        | {"yaw": box.yaw}
        for segment, box in boxes.items()
    ]
    return {"format_version": "0.2", "annotations": annotations}


def datumaro_record(boxes: Collection[Box]) -> dict[str, Any]:
    """The record of format Datumaro 3D, which CVAT reads and writes (docs.cvat.ai, formats): angles are radians.

    CVAT puts the boxes into the frame that `attr` names: the first one of a task, whatever its file.
    """
    names = sorted({box.name for box in boxes})
    cuboids = [
        {"id": number, "type": "cuboid_3d", "attributes": {"occluded": False}, "group": 0}
        | {"label_id": names.index(box.name), "position": [*box.center]}
        | {"rotation": [0.0, 0.0, box.yaw], "scale": [*box.size]}
        for number, box in enumerate(boxes)
    ]
    cloud = {"id": "points", "attr": {"frame": 0}, "point_cloud": {"path": "points.pcd"}, "annotations": cuboids}
    labels = [{"name": name, "parent": "", "attributes": []} for name in names]
    categories = {"label": {"labels": labels, "attributes": ["occluded"]}}
    return {"info": {}, "media_type": 6, "categories": categories, "items": [cloud]}  # 6: clouds


def segmentsai_object(segment: int, name: str) -> dict[str, Any]:
    """A segment as an object of Segments.ai. Its labels have numbers of categories only: an attribute has the name."""
    return {"id": segment + 1, "category_id": 1, "attributes": {"name": "" if name == UNNAMED else name}}


def read_boxes(file: Path) -> list[Box]:
    """Reads boxes: a .json of labelCloud (centroid_abs), Segments.ai or CVAT, or a .txt of OpenPCDet."""
    if file.suffix.lower() not in (".json", ".txt"):
        raise ValueError(f"{file}: expected boxes or labels, .json or .txt, or a .csv of `export`, for names alone")
    if file.suffix.lower() == ".txt":
        text = read_text(file, "boxes", bounds.JSON_BYTES, errors="replace")
        rows = [(number, line.split(maxsplit=7)) for number, line in enumerate(text.splitlines(), start=1)]
        return [_box(row[7:], row[:7], f"{file}, line {number}") for number, row in rows if row]
    record = read_json(file, "boxes")
    if isinstance(record, dict) and {"images", "categories"} <= record.keys():
        raise ValueError(f"{file}: expected boxes, got COCO's masks of images; they go into a new run: segment --masks")
    try:
        record = record.get("attributes", record)  # of a whole label of Segments.ai
        key = next((key for key in ("annotations", "items", "objects") if key in record), None)
        if key is None:
            raise ValueError(f"got {', '.join(record)}"[:99])
        objects = _cuboids(record) if key == "items" else record[key]
        if not isinstance(objects, list):
            raise TypeError(f"{key} is {type(objects).__name__}")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        expected = "expected boxes: `objects` of labelCloud, `annotations` of Segments.ai, or `items` of CVAT"
        told = error if type(error) is ValueError else repr(error)
        raise ValueError(f"{file}: {expected} (or names, in a .csv): {told}") from error
    return [_of_record(one, key, f"{file}, object {number}") for number, one in enumerate(objects)]


def _cuboids(record: Any) -> list[Any]:
    """The cuboids of one cloud in Datumaro's record, each with the name of its label."""
    names = dict(enumerate(label["name"] for label in record["categories"]["label"]["labels"]))
    clouds = [item["annotations"] for item in record["items"] if item["annotations"]]
    if len(clouds) > 1:
        raise ValueError(f"got boxes of {len(clouds)} clouds, expected those of one")
    return [one | {"name": names.get(one["label_id"])} for cloud in clouds for one in cloud]


def _of_datumaro(record: Any) -> tuple[Any, list[Any], list[float]]:
    *tilts, yaw = [float(turn) for turn in record["rotation"]]
    return record["name"], [*record["position"], *record["scale"], yaw], [math.sin(turn / 2) for turn in tilts]


def _of_labelcloud(record: Any) -> tuple[Any, list[Any], list[float]]:
    center = [record["centroid"][name] for name in "xyz"]
    size = [record["dimensions"][name] for name in ("length", "width", "height")]
    turns = [math.radians(float(record["rotations"][name])) for name in "xyz"]
    if -math.radians(math.pi) <= turns[2] < 0:  # labelCloud's degrees are 0 to 360
        raise ValueError("angles of centroid_rel, which are radians; save it as centroid_abs")
    return record["name"], [*center, *size, turns[2]], [math.sin(turn / 2) for turn in turns[:2]]


def _of_segmentsai(record: Any) -> tuple[Any, list[Any], list[float]]:
    numbers = [record[key][axis] for key in ("position", "dimensions") for axis in "xyz"]
    turn, name = record.get("rotation") or {}, (record.get("attributes") or {}).get("name")
    name = "" if name is None else name or UNNAMED
    return name, [*numbers, record["yaw"]], [float(turn.get(axis, 0)) for axis in ("qx", "qy")]


#: How a box is read from an object: its name, seven numbers, and sines of the half angles by which it is tilted.
_READERS = {
    "objects": (_of_labelcloud, "name, centroid (x, y, z), dimensions (length, width, height), rotations (x, y, z)"),
    "annotations": (_of_segmentsai, "a cuboid with position (x, y, z), dimensions (x, y, z), yaw"),
    "items": (_of_datumaro, "a cuboid_3d with position (x, y, z), rotation (x, y, z), scale (x, y, z)"),
}


def _of_record(record: Any, key: str, where: str) -> Box:
    read, expected = _READERS[key]
    try:
        name, numbers, tilt = read(record)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise ValueError(f"{where}: expected {expected}; {error!r}") from error
    if not all(abs(one) <= 1e-3 for one in tilt):
        raise ValueError(f"{where}: expected a box that turns about z alone, got sines of half angles {tilt}")
    return _box([name], numbers, where)


def _box(name: Sequence[Any], numbers: Sequence[Any], where: str) -> Box:
    try:
        values = [float(value) for value in numbers]
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{where}: expected seven numbers, got {list(numbers)!s:.80}") from error
    if len(values) != 7 or len(name) != 1 or not isinstance(name[0], str) or printable(name[0]) != name[0]:
        raise ValueError(f"{where}: expected x y z dx dy dz heading name, got {[*numbers, *name]!s:.120}")
    if not all(map(math.isfinite, values)) or min(values[3:6]) < 0:
        raise ValueError(f"{where}: expected finite numbers and sizes of at least 0, got {values}")
    return Box(name[0].strip(), tuple(values[:3]), tuple(values[3:6]), values[6])


def _named(names: str, values: Sequence[float]) -> dict[str, float]:
    return dict(zip(names.split(), values, strict=True))
