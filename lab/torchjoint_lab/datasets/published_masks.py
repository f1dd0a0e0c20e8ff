"""Masks of ScanNet's frames, in the layouts in which other methods keep them.

| method | masks of a scan in DIR |
|---|---|
| MaskClustering (CropFormer) | SCAN/output/mask/N.png or SCAN/mask/N.png, 0: none |
| SAI3D (Semantic-SAM) | SCAN/semantic-sam/maskraw_N.png, 0: none; maskcolor_N.png is a picture |
| SAM3D (SAM) | SCAN/N.png, 16 bits, 65535: none, and 0 is a mask |
| Open3DIS (Grounding DINO and SAM) | SCAN.pth: frame -> run lengths `masks`, `conf`, `img_feat` |

Sources: mask_predict.py, sam_auto_generation.py, sam3d.py, tools/grounding_2d.py of their repositories.
"""

from __future__ import annotations

import pickle
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from torch import Tensor

from torchjoint.datasets.files.readers import labels_of, read_raster
from torchjoint.masks import from_labels, from_sam, read_masks, save_masks
from torchjoint.runtime.foreign_files import damage_is, read_file
from torchjoint.runtime.store import load_values
from torchjoint.scene.masks import Masks

PLACES = ("output/mask", "mask", "")
NO_MASK = 65535  # -1 in 16 bits


@contextmanager
def masks_of(folder: Path, scan: str, frames: Sequence[str]) -> Iterator[Path]:
    """A folder with the masks of a scan, for :func:`torchjoint.masks.read_folder`; a temporary one if it must be made.

    Args:
        folder: DIR of the layouts above, or of what `read_folder` reads.
        scan: its name.
        frames: names of its frames. Numbers of the lower three layouts may have zeros in front: 00020 is frame 20.

    Raises:
        FileNotFoundError: there are no masks of the scan.
        ValueError: masks are damaged, or there are several for a scan or a frame; the message names the file.
    """
    place = next((folder / scan / one for one in PLACES if (folder / scan / one).is_dir()), None)
    raw = _visible((folder / scan).glob("*/maskraw_*.png"))
    pth = folder / f"{scan}.pth"
    found = {one.parent for one in raw} | ({pth} if pth.is_file() else set())
    if place is not None and place.name == "mask":
        found.add(place)
    if len(found) > 1:
        raise ValueError(f"{folder / scan}: expected one set of masks, got {', '.join(sorted(map(str, found)))}")
    masks: Iterable[tuple[str, Masks]]
    if pth.is_file():
        masks = _open3dis(pth)
    elif raw:
        masks = ((one.stem.removeprefix("maskraw_"), read_masks(one)) for one in raw)
    elif place is None:
        raise FileNotFoundError(
            f"{folder / scan}: missing; expected masks of the scan in it, or in mask/ or output/mask/, or {scan}.pth"
        )
    elif not any((_numbers(one) == NO_MASK).any() for one in _visible(place.glob("*.png"))):
        yield place
        return
    else:
        masks = ((one.stem, _sam3d(one)) for one in _visible(place.glob("*.png")))
    numbered = {int(name): name for name in frames if name.isdecimal()}
    with TemporaryDirectory() as made:
        for name, of_frame in masks:
            file = Path(made) / f"{numbered.get(int(name), name) if name.isdecimal() else name}.npz"
            if file.exists():
                raise ValueError(f"{folder / scan}: expected one set of masks for each frame, got two for {file.stem}")
            save_masks(file, of_frame)
        yield Path(made)


def _visible(paths: Iterable[Path]) -> list[Path]:
    """In order; without hidden files, such as those that macOS writes beside others."""
    return sorted(path for path in paths if not path.name.startswith("."))


def _numbers(path: Path) -> Tensor:
    return labels_of(read_raster(path), str(path))


def _sam3d(path: Path) -> Masks:
    labels = _numbers(path)
    return from_labels(labels.masked_fill(labels == NO_MASK, -1))


def _open3dis(path: Path) -> Iterator[tuple[str, Masks]]:
    with damage_is(f"{path}: not masks of Open3DIS", OSError, MemoryError, pickle.UnpicklingError):
        for key, frame in load_values(read_file(path, "masks of Open3DIS, .pth")).items():
            name, masks, conf = Path(key).name, frame["masks"], frame["conf"]
            if not re.fullmatch(r"\w[\w.-]{0,99}", name):
                raise ValueError(f"expected names of frames, got {key[:40]!r}")
            if not isinstance(masks, list) or conf.shape != (len(masks),):  # a tensor may be larger than its file
                raise ValueError(f"expected a list of masks, and a number for each, for frame {name}")
            scored = zip(masks, conf.tolist(), strict=True)
            if masks:
                yield name, from_sam([{"segmentation": one, "predicted_iou": score} for one, score in scored])
