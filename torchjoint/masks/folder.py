"""Masks of a recording in a folder."""

import csv
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch.utils.data import Subset

from torchjoint.datasets.files.readers import read_label_image, read_raster
from torchjoint.datasets.files.text import parse_numbers
from torchjoint.masks.arrays import as_binary, as_tensor, from_labels
from torchjoint.masks.coco import CocoFile
from torchjoint.masks.networks import from_sam
from torchjoint.masks.segmentation import Pixels, merged, pixels_of
from torchjoint.runtime import bounds
from torchjoint.runtime.archives import read_archive, write_archive
from torchjoint.runtime.foreign_files import DAMAGE, dict_of, has_file, has_folder, is_there, read_json, read_text
from torchjoint.runtime.threads import LazySequence, on_cpu, parallel_map
from torchjoint.scene import Frame, Scene
from torchjoint.scene.masks import Masks
from torchjoint.scene.scene import evenly_spaced_indices

#: The files that :func:`read_masks` reads, besides folders.
SUFFIXES, PNGS = (".png", ".npz", ".json"), "[!.]*.[pP][nN][gG]"
#: Scores in a folder of PNGs, as SAM's command line writes them: columns id, predicted_iou, stability_score.
METADATA = "metadata.csv"
#: A mask of a larger share of its image is hardly that of a thing.
WHOLE = 0.9


@on_cpu()
def read_masks(path: Path | str) -> Masks:
    """Reads the masks of one frame. The kind of file determines the reader.

    Args:
        path: one of

            * ``NAME.png``: labels of 2 to 16 bits, 0 = none;
            * a folder of PNGs, each one mask (0 outside); the number of a file is its id, others get free numbers;
              and an optional ``metadata.csv`` with scores, as SAM's command line writes it;
            * ``NAME.npz``: what :func:`save_masks` wrote; or ``masks`` ([M, H, W] booleans, or labels [H, W], -1 =
              none, or 0 if they have no sign), and optional ``scores``;
            * ``NAME.json``: SAM's list of dicts with run lengths, or SA-1B's dict with such a list as ``annotations``.

    Raises:
        FileNotFoundError: there is no such file or folder.
        ValueError: an unknown kind of file, or a damaged one; the message names it.
    """
    path = Path(path)
    if not is_there(path):
        raise FileNotFoundError(f"{path}: missing; expected masks")
    readers = {".png": _read_labels, ".npz": _read_npz, ".json": _read_json}
    reader = _read_pngs if has_folder(path) else readers.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path}: expected masks in a folder or in a file of kind {', '.join(SUFFIXES)}")
    try:
        return reader(path)
    except DAMAGE as error:
        message = str(error)
        raise ValueError(message if message.startswith(str(path)) else f"{path}: {message}") from error


@on_cpu()
def save_masks(path: Path | str, masks: Masks) -> None:
    """Writes masks for :func:`read_masks`, compressed, to a temporary file that is then renamed; makes the folder.

    An earlier file is replaced, as NumPy does.

    Raises:
        ValueError: the file name does not end with .npz.
    """
    path = Path(path)
    if path.suffix != ".npz":
        raise ValueError(f"path: expected a file name with .npz, got {path.name}")
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {"atom": masks.atom.numpy(), "pairs": masks.pairs.numpy(), "mask_scores": masks.scores.numpy()}
    arrays |= {key: np.array(of) for key, of in (("ids", masks.ids), ("names", masks.names)) if of}
    write_archive(path, arrays)


def _read_labels(path: Path) -> Masks:
    masks = from_labels(read_label_image(path), none=0)
    if masks.ids == (255,):
        told = "an image of only 0 and 255 is taken as one mask; of several things, each needs a number, or an image"
        warnings.warn(f"{path.parent}: {told} in NAME/", stacklevel=2)
    return masks


def _read_json(path: Path) -> Masks:
    content = read_json(path, "masks")
    if not isinstance(content, Mapping):
        return from_sam(content, None if content else (1, 1))  # no mask: of an image of any size
    if "images" in content:
        raise ValueError(f"{path}: expected the masks of one image, got a COCO data set; give the file itself: {path}")
    if "annotations" not in content:
        raise ValueError(f"{path}: expected a list of masks, or a dict with annotations, got {', '.join(content)}")
    image: Any = content.get("image", {})
    size = (int(image["height"]), int(image["width"])) if {"height", "width"} <= set(image) else None
    return from_sam(content["annotations"], size)


