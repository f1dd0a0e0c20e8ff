"""The segments of a result as objects: their boxes, sizes and places."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.ndimage import find_objects
from torch import Tensor

from torchjoint.ops import nearest_neighbors
from torchjoint.ops.internal import gap_components
from torchjoint.results.upright import Array, up_direction
from torchjoint.runtime.archives import read_archive
from torchjoint.runtime.files import no_link, write_text
from torchjoint.runtime.foreign_files import damage_is, read_json
from torchjoint.runtime.outputs import lock
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Scene, Segmentation

#: Neighbours are of one part up to so many times their median distance, or such a share of the median distance to the
#: middle, as rows of a scan are; smaller parts than this share of the largest one are left out of a box. The mean
#: |log| of sides / true sides falls from .66 to .23 on a real shelf, from .85 to .39 in a tote, from .14 to .11 in a
#: street, and is the same in 10 other scenes; boxes of true points keep .97 of their most shortened side.
NEIGHBORS, GAP, SPREAD, SHARE = 16, 8.0, 0.3, 0.1
#: Parts are found among at most so many points, and if any is left out, the box is that of the others among them.
#: They are not searched, which takes longer than all else, where the middle .9 of the points along each axis are nearly
#: as wide as all of them.
MOST, COMPACT = 10_000, 1.2


class OrientedBox(NamedTuple):
    """A box; its first two axes are level, and the third points up."""

    center: Array  #: [3] metres
    size: Array  #: [3] metres, along the three axes; of the two level sides, the longer one comes first
    axes: Array  #: [3, 3], one axis per row, unit length, right-handed


def oriented_box(points: Array, up: Array) -> OrientedBox:
    """Computes the box with the smallest base around points; its height is their extent along `up`.

    Small parts that are far from the rest are left out: a few points that fly at edges of depth made real boxes five
    times too long. Quantiles would cut thin parts, such as legs of a chair.

    Args:
        points: [N, 3] metres, N >= 1.
        up: [3] unit length.

    Example:
        >>> points = np.array([[0.0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0, 0, 3]])
        >>> box = oriented_box(points, np.array([0.0, 0.0, 1.0]))
        >>> box.center.tolist(), box.size.tolist()
        ([1.0, 0.5, 1.5], [2.0, 1.0, 3.0])
    """
    import cv2

    level, points = level_axes(up), _without_flying(points)
    origin = points.mean(0)
    corners = cv2.boxPoints(cv2.minAreaRect(((points - origin) @ level.T).astype(np.float32))).astype(np.float64)
    side = max(corners[1:3] - corners[:2], key=np.linalg.norm)
    length = float(np.linalg.norm(side))
    first = (side / length) @ level if length > 1e-9 else level[0]
    if first[np.argmax(np.abs(first))] < 0:  # the largest component shall be positive
        first = -first
    axes = np.stack([first, np.cross(up, first), up])
    along = (points - origin) @ axes.T
    low, high = along.min(0), along.max(0)
    return OrientedBox(origin + (low + high) / 2 @ axes, high - low, axes)


def _without_flying(points: Array) -> Array:
    inner = np.ptp(np.quantile(points, [0.05, 0.95], axis=0), axis=0)
    if (np.ptp(points, axis=0) <= COMPACT * inner).all():
        return points
    some = points[:: -(-len(points) // MOST)]
    place = torch.from_numpy(some - np.median(some, 0)).float()
    neighbors, distances = nearest_neighbors(place, NEIGHBORS)
    reach = max(GAP * float(distances.median().nan_to_num()), SPREAD * float(place.norm(dim=1).median()))
    parts = gap_components(place, torch.full((len(place),), reach).double(), neighbors, torch.ones(len(place)).bool())
    kept = (parts.bincount() >= SHARE * parts.bincount().max())[parts].numpy()
    return points if kept.all() else some[kept]


def level_axes(up: Array) -> Array:
    """Two unit vectors [2, 3] that are perpendicular to `up` and to each other."""
    across = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = across - up * (across @ up)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)])


FILE = "segments.json"


@dataclass(frozen=True)
class SegmentView:
    """A frame that sees a segment.

    Attributes:
        frame: index of the frame.
        name: of the frame.
        pixels: number of pixels of the segment.
        box: x, y, width and height around them, pixels.
    """

    frame: int
    name: str
    pixels: int
    box: tuple[int, int, int, int]


@dataclass(frozen=True)
class SegmentRecord:
    """One segment of the cloud.

    Attributes:
        id: its label.
        points: number of its points.
        center: [3] mean of its points, metres, world frame.
        box: the upright box around its points.
        color: [3] mean RGB in [0, 1] of its points; None if the cloud has no colours.
        confidence: the probability that it is an object; None if unknown: :attr:`torchjoint.Segmentation.confidence`.
        views: the frames that see it, in the order of the frames.
        name: given by hand, or by masks; "": none.
    """

    id: int
    points: int
    center: tuple[float, ...]
    box: OrientedBox
    color: tuple[float, ...] | None
    confidence: float | None
    views: tuple[SegmentView, ...]
    name: str = ""

    def to_dict(self) -> dict[str, Any]:
        """The record as written to segments.json: rounded to a hundredth of a millimetre, if in metres."""
        return {
            "id": self.id,
            "points": self.points,
            "center": _rounded(self.center, 5),
            "box": {
                "center": _rounded(self.box.center, 5),
                "size": _rounded(self.box.size, 5),
                "axes": [_rounded(axis, 6) for axis in self.box.axes],
            },
            "color": None if self.color is None else _rounded(self.color, 4),
            "confidence": None if self.confidence is None else round(self.confidence, 4),
            "frames": [{"name": view.name, "pixels": view.pixels, "box": list(view.box)} for view in self.views],
        }


def segment_records(scene: Scene, result: Segmentation) -> list[SegmentRecord]:
    """Describes each segment of the cloud.

    Args:
        scene: the cloud; its upward direction is that of the boxes.
        result: its labels, and those of the images.

    Returns:
        a record for each id 0 ... num_point_segments - 1, in this order.
    """
    vertical = up_direction(scene).numpy()
    views, confidence = _views(result), result.confidence
    points, colors = scene.points.double().numpy(), None if scene.colors is None else scene.colors.double().numpy()
    return [
        SegmentRecord(
            number,
            len(part),
            tuple(points[part].mean(0).tolist()),
            oriented_box(points[part], vertical),
            None if colors is None else tuple(colors[part].mean(0).tolist()),
            None if confidence is None else float(confidence[number]),
            tuple(views[number]),
        )
        for number, part in enumerate(members(result))
        if len(part)
    ]


def members(result: Segmentation) -> list[npt.NDArray[np.int64]]:
    """The points of each segment 0 ... num_point_segments - 1, ascending. All at once: a search for each takes long."""
    labels = result.points.numpy()
    counts = np.bincount(labels[labels >= 0], minlength=result.num_point_segments)
    return np.split(np.argsort(labels, kind="stable")[(labels < 0).sum() :], np.cumsum(counts)[:-1])


def write_segments(folder: Path, scene: Scene, result: Segmentation, names: Mapping[int, str]) -> None:
    """Writes segments.json: the upward direction, and a line for each segment of the cloud, with its name."""
    found = [{"id": one.id, "name": names.get(one.id)} | one.to_dict() for one in segment_records(scene, result)]
    _write(folder, {"units": "those of the cloud", "up": _rounded(up_direction(scene).tolist(), 6)}, found)


def add_to_segments(folder: Path, values: dict[str, Any], **columns: Mapping[int, Any]) -> None:
    """Writes into segments.json more values, and such of each segment, by its id; a segment without one has null."""
    with lock(folder / f".{FILE}.lock", f"{folder / FILE}: another program is writing it; save again"):
        head, _ = read_segments(folder)
        segments = [one | {name: of.get(one["id"]) for name, of in columns.items()} for one in head.pop("segments")]
        _write(folder, head | values, segments)


def read_segments(folder: Path) -> tuple[dict[str, Any], Tensor]:
    """The content of segments.json, and the labels that it describes, as :func:`stored_labels`."""
    file, labels = folder / FILE, stored_labels(folder)
    if file.is_symlink():
        raise ValueError(f"{file}: expected a file, got a link")
    with damage_is(f"{file}: not the segments of a result"):
        content: dict[str, Any] = read_json(file, "a result")
        got = [(one["id"], one["points"]) for one in content["segments"]]
        ids, points = labels[labels >= 0].unique(return_counts=True)
        if got != list(zip(ids.tolist(), points.tolist(), strict=True)):
            raise ValueError(f"expected the {len(ids)} segments of points.npz, got {len(got)}, or others")
    return content, labels


def stored_labels(folder: Path) -> Tensor:
    """The segment of each point of a result's folder, [N] int64, without corrections. Raises as `read_archive`."""
    return torch.from_numpy(read_archive(folder / "points.npz", ("labels",)).get("labels", np.empty(0))).long()


