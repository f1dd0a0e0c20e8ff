"""A JSON file for each image, as in SA-1B, the data set of Segment Anything."""

from __future__ import annotations

import json
from pathlib import Path

from torchjoint.results.exports.masks import masks_of
from torchjoint.results.result import Result
from torchjoint.runtime.files import frame_files
from torchjoint.runtime.threads import on_cpu, parallel_map


@on_cpu()
def export_sam(folder: Path, result: Result) -> None:
    """Writes NAME.json for each image; an annotation's `id` is the label, the same in all images and in the cloud.

    An annotation has mask, box and area. It has no `predicted_iou`, `stability_score` and `point_coords`, because the
    method computes none.

    Raises:
        ModuleNotFoundError: pycocotools is not installed.
        ValueError: the result has no images.
    """
    if not len(result.images):
        raise ValueError("--format sam: expected a result with images, got none")

    files = frame_files(result.names)

    def write(index: int) -> None:
        name, (height, width) = files[index], result.images[index].shape
        image = {"image_id": index, "width": width, "height": height, "file_name": f"{name}.jpg"}
        annotations = [
            {
                "id": mask.segment,
                "segmentation": mask.encoded,
                "bbox": mask.box,
                "area": mask.area,
                "crop_box": [0, 0, width, height],
            }
            for mask in masks_of(result.images[index])
        ]
        text = json.dumps({"image": image, "annotations": annotations})
        (folder / f"{name}.json").write_text(text, encoding="utf-8")

    folder.mkdir()
    parallel_map(write, range(len(result.images)))