def _read_npz(path: Path) -> Masks:
    arrays = read_archive(path)
    for name in ("atom", "masks"):
        if name in arrays and arrays[name].ndim in (2, 3):
            bounds.check_pixels(arrays[name].shape[-2], arrays[name].shape[-1], name)
    for name in ("mask_scores", "ids", "names"):
        bounds.check(len(np.atleast_1d(arrays.get(name, ()))), bounds.MASKS, name)
    bounds.check(arrays.get("pairs", np.empty(0)).size, 2 * bounds.PAIRS, "numbers of pairs")
    if {"atom", "pairs", "mask_scores"} <= set(arrays):
        ids, names = (tuple(arrays[key].tolist()) if key in arrays else () for key in ("ids", "names"))
        tensors = [torch.from_numpy(arrays[key]) for key in ("atom", "pairs", "mask_scores")]
        return Masks(tensors[0], tensors[1], tensors[2], ids, names)
    if "masks" not in arrays:
        raise ValueError(f"{path}: expected masks, and optional scores, got {', '.join(arrays) or 'nothing'}")
    if unread := ", ".join(sorted(set(arrays) - {"masks", "scores", "names"})):
        warnings.warn(f"masks in .npz: expected masks, scores and names; not read: {unread}", stacklevel=2)
    masks, scores, names = arrays["masks"], arrays.get("scores"), tuple(map(str, arrays.get("names", ())))
    if masks.ndim < 3:
        return replace(from_labels(masks, scores), names=names)
    each = (pixels_of(mask, None, f"masks[{index}]") for index, mask in enumerate(masks))
    of_masks = torch.ones(len(masks)) if scores is None else as_tensor(scores, "scores").float()
    return replace(merged(each, len(masks), (masks.shape[1], masks.shape[2]), of_masks, "masks"), names=names)


def _read_pngs(path: Path) -> Masks:
    files = sorted(path.glob(PNGS), key=lambda file: (len(file.name), file.name))
    if not files:
        raise ValueError(f"{path}: expected PNGs, one for each mask, got none")
    stems = [file.stem for file in files]
    scores = torch.tensor(_scores(path / METADATA, stems) or [1.0] * len(files), dtype=torch.float32)
    names = tuple("" if stem.isdecimal() else stem for stem in stems)  # SAM's numbers are no names
    numbers = {stem: int(stem) for stem in stems if stem.isdecimal() and len(stem) < 19}
    free = iter(sorted({*range(len(stems))} - {*numbers.values()}))
    ids = tuple(numbers[stem] if stem in numbers else next(free) for stem in stems)
    dict_of([*zip(ids, files, strict=True)], f"{path}: mask")  # 1.png and 01.png
    return replace(merged(map(_read_png, files), len(files), None, scores, path.name), ids=ids, names=names)


def _read_png(file: Path) -> Pixels:
    image = read_raster(file)
    if image.mode not in ("1", "L"):
        raise ValueError(f"{file}: expected a mask with values 0 and 255, got an image of mode {image.mode}")
    return pixels_of(as_binary(np.array(image), str(file)), None, str(file))


def _scores(path: Path, ids: list[str]) -> list[float] | None:
    if not has_file(path):
        return None
    try:
        table = csv.DictReader(read_text(path, "scores of masks").split("\n"), skipinitialspace=True)
        rows = dict_of([(row.get("id"), row) for row in table], f"{path}: mask")
    except csv.Error as error:
        raise ValueError(f"{path}: expected a table: {error}") from error
    if lost := sorted(map(str, rows.keys() - {*ids})):
        warnings.warn(f"{path}: {len(lost)} of its masks have no PNG: {_listed(lost)}", stacklevel=2)
    scores = []
    for name in ids:
        if name not in rows:
            raise ValueError(f"{path}: expected a line with id {name}")
        values = [rows[name].get(column) or "1" for column in ("predicted_iou", "stability_score")]
        scores.append(math.prod(parse_numbers(values, f"{path}: line with id {name}", finite=False)))
    return [score if score != score else min(max(score, 0.0), 1.0) for score in scores]  # Masks checks for NaN


Readers = dict[str, Callable[[], Masks]]
#: Largest number of names that a message shows.
_SHOWN = 5


