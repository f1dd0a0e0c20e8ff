"""Boxes of the segments, for tables, programs of annotation and networks: see :mod:`torchjoint.results.boxes`.

Labels of points for such a program are here, too; :mod:`torchjoint.results.shared_edits` reads them.
"""

import json
import math
import warnings
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import numpy as np
import numpy.typing as npt

from torchjoint.results import boxes
from torchjoint.results.objects import level_axes, members, segment_records
from torchjoint.results.result import Result
from torchjoint.results.upright import Array, up_direction
from torchjoint.runtime.files import write_text
from torchjoint.runtime.foreign_files import csv_text
from torchjoint.runtime.threads import on_cpu

#: The columns of the table of segments; lengths in metres, places in the coordinates of the cloud.
COLUMNS = ("id", "name", "points", "x", "y", "z", "size_x", "size_y", "size_z", "confidence", "bottom", "top", "area")

#: A footprint is the convex hull, which has sharp corners, of fewer points, and where the outline has more than this
#: share of its area.
FEW, CONVEX = 300, 0.9
#: A footprint is drawn in cells of so many mean distances of the points, which leaves few holes; holes of up to
#: so many cells are closed, and corners moved by at most one cell.
CELL, CLOSED = 2.0, 5
#: Largest number of cells along a side of a footprint.
MOST_CELLS = 2000


@on_cpu()
def export_csv(path: Path, result: Result) -> None:
    """Writes a line for each segment: COLUMNS.

    x, y, z (in a survey east, north, height) is the middle of its upright box in the axes of the cloud, size its sides;
    bottom and top are the heights of its box along up, which need not be z; area is that of its
    footprint, the outline seen from above.
    """
    rows = (["" if value is None else value for value in row] for row, _ in _rows(result))
    write_text(path, csv_text([COLUMNS, *rows]))


@on_cpu()
def export_geojson(path: Path, result: Result, epsg: int | None = None) -> None:
    """Writes the footprint of each segment, the outline of its points seen along z, with the values of COLUMNS.

    Outlines are simple: no two edges meet but in the corner of neighbours. `area` is seen along up, of exact corners.

    Args:
        path: of the file; QGIS, GDAL and GeoPandas read it.
        result: with places in metres, or in the unit of the survey.
        epsg: EPSG code of the cloud's coordinate system, named as GeoJSON of 2008 did; None: the file names none, which
            a warning tells.
    """
    up = float(up_direction(result.scene)[2])
    if up < boxes.LEVEL:
        told = f"footprints are seen along z, `area` along up, which is {math.degrees(math.acos(up)):.0f} degrees away"
        warnings.warn(f"{told} from it", stacklevel=3)
    if epsg is None:
        told = "no EPSG code of the cloud is known: programs will take the metres for degrees; set it there"
        warnings.warn(f"{path.name}: {told}", stacklevel=3)
    features = []
    for row, points in _rows(result):
        digits = 7 if np.abs(points[:, :2]).max() <= 360 else 3  # a survey's coordinates may be degrees
        corners = [np.round(ring, digits) for ring in _footprint(points[:, :2])]
        rings = [[place for place, _ in groupby([*ring.tolist(), ring[0].tolist()])] for ring in corners]  # once each
        if not any(map(_area, corners)):
            shape = {"type": "Point", "coordinates": rings[0][0]}
        elif len(rings) == 1:
            shape = {"type": "Polygon", "coordinates": rings}
        else:
            shape = {"type": "MultiPolygon", "coordinates": [[ring] for ring in rings]}
        properties = dict(zip(COLUMNS, row, strict=True))
        features.append({"type": "Feature", "id": row[0], "properties": properties, "geometry": shape})
    system = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{epsg}"}}
    collection = {"type": "FeatureCollection", **({} if epsg is None else {"crs": system}), "features": features}
    write_text(path, json.dumps(collection, ensure_ascii=False))


def _rows(result: Result) -> Iterator[tuple[tuple[int | str | float | None, ...], Array]]:
    """The values of COLUMNS of each segment, and its points."""
    of_all = members(result)
    for one in segment_records(result.scene, result):
        points, axes = result.scene.points[of_all[one.id]].double().numpy(), one.box.axes
        middle, half = float(one.box.center @ axes[2]), float(one.box.size[2]) / 2
        area = sum(map(_area, _footprint(points @ level_axes(axes[2]).T)))  # as GeoJSON's
        lengths = (*one.box.center, *one.box.size, middle - half, middle + half, area)
        *sizes, bottom, top, area = [round(float(value), 4) for value in lengths]
        sure = None if one.confidence is None else round(one.confidence, 4)
        yield (one.id, result.segment_names.get(one.id, ""), one.points, *sizes, sure, bottom, top, area), points


