"""Exports of a result's masks: PNG, SAM, COCO, OpenMask3D, ScanNet."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.results.boxes import UNNAMED
from torchjoint.results.objects import image_views
from torchjoint.results.result import Result
from torchjoint.runtime.archives import write_archive
from torchjoint.runtime.files import file_name, frame_files, write_text
from torchjoint.runtime.messages import needed_for
from torchjoint.runtime.threads import on_cpu, parallel_map


class Mask(NamedTuple):
    """The pixels of one segment in one image."""

    segment: int  #: its id
    box: list[int]  #: x, y, width, height
    area: int  #: pixels
    encoded: dict[str, Any]  #: {"size": [H, W], "counts": text}

    def record(self, number: int) -> dict[str, Any]:
        """An annotation of this number, as COCO and SAM have it."""
        return {"id": number, "segmentation": self.encoded, "bbox": self.box, "area": self.area}


def masks_of(labels: Tensor) -> Iterator[Mask]:
    """The masks of all segments of a label image [H, W], ascending by id; pixels without a label are in none."""
    with needed_for("the format coco or sam", "pycocotools", "torchjoint[export]"):
        from pycocotools import mask as coder
    ids, place = labels.unique(return_inverse=True)  # small numbers: ids may be large
    for index, area, box in image_views(place, len(ids)):
        if int(ids[index]) >= 0:
            encoded = coder.encode(np.asfortranarray((place == index).numpy(), dtype=np.uint8))
            counts = encoded["counts"].decode("ascii")
            yield Mask(int(ids[index]), list(box), area, {"size": list(labels.shape), "counts": counts})


@on_cpu()
def export_sam(folder: Path, result: Result) -> None:
    """Writes NAME.json for each image; an annotation's `id` is the label, the same in all images and in the cloud.

    An annotation has mask, box and area. It has no `predicted_iou`, `stability_score` and `point_coords`, because the
    method computes none.
    """
    if not len(result.images):
        raise ValueError("--format sam: expected a result with images, got none")

    files = frame_files(result.names)

    def write(index: int) -> None:
        name, (height, width) = files[index], result.images[index].shape
        image = {"image_id": index, "width": width, "height": height, "file_name": f"{name}.jpg"}
        crop = {"crop_box": [0, 0, width, height]}
        annotations = [mask.record(mask.segment) | crop for mask in masks_of(result.images[index])]
        write_text(folder / f"{name}.json", json.dumps({"image": image, "annotations": annotations}))

    folder.mkdir()
    parallel_map(write, range(len(result.images)))


@on_cpu()
def export_coco(path: Path, result: Result) -> None:
    """Writes one JSON file; an annotation's `segment_id` is the label, the same in all images and in the cloud.

    `in_cloud` is False for a segment of an image that has no points. The category is the name of the segment, else
    "thing". `score` is the confidence in the segment, where the result has one.
    """
    if not len(result.images):
        raise ValueError("--format coco: expected a result with images, got none")
    count, files, names = result.num_point_segments, frame_files(result.names), result.segment_names
    scores = [] if result.confidence is None else result.confidence.tolist()
    of_images = parallel_map(lambda index: list(masks_of(result.images[index])), range(len(result.images)))
    used = {names.get(mask.segment) or UNNAMED for masks in of_images for mask in masks}
    categories = sorted(used, key=lambda name: (name != UNNAMED, name))
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for index, masks in enumerate(of_images):
        height, width = result.images[index].shape
        images.append({"id": index + 1, "file_name": f"{files[index]}.jpg", "width": width, "height": height})
        for mask in masks:
            values = {
                "image_id": index + 1,
                "category_id": 1 + categories.index(names.get(mask.segment) or UNNAMED),
                "iscrowd": 0,
                "segment_id": mask.segment,
                **({"segment_name": names[mask.segment]} if names.get(mask.segment) else {}),
                "in_cloud": mask.segment < count,
                **({"score": round(scores[mask.segment], 4)} if mask.segment < len(scores) else {}),
            }
            annotations.append(mask.record(len(annotations) + 1) | values)
    named = [{"id": number, "name": name, "supercategory": UNNAMED} for number, name in enumerate(categories, 1)]
    record = {
        "info": {"description": "torchjoint: one segment_id is one object, in every image"},
        "licenses": [],
        "images": images,
        "annotations": annotations,
        "categories": named,
    }
    write_text(path, json.dumps(record))


#: The class of all instances.
LABEL = 1


@on_cpu()
def export_scannet(folder: Path, result: Result) -> None:
    """Writes SCENE.txt, and a mask of the cloud for each segment in predicted_masks/.

    SCENE is the scene's name. A line of SCENE.txt is ``predicted_masks/SCENE_000.txt 1 score``; the score is the
    confidence in the segment, or 1 where the result has none.
    """
    name = scene_name(result)
    (folder / "predicted_masks").mkdir(parents=True)
    lines = []
    scores = _scores(result).tolist()
    for segment in _segments(result).tolist():
        file = f"predicted_masks/{name}_{segment:03d}.txt"
        digits = (result.points == segment).numpy().astype(np.uint8) + ord("0")
        (folder / file).write_bytes(np.stack([digits, np.full_like(digits, ord("\n"))], 1).tobytes())
        lines.append(f"{file} {LABEL} {scores[segment]:.4f}\n")
    (folder / f"{name}.txt").write_text("".join(lines), encoding="utf-8")


@on_cpu()
def export_masks(path: Path, result: Result) -> None:
    """Writes an archive with the arrays pred_masks [N, S] bool, pred_score [S] and pred_classes [S]."""
    segments = _segments(result)
    arrays = {"pred_masks": (result.points[:, None] == segments).numpy()}
    arrays |= {"pred_score": _scores(result)[segments].numpy(), "pred_classes": np.full(len(segments), LABEL, np.int32)}
    write_archive(path, arrays)


def scene_name(result: Result) -> str:
    """The scene's name as a word, for names of files."""
    return file_name("_".join(result.scene.name.split()) or "scene")


def _segments(result: Result) -> Tensor:
    """The ids [S] that have points, ascending: after corrections, some may have none."""
    return result.points[result.points >= 0].unique()


def _scores(result: Result) -> Tensor:
    return torch.ones(result.num_point_segments).double() if result.confidence is None else result.confidence


@on_cpu()
def export_openmask3d(folder: Path, result: Result) -> None:
    """Writes SCENE_masks.pt, a tensor [N, S] bool, and SCENE_openmask3d_features.npy, [S, D] float32.

    OpenMask3D itself saves its masks as a NumPy array, which ``torch.load`` of today refuses; its programs take both.
    The vectors are of unit length; as there, a segment that no frame sees has zeros.
    """
    if result.embeddings is None:
        raise ValueError("--format openmask3d: expected saved embeddings, got none; result.embed(...).save(RESULT)")
    folder.mkdir(parents=True)
    name = scene_name(result)
    segments = _segments(result)
    with (folder / f"{name}_masks.pt").open("wb") as stream:  # torch does not say that a disk is full
        torch.save(result.points[:, None] == segments, stream)
    np.save(folder / f"{name}_openmask3d_features.npy", result.embeddings.vectors[segments].numpy())
