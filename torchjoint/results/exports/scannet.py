"""Instances as ScanNet's benchmark and its evaluators read them (`torchjoint-lab evaluate` does)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchjoint.results.result import Result
from torchjoint.runtime.files import atomic_write, file_name
from torchjoint.runtime.threads import on_cpu

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
    for segment, score in enumerate(_scores(result).tolist()):
        file = f"predicted_masks/{name}_{segment:03d}.txt"
        digits = (result.points == segment).numpy().astype(np.uint8) + ord("0")
        (folder / file).write_bytes(np.stack([digits, np.full_like(digits, ord("\n"))], 1).tobytes())
        lines.append(f"{file} {LABEL} {score:.4f}\n")
    (folder / f"{name}.txt").write_text("".join(lines), encoding="utf-8")


@on_cpu()
def export_masks(path: Path, result: Result) -> None:
    """Writes an archive with the arrays pred_masks [N, S] bool, pred_score [S] and pred_classes [S]."""
    count = result.num_point_segments
    masks = (result.points[:, None] == torch.arange(count)).numpy()
    with atomic_write(path) as partial, partial.open("wb") as stream:  # NumPy would add .npz to a path
        np.savez_compressed(
            stream,
            pred_masks=masks,
            pred_score=_scores(result).numpy(),
            pred_classes=np.full(count, LABEL, dtype=np.int32),
        )


def scene_name(result: Result) -> str:
    """The scene's name as a word, for names of files."""
    return file_name("_".join(result.scene.name.split()) or "scene")


def _scores(result: Result) -> Tensor:
    sure = result.confidence
    return torch.ones(result.num_point_segments, dtype=torch.float64) if sure is None else sure
