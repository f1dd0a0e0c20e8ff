"""Masks and vectors as OpenMask3D writes them (A. Takmaz et al., NeurIPS 2023), for its search and its evaluation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from torchjoint.results.exports.scannet import scene_name
from torchjoint.results.result import Result
from torchjoint.runtime.threads import on_cpu


@on_cpu()
def export_openmask3d(folder: Path, result: Result) -> None:
    """Writes SCENE_masks.pt, a tensor [N, S] bool, and SCENE_openmask3d_features.npy, [S, D] float32.

    OpenMask3D itself saves its masks as a NumPy array, which ``torch.load`` of today refuses; its programs take both.
    The vectors are of unit length; as there, a segment that no frame sees has zeros.

    Raises:
        ValueError: no embeddings were saved with the result.
    """
    if result.embeddings is None:
        raise ValueError("--format openmask3d: expected saved embeddings, got none; result.embed(...).save(RESULT)")
    folder.mkdir(parents=True)
    name = scene_name(result)
    masks = result.points[:, None] == torch.arange(result.num_point_segments)
    torch.save(masks, folder / f"{name}_masks.pt")
    np.save(folder / f"{name}_openmask3d_features.npy", result.embeddings.vectors.numpy())
