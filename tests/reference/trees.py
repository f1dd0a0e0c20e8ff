"""Reference version of the operator on decision trees (step 6, method learned)."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def boosted_trees_reference(
    values: Tensor,
    feature: Tensor,
    threshold: Tensor,
    missing_left: Tensor,
    left: Tensor,
    right: Tensor,
    leaf_value: Tensor,
) -> Tensor:
    """What :func:`torchjoint.ops.boosted_trees` computes; the arguments are not checked."""
    sums = []
    for row in values.tolist():
        total = 0.0
        for tree in range(len(feature)):
            place = 0
            while left[tree, place] >= 0:
                value = row[int(feature[tree, place])]
                if math.isnan(value):
                    goes_left = bool(missing_left[tree, place])
                else:
                    goes_left = value <= float(threshold[tree, place])
                place = int(left[tree, place] if goes_left else right[tree, place])
            total += float(leaf_value[tree, place])
        sums.append(total)
    return torch.tensor(sums, dtype=torch.float64)
