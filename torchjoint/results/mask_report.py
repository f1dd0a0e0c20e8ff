"""What became of the masks of a network: masks.json in a result (output after step 8)."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torchjoint.results.edits import LONGEST
from torchjoint.results.result import Result
from torchjoint.runtime.files import write_text
from torchjoint.runtime.foreign_files import damage_is, has_file, present, read_json
from torchjoint.runtime.groups import counted_pairs
from torchjoint.runtime.messages import printable
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Masks
from torchjoint.scene.segmentation import level_images

FILE = "masks.json"
#: A mask became a segment if their IoU in the frame is at least this.
FOUND = 0.5


class MaskMatches(NamedTuple):
    """What became of the masks of one frame."""

    masks: list[dict[str, Any]]  #: a record for each mask
    shown: Tensor  #: [S] pixels of each segment of the cloud
    masked: Tensor  #: [S] those of them that lie in a mask


def write_mask_report(folder: Path, names: Sequence[str], found: Sequence[MaskMatches | None]) -> None:
    """Writes masks.json, unless no frame has masks.

    `frames` has, for each mask of a frame, its id, name and score, its segment with their IoU in the frame, and its
    area in pixels. `segments` has, for each segment of the cloud that these frames show, the share of its pixels that
    lie in masks, the number of frames in which it is a mask (IoU >= 0.5), and the scores of these masks, added up for
    each name.

    Args:
        folder: the result.
        names: of the frames.
        found: :func:`compare_masks` of each frame, None without masks.
    """
    if not any(found):
        return
    frames: list[dict[str, Any]] = [
        {"name": name or f"{index:06d}", "masks": one.masks}
        for index, (name, one) in enumerate(zip(names, found, strict=True))
        if one is not None
    ]
    shown, masked = (sum(getattr(one, name) for one in found if one is not None) for name in ("shown", "masked"))
    good = [(index, mask) for index, frame in enumerate(frames) for mask in frame["masks"] if mask["iou"] >= FOUND]
    segments = []
    for segment in torch.nonzero(torch.as_tensor(shown)).flatten().tolist():
        votes: Counter[str] = Counter()
        for _, mask in (own := [one for one in good if one[1]["segment"] == segment]):
            votes[mask["name"]] += mask["score"]
        called = {name: round(vote, 4) for name, vote in votes.most_common() if name}
        share = round(int(masked[segment]) / int(shown[segment]), 4)
        segments.append({"id": segment, "masked": share, "frames": len({index for index, _ in own}), "names": called})
    lines = [",\n".join(json.dumps(record) for record in records) for records in (frames, segments)]
    write_text(folder / FILE, f'{{"frames": [\n{lines[0]}\n], "segments": [\n{lines[1]}\n]}}\n')


def compare_masks(masks: Masks, labels: Tensor, num_segments: int) -> MaskMatches:
    """Compares the masks of a frame with its final labels [H, W]; the first `num_segments` labels are of the cloud."""
    num_labels = max(int(labels.max()) + 1, num_segments)
    of_pixel = labels.flatten() + 1  # 0: none
    pixels = torch.bincount(of_pixel, minlength=num_labels + 1)
    covered = torch.bincount(of_pixel[masks.covered().flatten()], minlength=num_labels + 1)
    # Pixels of each pair of an atom and a label, then of each pair of a mask and a label.
    atom, label, number = counted_pairs(masks.atom.flatten().long(), of_pixel)
    records = []
    for mask, area in enumerate(masks.areas().tolist()):
        inside = torch.zeros(masks.num_atoms, dtype=torch.bool)
        inside[masks.pairs[0, masks.pairs[1] == mask]] = True
        here = inside[atom] & (label > 0)
        both = torch.zeros(num_labels + 1, dtype=torch.int64).index_add_(0, label[here], number[here])
        iou = both / (area + pixels - both).clamp(min=1)
        best = int(iou.argmax())
        known, name = masks.ids[mask] if masks.ids else mask, masks.names[mask] if masks.names else ""
        score, shared = round(float(masks.scores[mask]), 4), round(float(iou[best]), 4)
        records.append({"id": known, "name": name, "score": score, "segment": best - 1, "iou": shared, "pixels": area})
    return MaskMatches(records, pixels[1 : num_segments + 1], covered[1 : num_segments + 1])


def count_masks(folder: Path) -> tuple[int, int, int] | None:
    """How many masks became a segment of the cloud, of their image alone, and how many there are; None: no masks."""
    if not has_file(folder / FILE):
        return None
    report = _read(folder)
    masks = [mask for one in report["frames"] for mask in one["masks"]]
    of_cloud = {one["id"] for one in report["segments"]}
    found = [mask["segment"] in of_cloud for mask in masks if mask["iou"] >= FOUND]
    return sum(found), len(found) - sum(found), len(masks)


def frames_with_masks(folder: Path) -> list[str]:
    """The names of the frames that have masks; none without masks.json."""
    return [frame["name"] for frame in _read(folder)["frames"]] if has_file(folder / FILE) else []


def names_of_masks(folder: Path) -> dict[int, str]:
    """The name that most masks of each segment have by their scores, of those that became it; none without masks.json.

    A segment of an image alone has that of the mask that is most like it.
    """
    if not has_file(folder / FILE):
        return {}
    with damage_is(f"{folder / FILE}: not the masks of this result"):
        frames, segments = _read(folder).values()
        found = [mask for one in frames for mask in one["masks"] if mask["iou"] >= FOUND and mask["name"]]
        names = {int(mask["segment"]): mask["name"] for mask in sorted(found, key=lambda mask: float(mask["iou"]))}
        names |= {int(one["id"]): max(one["names"], key=one["names"].get) for one in segments if one["names"]}
        return {segment: printable(name)[:LONGEST] for segment, name in names.items()}


def masked_segments(folder: Path) -> list[int]:
    """The segments of the cloud that lie in masks with at least half of their pixels; none without masks.json."""
    with damage_is(f"{folder / FILE}: not the masks of this result"):
        segments = _read(folder)["segments"] if has_file(folder / FILE) else ()
        return [segment["id"] for segment in segments if segment["masked"] >= 0.5]


def select_masked(folder: Path, result: Result) -> Result:
    """The result with only those segments of the cloud that lie in masks with at least half of their pixels.

    The other segments are -1 in points and images, also those of one image that has no masks; ids stay. There are no
    levels any more.
    """
    present(folder / FILE, "a result of a recording with masks")
    kept, names = masked_segments(folder), frames_with_masks(folder)
    with damage_is(f"{folder / FILE}: not the masks of this result"):
        table = torch.full((count := result.num_point_segments,), -1)
        table[kept] = torch.tensor(kept, dtype=torch.int64)
    if not kept:
        raise ValueError(f"{folder / FILE}: no segment lies in masks with half of its pixels")

    def read(index: int) -> Tensor:
        labels = result.images[index]
        return labels if result.names[index] in names else labels.masked_fill(labels >= count, -1)

    images = level_images(LazySequence(len(result.images), read), count, table, count)
    chosen = replace(result, points=table[result.points], images=images, hierarchy=None, superpoint_images=())
    known, left = result._confidence, chosen.num_point_segments  # which stays, though there are no levels
    vars(chosen)["_confidence"] = known and known._replace(of_segment=known.of_segment[:left])
    return chosen


def _read(folder: Path) -> dict[str, Any]:
    with damage_is(f"{folder / FILE}: not the report of a result's masks"):
        content = read_json(folder / FILE, "a result of a recording with masks")
        return {name: list(content[name]) for name in ("frames", "segments")}
