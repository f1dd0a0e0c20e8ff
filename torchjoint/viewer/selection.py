"""The files of the selected segments that the page offers: a cloud, masks, or COCO's JSON."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from torchjoint.datasets.files.ply import write_cloud
from torchjoint.results.exports.coco import export_coco
from torchjoint.runtime.files import file_name, frame_files
from torchjoint.runtime.lazy import LazySequence
from torchjoint.viewer.model import Model


def export_selected(model: Model, kind: str) -> tuple[str, bytes]:
    """Returns a file of the selected segments: its name and its content.

    * PLY: one cloud of the selected points in their own colours; its property `label` is the displayed id;
    * PNG: a ZIP file with a mask for each frame that sees a selected segment, 255 = selected;
    * COCO: COCO's JSON of the selected segments in all frames, with the displayed ids and the names.

    Raises:
        ValueError: nothing is selected, or an unknown kind, or masks of segments that no frame sees.
        ModuleNotFoundError: COCO needs pycocotools.
    """
    if not model.selected:
        raise ValueError("export: select a segment first")
    called = {model.key(segment): model.names.get(segment, "") for segment in model.selected}
    name = "-".join(f"{key}-{name}" if name else str(key) for key, name in [*called.items()][:5])
    name = file_name(name + (f"-and-{len(called) - 5}-more" if len(called) > 5 else ""))
    result = model.result
    keys = np.where(np.isin(model.table, model.selected), model.parts.keys[model.table], -1)  # of pieces; -1: others
    labels = torch.from_numpy(keys[model.parts.of_point])
    if kind == "PLY":
        chosen = result.scene.select_points(labels >= 0)
        return _written(
            f"{name}.ply", lambda file: write_cloud(file, chosen.points, chosen.colors, labels[labels >= 0])
        )
    if kind not in ("PNG", "COCO"):
        raise ValueError(f"export: expected PLY, PNG or COCO, got {kind!r}")
    images = LazySequence(len(result.images), lambda index: _labels(model, keys, index))
    if kind == "PNG":
        return f"{name}-masks.zip", _masks(images, result.names)
    selection = replace(result, points=labels, images=images, hierarchy=None, piece_images=(), segment_names=called)
    return _written(f"{name}.json", lambda file: export_coco(file, selection))


def _written(name: str, write: Callable[[Path], object]) -> tuple[str, bytes]:
    with TemporaryDirectory() as folder:
        write(Path(folder) / name)
        return name, (Path(folder) / name).read_bytes()


def _labels(model: Model, keys: np.ndarray[tuple[int], np.dtype[np.int64]], index: int) -> Tensor:
    pieces = model.parts.image(index)
    return torch.from_numpy(np.where(pieces < 0, -1, keys[pieces]))


def _masks(images: Sequence[Tensor], names: Sequence[str]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        for name, labels in zip(frame_files(names), images, strict=True):
            if bool((labels >= 0).any()):
                mask = io.BytesIO()
                Image.fromarray(((labels >= 0) * 255).numpy().astype(np.uint8)).save(mask, "png")
                file.writestr(f"{name}.png", mask.getvalue())
    if not file.namelist():
        raise ValueError("export: expected a selected segment that a frame sees, got none")
    return stream.getvalue()
