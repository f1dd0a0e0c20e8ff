"""Reads the masks of all frames of a scene from one folder or one COCO file."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

from torch.utils.data import Subset

from torchjoint.masks.coco import CocoFile
from torchjoint.masks.files import SUFFIXES, read_masks
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.runtime.lazy import LazySequence
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Frame, Scene
from torchjoint.scene.masks import Masks

Readers = dict[str, Callable[[], Masks]]
#: Largest number of names that a message shows.
_SHOWN = 5


def read_folder(folder: Path | str, scene: Scene, without: Literal["segment", "leave out"] = "segment") -> Scene:
    """Adds masks to the frames of a scene. The masks of a frame are read when the frame is read.

    Masks belong to the frame of the same name. Names of masks may have one more suffix: ``frame-000001.masks.png``
    belongs to frame ``frame-000001``.

    Args:
        folder: files and folders that :func:`read_masks` reads, one for each frame; or a COCO data set, one JSON file.
        scene: a scene whose frames have names.
        without: "segment" keeps frames without masks, and the segmenter segments them; "leave out" drops them.

    Raises:
        FileNotFoundError: there is no such folder or file.
        ValueError: no masks have the name of a frame, or a frame has two files of masks. Later, when a frame is read:
            its masks are damaged; the message names the file.

    Warns:
        UserWarning: some frames have no masks, or some masks have no frame; with their number and first names.
    """
    if without not in ("segment", "leave out"):
        raise ValueError(f"without: expected 'segment' or 'leave out', got {without!r}")
    folder = Path(folder)
    readers = _readers(folder)
    names = frame_names(scene.frames)
    of_frame = _matched(names, readers, folder)
    missing = [name for name, reader in zip(names, of_frame, strict=True) if reader is None]
    if len(missing) == len(names):
        raise ValueError(
            f"{folder}: no masks have the name of a frame: masks {_listed(sorted(readers))}; frames {_listed(names)}"
        )
    if missing:
        what = "segmented without masks" if without == "segment" else "left out"
        warnings.warn(
            f"masks: {len(missing)} of {len(names)} frames have none and are {what}: {_listed(missing)}", stacklevel=2
        )
    frames = LazySequence(len(names), lambda index: _with_masks(scene.frames[index], of_frame[index]), names)
    masked = replace(scene, frames=frames)
    if without == "segment" or not missing:
        return masked
    return masked.select_frames([index for index, reader in enumerate(of_frame) if reader is not None])


def check_files(folder: Path | str) -> None:
    """Reads all masks once, to find damaged files before a long run.

    Args:
        folder: as in :func:`read_folder`.

    Raises:
        FileNotFoundError, ValueError: as in :func:`read_folder`; ValueError also for the first damaged file.
    """

    def check(reader: Callable[[], Masks]) -> None:
        reader()  # and forget them

    parallel_map(check, _readers(Path(folder)).values())


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
        is_masks = path.suffix.lower() in SUFFIXES or (has_folder(path) and any(path.glob("*.png")))
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
