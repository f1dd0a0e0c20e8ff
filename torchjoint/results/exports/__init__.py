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

#: The export function of a format, and the suffix of its file; "": it writes a folder.
_EXPORTS: dict[str, tuple[Callable[[Path, Result], None], str]] = {
    "coco": (export_coco, ".json"),
    "sam": (export_sam, ""),
    "ply": (export_ply, ""),
    "las": (export_las, ".las"),
    "npz": (export_npz, ".npz"),
    "csv": (export_csv, ".csv"),
    "geojson": (export_geojson, ".geojson"),
    "scannet": (export_scannet, ""),
    "masks": (export_masks, ".npz"),
    "openmask3d": (export_openmask3d, ""),
    "openpcdet": (export_openpcdet, ".txt"),
    "labelcloud": (export_labelcloud, ".json"),
    "segmentsai": (export_point_labels, ".json"),
    "segmentsai-cuboids": (export_cuboids, ".json"),
    "cvat": (export_cvat, ".json"),
}
#: The export functions, by name of the format.
FORMATS = {name: export for name, (export, _) in _EXPORTS.items()}
#: Suffix of the file of a format; formats that are not listed write a folder.
SUFFIXES = {name: suffix for name, (_, suffix) in _EXPORTS.items() if suffix}