def _footprint(places: Array) -> list[Array]:
    """The outlines of places [N, 2], counter-clockwise: the corners [K, 2] of each part, without holes.

    Of few places, of a thin line of them, and where it is nearly the same, it is the convex hull.
    """
    import cv2

    # float32 has too few digits for coordinates of surveys
    hull = places[cv2.convexHull((places - places.mean(0)).astype(np.float32), returnPoints=False)[:, 0]]
    low, length = places.min(0), float(np.ptp(places, axis=0).max())
    cell = max(CELL * math.sqrt(_area(hull) / len(places)), length / MOST_CELLS)
    if len(places) < FEW or _area(hull) <= (CLOSED - 1) * cell * length:
        return [hull]
    column, row = ((places - low) / cell + CLOSED + 0.5).astype(int).T
    covered = np.zeros((row.max() + CLOSED + 1, column.max() + CLOSED + 1), np.uint8)
    covered[row, column] = 1
    round_hole = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (CLOSED, CLOSED))
    covered = cv2.morphologyEx(covered, cv2.MORPH_CLOSE, round_hole)
    times = np.full(1, 2)
    while (times > 1).any():  # an outline passes twice where parts touch or are one cell wide: they are made wider
        found, _ = cv2.findContours(covered, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cells, times = np.unique(np.concatenate(found)[:, 0], axis=0, return_counts=True)
        thin = np.zeros_like(covered)
        thin[*cells[times > 1].T[::-1]] = 1
        covered = np.maximum(covered, cv2.dilate(thin, np.ones((3, 3), np.uint8)))
    for far in (1, 0.5, 0):  # corners that are moved as far may let edges meet
        corners = [cv2.approxPolyDP(ring, far, closed=True)[::-1, 0].astype(int) for ring in found]
        corners = [ring for ring in corners if _area(ring) > 0]
        if not _meet(corners):
            break
    rings = [low + cell * (ring - CLOSED) for ring in corners]
    return rings if 0 < sum(map(_area, rings)) < CONVEX * _area(hull) else [hull]


def _meet(rings: list[npt.NDArray[np.int64]]) -> bool:
    """Whether edges of rings [K, 2] meet that have no corner in common."""
    edges = np.concatenate([np.zeros((0, 2, 2), int), *(np.stack([ring, np.roll(ring, -1, 0)], 1) for ring in rings)])
    for one in edges:
        others = edges[(edges.min(1) <= one.max(0)).all(1) & (edges.max(1) >= one.min(0)).all(1)]
        others = others[(others[:, :, None] != one).any(3).all((1, 2))]
        if ((_sides(one[None], others) <= 0) & (_sides(others, one[None]) <= 0)).any():
            return True
    return False


def _sides(edges: npt.NDArray[np.int64], others: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """[E] 1: both ends of the other edge [E, 2, 2] are on one side of an edge; -1: on both; 0: one is on its line."""
    along, to = edges[:, 1:] - edges[:, :1], others - edges[:, :1]
    return np.sign(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]).prod(1)


def _area(ring: Array) -> float:
    """The area inside corners [K, 2], by the shoelace formula."""
    x, y = (ring - ring[0]).T
    return abs(float(x @ np.roll(y, 1) - y @ np.roll(x, 1))) / 2


@on_cpu()
def export_openpcdet(path: Path, result: Result) -> None:
    """Writes a label file of OpenPCDet's custom data sets: a line ``x y z dx dy dz heading name`` for each segment."""
    write_text(path, boxes.openpcdet_lines(boxes.boxes_of(result).values()))


@on_cpu()
def export_labelcloud(path: Path, result: Result) -> None:
    """Writes the boxes as labelCloud reads them (format centroid_abs); its cloud is ``points.ply`` of the result."""
    write_text(path, json.dumps(boxes.labelcloud_record(boxes.boxes_of(result).values()), indent=1))


def export_labelcloud_classes(path: Path, result: Result) -> None:
    """Writes the ``_classes.json`` that labelCloud looks for beside its labels: the names, and the format."""
    write_text(path, json.dumps(boxes.labelcloud_classes(result.segment_names.values()), indent=1))


@on_cpu()
def export_cuboids(path: Path, result: Result) -> None:
    """Writes the boxes as a label of cuboids of Segments.ai; its cloud is ``points.ply`` of the result."""
    write_text(path, json.dumps(boxes.segmentsai_label(boxes.boxes_of(result)), indent=1))


@on_cpu()
def export_cvat(path: Path, result: Result) -> None:
    """Writes the boxes as CVAT reads them (format Datumaro 3D); its cloud is ``points.ply`` of the result, as .pcd."""
    write_text(path, json.dumps(boxes.datumaro_record(boxes.boxes_of(result).values())))


@on_cpu()
def export_point_labels(path: Path, result: Result) -> None:
    """Writes a label of segmentation of Segments.ai; its cloud is ``points.ply`` of the result, in the same order."""
    found = [segment for segment in result.points.unique().tolist() if segment >= 0]
    label = {
        "format_version": "0.1",
        "annotations": [boxes.segmentsai_object(one, result.segment_names.get(one, "")) for one in found],
        "point_annotations": (result.points + 1).clamp(min=0).tolist(),
    }
    write_text(path, json.dumps(label))
