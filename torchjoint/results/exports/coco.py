"""COCO's JSON of instances: the masks of all images, without classes; points and images have the same ids."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from torchjoint.results.exports.masks import masks_of
from torchjoint.results.result import Result
from torchjoint.runtime.files import frame_files, write_text
from torchjoint.runtime.threads import on_cpu, parallel_map


@on_cpu()
def export_coco(path: Path, result: Result) -> None:
    """Writes one JSON file; an annotation's `segment_id` is the label, the same in all images and in the cloud.

    `in_cloud` is False for a segment of an image that has no points. All annotations have category 1, "object". `score`
    is the confidence in the segment, where the result has one; `segment_name` is the name that it got by hand.

    Raises:
        ModuleNotFoundError: pycocotools is not installed.
        ValueError: the result has no images.
    """
    if not len(result.images):
        raise ValueError("--format coco: expected a result with images, got none")
    count, files, names = result.num_point_segments, frame_files(result.names), result.segment_names
    scores = [] if result.confidence is None else result.confidence.tolist()
    of_images = parallel_map(lambda index: list(masks_of(result.images[index])), range(len(result.images)))
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for index, masks in enumerate(of_images):
        height, width = result.images[index].shape
        images.append({"id": index + 1, "file_name": f"{files[index]}.jpg", "width": width, "height": height})
        for mask in masks:
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": index + 1,
                    "category_id": 1,
                    "segmentation": mask.encoded,
                    "area": mask.area,
                    "bbox": mask.box,
                    "iscrowd": 0,
                    "segment_id": mask.segment,
                    **({"segment_name": names[mask.segment]} if names.get(mask.segment) else {}),
                    "in_cloud": mask.segment < count,
                    **({"score": round(scores[mask.segment], 4)} if mask.segment < len(scores) else {}),
                }
            )
    record = {
        "info": {"description": "torchjoint: one segment_id is one object, in every image"},
        "licenses": [],
        "images": images,
        "annotations": annotations,
        "categories": [{"id": 1, "name": "object", "supercategory": "object"}],
    }
    write_text(path, json.dumps(record))
