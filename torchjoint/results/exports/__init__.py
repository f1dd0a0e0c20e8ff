"""Results in the formats of other tools (output after step 8): one module for each format.

A format is a function ``export(path, result)``, which writes a file if `SUFFIXES` has its name, and otherwise a folder.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from torchjoint.results.exports.boxes import (
    export_csv,
    export_cuboids,
    export_cvat,
    export_geojson,
    export_labelcloud,
    export_openpcdet,
    export_point_labels,
)
from torchjoint.results.exports.clouds import export_las, export_npz, export_ply
from torchjoint.results.exports.masks import export_coco, export_masks, export_openmask3d, export_sam, export_scannet
from torchjoint.results.result import Result

#: The export functions, by name of the format.
FORMATS: dict[str, Callable[[Path, Result], None]] = {
    "coco": export_coco,
    "sam": export_sam,
    "ply": export_ply,
    "las": export_las,
    "npz": export_npz,
    "csv": export_csv,
    "geojson": export_geojson,
    "scannet": export_scannet,
    "masks": export_masks,
    "openmask3d": export_openmask3d,
    "openpcdet": export_openpcdet,
    "labelcloud": export_labelcloud,
    "segmentsai": export_point_labels,
    "segmentsai-cuboids": export_cuboids,
    "cvat": export_cvat,
}
#: Suffix of the file of a format; formats that are not listed write a folder.
SUFFIXES = {
    "coco": ".json",
    "las": ".las",
    "npz": ".npz",
    "csv": ".csv",
    "geojson": ".geojson",
    "masks": ".npz",
    "openpcdet": ".txt",
    "labelcloud": ".json",
    "segmentsai": ".json",
    "segmentsai-cuboids": ".json",
    "cvat": ".json",
}
