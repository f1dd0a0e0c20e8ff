"""Boxes of the segments, for tables, programs of annotation and networks: see :mod:`torchjoint.results.boxes`.

Labels of points for such a program are here, too; :mod:`torchjoint.results.shared_edits` reads them.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from torchjoint.results.boxes import (
    Box,
    boxes_of,
    datumaro_record,
    labelcloud_record,
    openpcdet_lines,
    segmentsai_label,
    segmentsai_object,
)
from torchjoint.results.objects import segment_records
from torchjoint.results.result import Result
from torchjoint.results.upright import up_direction
from torchjoint.runtime.files import write_text
from torchjoint.runtime.foreign_files import csv_text
from torchjoint.runtime.threads import on_cpu

#: The scene's upward direction may differ from z by this angle, degrees.
LEVEL = 10.0


#: The columns of the table of segments; lengths in metres, places in the coordinates of the cloud.
COLUMNS = ("id", "name", "points", "x", "y", "z", "size_x", "size_y", "size_z", "confidence")


@on_cpu()
def export_csv(path: Path, result: Result) -> None:
    """Writes a line for each segment: COLUMNS; x, y, z is the middle of its upright box, size its sides."""
    rows = (["" if value is None else value for value in row] for row in _rows(result))
    write_text(path, csv_text([COLUMNS, *rows]))


@on_cpu()
def export_geojson(path: Path, result: Result, epsg: int | None = None) -> None:
    """Writes the footprint of each segment, the convex hull of its points seen along z, with the values of COLUMNS.

    Args:
        path: of the file; QGIS, GDAL and GeoPandas read it.
        result: with places in metres, or in the unit of the survey.
        epsg: EPSG code of the cloud's coordinate system, named as GeoJSON of 2008 did; None: the file names none, which
            a warning tells.
    """
    import cv2

    _tell_leaning(result, "footprints are seen")
    if epsg is None:
        told = "no coordinate system of the cloud is known: programs will take the metres for degrees; set it there"
        warnings.warn(f"{path.name}: {told}", stacklevel=3)
    features = []
    for row in _rows(result):
        places = result.scene.points[result.points == row[0], :2].double().numpy()
        origin = places.mean(0)  # float32 has too few digits for coordinates of surveys
        corners = cv2.convexHull((places - origin).astype(np.float32))[:, 0].astype(float) + origin
        digits = 7 if np.abs(corners).max() <= 360 else 3  # a survey's coordinates may be degrees
        ring = [[round(value, digits) for value in corner] for corner in (*corners.tolist(), corners[0].tolist())]
        shape = (
            {"type": "Polygon", "coordinates": [ring]} if len(ring) > 3 else {"type": "Point", "coordinates": ring[0]}
        )
        properties = dict(zip(COLUMNS, row, strict=True))
        features.append({"type": "Feature", "id": row[0], "properties": properties, "geometry": shape})
    system = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{epsg}"}}
    collection = {"type": "FeatureCollection", **({} if epsg is None else {"crs": system}), "features": features}
    write_text(path, json.dumps(collection, ensure_ascii=False))


def _rows(result: Result) -> Iterator[tuple[int | str | float | None, ...]]:
    """The values of COLUMNS of each segment."""
    for one in segment_records(result.scene, result):
        lengths = [round(float(value), 4) for value in (*one.box.center, *one.box.size)]
        sure = None if one.confidence is None else round(one.confidence, 4)
        yield one.id, result.segment_names.get(one.id, ""), one.points, *lengths, sure


@on_cpu()
def export_openpcdet(path: Path, result: Result) -> None:
    """Writes a label file of OpenPCDet's custom data sets: a line ``x y z dx dy dz heading name`` for each segment."""
    write_text(path, openpcdet_lines(_upright_boxes(result).values()))


@on_cpu()
def export_labelcloud(path: Path, result: Result, cloud: Path | None = None) -> None:
    """Writes the boxes as labelCloud reads them (format centroid_abs); its cloud is ``points.ply`` of the result.

    `cloud` is where labelCloud finds it; default: beside `path`, with the same name.
    """
    record = labelcloud_record(_upright_boxes(result).values(), path.with_suffix(".ply") if cloud is None else cloud)
    write_text(path, json.dumps(record, indent=1, ensure_ascii=False))


@on_cpu()
def export_cuboids(path: Path, result: Result) -> None:
    """Writes the boxes as a label of cuboids of Segments.ai; its cloud is ``points.ply`` of the result."""
    write_text(path, json.dumps(segmentsai_label(_upright_boxes(result)), indent=1, ensure_ascii=False))


@on_cpu()
def export_cvat(path: Path, result: Result) -> None:
    """Writes the boxes as CVAT reads them (format Datumaro 3D); its cloud is ``points.ply`` of the result, as .pcd."""
    write_text(path, json.dumps(datumaro_record(_upright_boxes(result).values()), ensure_ascii=False))


@on_cpu()
def export_point_labels(path: Path, result: Result) -> None:
    """Writes a label of segmentation of Segments.ai; its cloud is ``points.ply`` of the result, in the same order."""
    found = [segment for segment in result.points.unique().tolist() if segment >= 0]
    label = {
        "format_version": "0.1",
        "annotations": [segmentsai_object(one, result.segment_names.get(one, "")) for one in found],
        "point_annotations": (result.points + 1).clamp(min=0).tolist(),
    }
    write_text(path, json.dumps(label, ensure_ascii=False))


def _upright_boxes(result: Result) -> dict[int, Box]:
    """The boxes of the segments; a warning tells if they lean."""
    _tell_leaning(result, "boxes stand")
    return boxes_of(result)


def _tell_leaning(result: Result, what: str) -> None:
    up = float(up_direction(result.scene)[2])
    angle = math.degrees(math.acos(max(-1.0, min(1.0, up))))
    if angle > LEVEL:
        told = f"up in this scene is {angle:.0f} degrees away from it; turn the cloud first"
        warnings.warn(f"{what} along z, but {told}", stacklevel=5)
