"""Results in the formats of other tools (output after step 8): one module for each format.

A format is a function ``export(path, result)``, which writes a file if `SUFFIXES` has its name, and otherwise a folder.
"""

from collections.abc import Callable
from pathlib import Path

from torchjoint.results.exports import boxes, clouds, masks
from torchjoint.results.result import Result

#: The export function of a format, and the suffix of its file; "": it writes a folder.
_EXPORTS: dict[str, tuple[Callable[[Path, Result], None], str]] = {
    "coco": (masks.export_coco, ".json"),
    "sam": (masks.export_sam, ""),
    "ply": (clouds.export_ply, ""),
    "las": (clouds.export_las, ".las"),
    "npz": (clouds.export_npz, ".npz"),
    "csv": (boxes.export_csv, ".csv"),
    "geojson": (boxes.export_geojson, ".geojson"),
    "scannet": (masks.export_scannet, ""),
    "masks": (masks.export_masks, ".npz"),
    "openmask3d": (masks.export_openmask3d, ""),
    "openpcdet": (boxes.export_openpcdet, ".txt"),
    "labelcloud": (boxes.export_labelcloud, ".json"),
    "segmentsai": (boxes.export_point_labels, ".json"),
    "segmentsai-cuboids": (boxes.export_cuboids, ".json"),
    "cvat": (boxes.export_cvat, ".json"),
}
#: The export functions, by name of the format.
FORMATS = {name: export for name, (export, _) in _EXPORTS.items()}
#: Suffix of the file of a format; formats that are not listed write a folder.
SUFFIXES = {name: suffix for name, (_, suffix) in _EXPORTS.items() if suffix}
