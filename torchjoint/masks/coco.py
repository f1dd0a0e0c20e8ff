"""Masks from annotations and results in COCO's format."""

import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PureWindowsPath
from typing import Any

import torch

from torchjoint.masks.segmentation import check_declared, merged, pixels_in_box
from torchjoint.runtime.foreign_files import damage_is, dict_of, no_twice, read_json
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.masks import Masks


@on_cpu()
def from_coco(
    annotations: Sequence[Mapping[str, Any]], size: tuple[int, int], categories: Mapping[int, str] | None = None
) -> Masks:
    """Masks of the annotations, or of the results, of one image.

    Args:
        annotations: a dict for each mask: ``segmentation`` (polygons, or run lengths, compressed or not), and an
            optional ``score`` in [0, 1]. If all have an ``id``, the masks have it, too. Groups of things
            (``iscrowd: 1``) and empty lists of polygons are left out, with a warning; indices in messages do not count
            them.
        size: (H, W) of the image.
        categories: names of ``category_id``; then the masks have names.

    Raises:
        ValueError, TypeError: naming the annotation and its entry, what was expected and what came.

    >>> from_coco([{"segmentation": [[1, 0, 3, 0, 3, 2, 1, 2]]}], (2, 4))
    Masks(1 masks, 2 x 4 pixels, 50% covered)
    """
    annotations = _with_pixels(annotations, "annotations")
    scores = torch.tensor([_score(one, f"annotations[{i}]") for i, one in enumerate(annotations)], dtype=torch.float32)
    check_declared((annotation["segmentation"] for annotation in annotations), size, "annotations")
    masks = (pixels_in_box(one, size, f"annotations[{index}]'s segmentation") for index, one in enumerate(annotations))
    found = merged(masks, len(annotations), size, scores, "annotations")
    ids = [one["id"] for one in annotations if isinstance(one.get("id"), int)]
    if len(ids) < sum(one.get("id") is not None for one in annotations):
        warnings.warn("annotations: ids that are no integers are not kept: masks.json has positions", stacklevel=3)
    names = [str(categories.get(one.get("category_id", -1), "")) for one in annotations] if categories else []
    return replace(found, ids=tuple(ids) if len(ids) == len(found) else (), names=tuple(names))


def _with_pixels(annotations: Sequence[Mapping[str, Any]], name: str) -> list[Mapping[str, Any]]:
    """The annotations of single things that have a mask.

    CVAT says iscrowd of each mask of its brush, and alone writes attributes; the segmentation of its rectangles is [].
    """
    records = [one if isinstance(one, Mapping) else {} for one in annotations]
    groups = [one.get("iscrowd") == 1 and "attributes" not in one for one in records]
    bare = [isinstance(one.get("segmentation"), list) and not one["segmentation"] for one in records]
    for left, what in ((groups, "masks are groups of things (iscrowd: 1)"), (bare, "annotations have no polygon")):
        if any(left):
            warnings.warn(f"{name}: {sum(left)} of {len(left)} {what}; they are left out", stacklevel=3)
    return [one for one, *left in zip(annotations, groups, bare, strict=True) if not any(left)]


def _score(annotation: Mapping[str, Any], name: str) -> float:
    if not isinstance(annotation, Mapping) or "segmentation" not in annotation:
        raise ValueError(f"{name}: expected a dict with segmentation, got {str(annotation)[:60]}")
    score = annotation.get("score", 1.0)
    if isinstance(score, bool) or not isinstance(score, (int, float)):
        raise TypeError(f"{name}'s score: expected a number, got {score!r}")
    return float(min(score, 2))  # a huge integer has no float; 2 is refused, too


def _tell_other_sizes(annotations: Sequence[Mapping[str, Any]], images: Sequence[Mapping[str, Any]], name: str) -> None:
    """Warns if polygons seem to be of images of other sizes, or to have exchanged axes."""
    with suppress(ArithmeticError, LookupError, TypeError, ValueError):  # damage, of which reading tells; run lengths
        sizes = {image["id"]: (image["width"], image["height"]) for image in images}
        polygons = [(corners, sizes[one["image_id"]]) for one in annotations for corners in one["segmentation"]]
        reach = [max(max(xy[::2]) / width, max(xy[1::2]) / height) for xy, (width, height) in polygons]
        beyond = sum(share > 1.02 for share in reach)
        if len(reach) >= 5 and beyond > 0.1 * len(reach):
            told = f"{beyond} of {len(reach)} polygons reach beyond their images: of other sizes, or y before x?"
            warnings.warn(f"{name}: {told}", stacklevel=4)
        elif len(reach) >= 5 and max(reach) <= (0.25 if len(reach) < 20 else 0.5):
            warnings.warn(f"{name}: all polygons lie in one corner of the images: of smaller ones?", stacklevel=4)


class CocoFile:
    """The masks of a COCO data set (`images` and `annotations`). A name is the stem of an image's file name."""

    def __init__(self, path: Path) -> None:
        self._path = path
        data = read_json(path, "a COCO data set")
        if not isinstance(data, dict) or not {"images", "annotations"} <= set(data):
            told = "a list of results is for tj.masks.from_coco, image by image"
            raise ValueError(f"{path}: expected a COCO data set with images and annotations; {told}")
        with damage_is(f"{path}: expected images with file_name and id, annotations with image_id"):
            self._images = {PureWindowsPath(image["file_name"]).stem: image for image in data["images"]}
            self._annotations = dict_of([(image["id"], []) for image in data["images"]], "image")
            annotations = _with_pixels(data["annotations"], str(path))
            for annotation in annotations:
                self._annotations[annotation["image_id"]].append(annotation)
            named = [(one["id"], str(one["name"])) for one in data.get("categories", []) if one.get("name") is not None]
            self._categories = dict_of(named, "category")
            unknown = {one["category_id"] for one in annotations if "category_id" in one} - set(self._categories)
        known = ((one["image_id"], one["id"]) for one in annotations if one.get("id") is not None)
        no_twice(known, f"{path}: annotation (image, id)")
        if len(self._images) < len(data["images"]):
            raise ValueError(f"{path}: expected images with different file names, got two of one name")
        if unknown and self._categories:
            told = f"{path}: no category has the id of some masks, which get no name"
            warnings.warn(f"{told}: {sorted(unknown, key=str)[:9]}", stacklevel=3)
        if bare := sum(not one for one in self._annotations.values()):
            warnings.warn(f"{path}: {bare} images have no mask: leave out those that nobody annotated", stacklevel=3)
        _tell_other_sizes(annotations, data["images"], str(path))

    @property
    def names(self) -> list[str]:
        """The stems of the file names, sorted."""
        return sorted(self._images)

    def read(self, name: str) -> Masks:
        """The masks of an image."""
        image = self._images[name]
        with damage_is(f"{self._path}, image {name!r}"):
            size = int(image["height"]), int(image["width"])
            return from_coco(self._annotations[image["id"]], size, self._categories)
