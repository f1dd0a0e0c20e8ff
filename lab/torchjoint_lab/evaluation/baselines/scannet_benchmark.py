"""Reads instances in the format of ScanNet's benchmark: text files with one number per vertex of a scan's mesh.

http://kaldir.vc.in.tum.de/scannet_benchmark/documentation
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint.datasets.files.text import path_inside
from torchjoint_lab.datasets.vertex_numbers import read_text, read_vertex_numbers


class InstanceMasks(NamedTuple):
    """K predicted instances of N vertices."""

    masks: Tensor  #: [K, N] bool
    scores: Tensor  #: [K] float64, confidence
    classes: Tensor  #: [K] int64, NYU40 classes


def read_instance_masks(path: Path, num_points: int) -> InstanceMasks:
    """Reads a prediction: one line per instance, "relative/path.txt class confidence".

    Each of these files has one number per vertex, 0 = not the instance.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: the message names the file and its error; also if a path leaves the folder or occurs twice.
    """
    folder = path.parent.resolve()
    masks: dict[Path, Tensor] = {}
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if line.strip():
            file, label, score = _parse(line, f"{path}, line {number}", folder)
            if file in masks:
                raise ValueError(f"{path}, line {number}: {file.name} comes twice; expected a mask for each instance")
            masks[file] = read_vertex_numbers(file, num_points) != 0
            rows.append((label, score))
    if not rows:
        nothing = torch.zeros(0)
        return InstanceMasks(torch.zeros((0, num_points), dtype=torch.bool), nothing.double(), nothing.long())
    classes, scores = zip(*rows, strict=True)
    return InstanceMasks(
        torch.stack(list(masks.values())), torch.tensor(scores, dtype=torch.float64), torch.tensor(classes)
    )


def _parse(line: str, name: str, folder: Path) -> tuple[Path, int, float]:
    parts = line.split()
    try:
        relative, label, score = parts[0], int(float(parts[1])), float(parts[2])
        if len(parts) != 3 or not -(2**31) < label < 2**31 or score != score:
            raise ValueError
    except (ValueError, IndexError, OverflowError):
        raise ValueError(f"{name}: expected a path, a class and a confidence, got {line[:100]!r}") from None
    file = path_inside(folder, relative, name)
    if not file.resolve().is_relative_to(folder):
        raise ValueError(
            f"{name}: expected a file inside {folder}, got {relative[:100]!r}, a link that leads elsewhere"
        )
    return file.resolve(), label, score
