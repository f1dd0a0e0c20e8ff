"""Scores of a hierarchy at its default level, at the best level of a data set, and at the best level of each scene.

The last two correspond to the optimal data set scale (ODS) and the optimal image scale (OIS) of the boundary benchmark
BSDS: P. Arbelaez et al., "Contour Detection and Hierarchical Image Segmentation" (PAMI 2011). The ground truth chooses
the best levels. So they show what a hierarchy contains, not what a user gets at the default level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

from torch import Tensor

from torchjoint.runtime.files import write_text
from torchjoint.runtime.foreign_files import csv_text
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Hierarchy
from torchjoint_lab.evaluation.scores import COLUMNS, Scores, score
from torchjoint_lab.evaluation.table import markdown

#: The granularities at which a hierarchy is scored: 0, .05, ... 1.
GRANULARITIES = tuple(step / 20 for step in range(21))
#: The granularity of the default level.
DEFAULT = 0.5
#: The scores for which best levels are reported. Precision and recall are not among them: extreme levels maximise them.
REPORTED = ("covering", "f", "best_iou")


class BestLevels(NamedTuple):
    """One score of a data set, in [0, 1]: the mean over its scenes, with levels chosen in three ways."""

    default: float  #: all scenes at the default level
    data_set: float  #: all scenes at the one level that is best for the data set (ODS)
    granularity: float  #: of that level; the coarsest of equally good levels
    scene: float  #: each scene at its own best level (OIS)


def score_levels(hierarchy: Hierarchy, target: Tensor, granularities: Sequence[float] = GRANULARITIES) -> list[Scores]:
    """Scores each level of a hierarchy of N points.

    Args:
        hierarchy: the levels.
        target: [N] int64, true labels, -1 = void.
        granularities: the levels, each in [0, 1].

    Raises:
        TypeError, ValueError: a granularity is outside [0, 1], or the labels are invalid (:mod:`torchjoint.metrics`).
    """
    return parallel_map(lambda granularity: score(hierarchy.at(granularity), target), granularities)


def best_levels(values: Sequence[Sequence[float]], granularities: Sequence[float] = GRANULARITIES) -> BestLevels:
    """Chooses levels by one score.

    Args:
        values: for each scene, the score at each granularity.
        granularities: the same for all scenes; the default, 0.5, is one of them.

    Raises:
        ValueError: no scene, no default level, or a scene without a value for each granularity.

    Example:
        >>> best_levels([[0.1, 0.4, 0.7], [0.9, 0.5, 0.3]], [0.25, 0.5, 0.75])
        BestLevels(default=0.45, data_set=0.5, granularity=0.25, scene=0.8)
    """
    if not values or any(len(of_scene) != len(granularities) for of_scene in values):
        raise ValueError(f"values: expected {len(granularities)} for each scene, got {[*map(len, values)]}")
    if DEFAULT not in granularities:
        raise ValueError(f"granularities: expected {DEFAULT} among them, got {list(granularities)}")
    means = [fmean(of_level) for of_level in zip(*values, strict=True)]
    best = min(range(len(means)), key=lambda level: (-means[level], granularities[level]))
    default = means[list(granularities).index(DEFAULT)]
    return BestLevels(default, means[best], granularities[best], fmean(max(of_scene) for of_scene in values))


def level_table(scenes: Mapping[str, Sequence[Scores]]) -> str:
    """Returns a table of the best levels, in 3D, of scenes that were scored at :data:`GRANULARITIES`."""
    body = []
    for name in REPORTED:
        best = best_levels([[getattr(scores, name) for scores in of_scene] for of_scene in scenes.values()])
        row = [COLUMNS[Scores._fields.index(name)], f"{best.default:.3f}", f"{best.data_set:.3f}"]
        body.append([*row, f"{best.granularity:.2f}", *([f"{best.scene:.3f}"] if len(scenes) > 1 else [])])
    if len(scenes) == 1:
        return markdown(["3D, all levels", "default", "best level", "granularity"], body)
    return markdown(
        ["3D, all levels", "default", "best level of the data set", "granularity", "best level of each scene"], body
    )


def write_levels(path: Path, scenes: Mapping[str, Sequence[Scores]]) -> None:
    """Writes one line per scene and granularity, .csv; atomic (a temporary file is renamed)."""
    rows = [["scene", "granularity", *Scores._fields]]
    for name, of_scene in scenes.items():
        for granularity, scores in zip(GRANULARITIES, of_scene, strict=True):
            rows.append([name, f"{granularity:.2f}", *(f"{value:.6f}" for value in scores)])
    write_text(path, csv_text(rows))