def _write(folder: Path, head: Mapping[str, Any], segments: Sequence[Mapping[str, Any]]) -> None:
    lines = ",\n".join(map(json.dumps, segments))
    write_text(no_link(folder / FILE), f'{json.dumps(head)[:-1]}, "segments": [\n{lines}\n]}}\n')


def image_views(labels: Tensor, num_segments: int) -> list[tuple[int, int, tuple[int, int, int, int]]]:
    """The segments in a label image [H, W] with ids below `num_segments`: (id, number of pixels, box x y w h)."""
    shown = torch.where(labels < num_segments, labels, -1).to(torch.int32).numpy() + 1
    counts = np.bincount(shown.ravel(), minlength=num_segments + 1)
    found = [(i, *place) for i, place in enumerate(find_objects(shown)) if place is not None]
    return [(i, int(counts[i + 1]), (x.start, y.start, x.stop - x.start, y.stop - y.start)) for i, y, x in found]


def _views(result: Segmentation) -> list[list[SegmentView]]:
    count = result.num_point_segments
    names = [name or f"{index:06d}" for index, name in enumerate(result.names)]
    of_frames = parallel_map(lambda index: image_views(result.images[index], count), range(len(result.images)))
    views: list[list[SegmentView]] = [[] for _ in range(count)]
    for index, found in enumerate(of_frames):
        for number, pixels, box in found:
            views[number].append(SegmentView(index, names[index], pixels, box))
    return views


def _rounded(values: Sequence[float] | np.ndarray[Any, Any], digits: int) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]  # + 0.0: no -0.0
