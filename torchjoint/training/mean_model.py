"""The mean of several models of boundaries: it errs less than each, since each has random errors of its own."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import pad

from torchjoint.points.boundary_model import BoostedTrees, BoundaryModel, calibrated


def mean_model(members: Sequence[BoundaryModel]) -> BoundaryModel:
    """The model whose trees have the mean log odds of the members' trees, and whose calibrations are their means.

    Args:
        members: at least one, all with the same thresholds and features.
    """
    if len(members) == 1:
        return members[0]
    return BoundaryModel(
        members[0].thresholds,
        members[0].feature_names,
        tuple(map(mean_trees, zip(*(one.rounds for one in members), strict=True))),
        tuple(map(mean_calibration, zip(*(one.calibrations for one in members), strict=True))),
    )


def mean_trees(members: Sequence[BoostedTrees]) -> BoostedTrees:
    """The trees of all members, with leaves so small that the sum over all trees is the members' mean."""
    length = max(one.feature.shape[1] for one in members)

    def joined(name: str, padding: float) -> Tensor:
        arrays: list[Tensor] = [getattr(one, name) for one in members]
        return torch.cat([pad(array, (0, length - array.shape[1]), value=padding) for array in arrays])

    return BoostedTrees(
        feature=joined("feature", 0),
        threshold=joined("threshold", 0),
        missing_left=joined("missing_left", False),
        left=joined("left", -1),
        right=joined("right", -1),
        leaf_value=joined("leaf_value", 0) / len(members),
        baseline=sum(one.baseline for one in members) / len(members),
    )


def mean_calibration(members: Sequence[Tensor]) -> Tensor:
    """The mean of piecewise linear maps, each [2, C]; it has a knot where any of them has one."""
    knots = torch.cat([one[0] for one in members]).unique()
    return torch.stack([knots, torch.stack([calibrated(knots, one) for one in members]).mean(0)])
