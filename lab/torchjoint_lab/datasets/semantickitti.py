"""One labelled LiDAR sweep of SemanticKITTI: NAME.bin beside NAME.label."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

#: Classes of vehicles and people, of ground, and of nothing known.
THINGS = (10, 11, 13, 15, 16, 18, 20, 30, 31, 32, *range(252, 260))
GROUND = (40, 44, 48, 49, 60, 72)
VOID = (0, 1)


class LabelledSweep(NamedTuple):
    """A sweep with its truth."""

    points: Tensor  #: [N, 3] float32 metres, as the sensor sees them
    instance: Tensor  #: [N] int64: every vehicle and person, 0 = all ground, -1 = none of them
    void: Tensor  #: [N] bool, nobody knows what it is


def read_sweep(path: Path) -> LabelledSweep:
    """Reads NAME.bin and its labels.

    Raises:
        FileNotFoundError: one of the two is missing.
    """
    points = torch.from_numpy(np.fromfile(path, dtype=np.float32).reshape(-1, 4)[:, :3].copy())
    label = torch.from_numpy(np.fromfile(path.with_suffix(".label"), dtype=np.uint32).astype(np.int64))
    kind = label & 0xFFFF
    instance = torch.where(torch.isin(kind, torch.tensor(THINGS)), label, -1)
    instance = torch.where(torch.isin(kind, torch.tensor(GROUND)), 0, instance)
    return LabelledSweep(points, instance, torch.isin(kind, torch.tensor(VOID)))