def read_folder(
    folder: Path | str,
    scene: Scene,
    without: Literal["segment", "leave out"] = "segment",
    max_frames: int | None = None,
) -> Scene:
    """Adds masks to the frames of a scene. The masks of a frame are read when the frame is read.

    Masks belong to the frame of the same name. Names of masks may have one more suffix: ``frame-000001.masks.png``
    belongs to frame ``frame-000001``.

    Args:
        folder: files and folders that :func:`read_masks` reads, one for each frame; or a COCO data set, one JSON file.
        scene: a scene whose frames have names.
        without: "segment" keeps frames without masks, and the segmenter segments them; "leave out" drops them.
        max_frames: number of frames to use: those with masks first, and evenly spread over these; None: all.

    Raises:
        FileNotFoundError: there is no such folder or file.
        ValueError: no masks have the name of a frame, or a frame has two files of masks. Later, when a frame is read:
            its masks are damaged; the message names the file.

    Warns:
        UserWarning: some frames have no masks, or some masks have no frame; with their number and first names.
    """
    if without not in ("segment", "leave out"):
        raise ValueError(f"without: expected 'segment' or 'leave out', got {without!r}")
    if max_frames is not None and max_frames < 0:
        raise ValueError(f"max_frames: expected >= 0, got {max_frames}")
    folder = Path(folder)
    readers, names = _readers(folder), frame_names(scene.frames)
    of_frame = _matched(names, readers, folder)
    if not any(of_frame):
        if len(readers) == 1:
            next(iter(readers.values()))()  # its error may say why: a COCO data set
        told = f"{folder}: no masks (.png, .npz, .json, or folders of .png) have the name of a frame; rename them"
        found = f"{_listed(sorted(readers or (file.name for file in folder.glob('*'))))}; frames {_listed(names)}"
        raise ValueError(f"{told}, or convert a network's own files (examples/sam_masks.py): masks {found}")
    frames = LazySequence(len(names), lambda index: _with_masks(scene.frames[index], of_frame[index]), names)
    have, lack = ([i for i, one in enumerate(of_frame) if (one is None) == is_none] for is_none in (False, True))
    most = len(names) if max_frames is None else max_frames
    used = [have[place] for place in evenly_spaced_indices(len(have), most)]
    count, what = len(names), "left out"
    if without == "segment":
        lack = [lack[place] for place in evenly_spaced_indices(len(lack), most - len(used))]
        used = sorted(used + lack)
        count, what = len(used), "segmented without masks"
    if lack:
        told = f"masks: {len(lack)} of {count} frames have none and are {what}"
        warnings.warn(f"{told}: {_listed([names[index] for index in lack])}", stacklevel=2)
    masked = replace(scene, frames=frames)
    return masked if len(used) == len(names) else masked.select_frames(used)


def check_files(folder: Path | str) -> None:
    """Reads all masks once, to find damaged files before a long run; warns of masks of nearly the whole image.

    Args:
        folder: as in :func:`read_folder`.
    """

    def count(reader: Callable[[], Masks]) -> int:
        masks = reader()
        return int((masks.areas() > WHOLE * masks.atom.numel()).sum())

    if whole := sum(counts := parallel_map(count, _readers(Path(folder)).values())):
        told = f"{whole} masks, in {sum(map(bool, counts))} of {len(counts)} images, cover over {WHOLE:.0%} of them"
        warnings.warn(f"{folder}: {told}; they join what they cover: leave them out", stacklevel=2)


def frame_names(frames: Sequence[Frame]) -> list[str]:
    """The names of frames. Lazy frames are not read if their names are known."""
    if isinstance(frames, LazySequence) and len(frames.names) == len(frames):
        return list(frames.names)
    if isinstance(frames, Subset) and isinstance(frames.dataset, Sequence):
        names = frame_names(frames.dataset)
        return [names[index] for index in frames.indices]
    return [frame.name for frame in frames]


def _with_masks(frame: Frame, reader: Callable[[], Masks] | None) -> Frame:
    return frame if reader is None else replace(frame, labels=None, masks=reader(), mask_scores=None)


def _readers(folder: Path) -> Readers:
    """The readers of masks: name of the masks -> function that reads them."""
    if has_file(folder):
        coco = CocoFile(folder)
        return {name: partial(coco.read, name) for name in coco.names}
    if not has_folder(folder):
        raise FileNotFoundError(f"{folder}: missing; expected a folder of masks, or a COCO file")
    readers: Readers = {}
    for path in sorted(folder.iterdir()):
        is_masks = path.suffix.lower() in SUFFIXES or (has_folder(path) and any(path.glob(PNGS)))
        if path.name.startswith(".") or not is_masks:
            continue
        name = path.name if has_folder(path) else path.stem
        if name in readers:
            raise ValueError(f"{folder}: two masks for {name!r}, the second one is {path.name}")
        readers[name] = partial(read_masks, path)
    return readers


def _matched(names: Sequence[str], readers: Readers, folder: Path) -> list[Callable[[], Masks] | None]:
    """The reader of each frame's masks; None = no masks. Warns if masks have no frame."""
    known = set(names)
    of_name: Readers = {}
    lost = []
    for name, reader in readers.items():
        frame = next((one for one in (name, Path(name).stem) if one in known), None)
        if frame is None:
            lost.append(name)
        elif frame in of_name:
            raise ValueError(f"{folder}: two masks for frame {frame!r}, the second one is {name!r}")
        else:
            of_name[frame] = reader
    if lost and of_name:
        warnings.warn(f"masks: {len(lost)} of {len(readers)} have no frame: {_listed(lost)}", stacklevel=3)
    return [of_name.get(name) for name in names]


def _listed(names: Sequence[str]) -> str:
    more = f", ... ({len(names)})" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more if names else "(none)"
