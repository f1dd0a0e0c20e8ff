"""boosted_trees: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import NAN, PIXELS, VALUES, changed
from torchjoint.ops.internal import boosted_trees

EXAMPLE: dict[str, Any] = {
    "values": torch.tensor([[0.5, 2.0], [0.6, NAN], [NAN, 1.0]]),
    "feature": torch.tensor([[0, 0, 0], [1, 0, 0]], dtype=torch.int32),
    "threshold": torch.tensor([[0.5, 0.0, 0.0], [1.5, 0.0, 0.0]], dtype=torch.float64),
    "missing_left": torch.tensor([[True, False, False], [False, False, False]]),
    "left": torch.tensor([[1, -1, -1], [2, -1, -1]], dtype=torch.int32),
    "right": torch.tensor([[2, -1, -1], [1, -1, -1]], dtype=torch.int32),
    "leaf_value": torch.tensor([[0.0, -1.0, 2.0], [0.0, 0.25, 0.5]], dtype=torch.float64),
}  # fmt: skip
ERRORS = [
    ({"values": EXAMPLE["values"].double()}, TypeError, "values: expected dtype torch.float32, got"),
    ({"values": VALUES}, ValueError, "values: expected shape [B, F], got [3]"),
    ({"values": EXAMPLE["values"][:, :1]}, ValueError, "numbers in [0, 1), got 1 at node 0 of tree 1"),
    ({"feature": EXAMPLE["left"].long()}, TypeError, "feature: expected dtype torch.int32, got"),
    ({"feature": EXAMPLE["left"][0]}, ValueError, "feature: expected shape [T, M], got [3]"),
    ({"feature": EXAMPLE["left"]}, ValueError, "feature: expected numbers in [0, 2), got -1 at node"),
    ({"threshold": VALUES.double()}, ValueError, "threshold: expected shape [T, M] = [2, 3], got [3]"),
    (
        {"threshold": changed(EXAMPLE["threshold"], torch.inf, 1, 0)},
        ValueError,
        "threshold: expected finite numbers, got inf at node 0 of tree 1",
    ),
    ({"missing_left": EXAMPLE["left"]}, TypeError, "missing_left: expected dtype torch.bool, got"),
    (
        {"left": changed(EXAMPLE["left"], 0, 0, 0)},
        ValueError,
        "left: expected -1 or places after the node's, below 3, got 0 at node 0 of tree 0",
    ),
    ({"left": changed(EXAMPLE["left"], 3, 1, 0)}, ValueError, "below 3, got 3 at node 0 of tree 1"),
    ({"left": EXAMPLE["left"][:1]}, ValueError, "left: expected shape [T, M] = [2, 3], got [1, 3]"),
    ({"right": changed(EXAMPLE["right"], -2, 0, 1)}, ValueError, "right: expected -1 or places"),
    (
        {"right": changed(EXAMPLE["right"], -1, 0, 0)},
        ValueError,
        "right: expected -1 exactly where left is -1, got -1 at node 0 of tree 0",
    ),
    ({"leaf_value": VALUES}, TypeError, "leaf_value: expected dtype torch.float64, got torch.float32"),
    ({"leaf_value": EXAMPLE["leaf_value"] * NAN}, ValueError, "leaf_value: expected finite numbers"),
]
REFUSED = [
    {"values": VALUES},
    {"feature": PIXELS},
    {"feature": torch.empty(2, 0, dtype=torch.int32)},
    {"threshold": EXAMPLE["leaf_value"][:1]},
    {"leaf_value": EXAMPLE["leaf_value"].float()},
]


def boosted_trees_reference(
    values: Tensor,
    feature: Tensor,
    threshold: Tensor,
    missing_left: Tensor,
    left: Tensor,
    right: Tensor,
    leaf_value: Tensor,
) -> Tensor:
    """What :func:`torchjoint.ops.internal.boosted_trees` computes; the arguments are not checked."""
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


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    places = torch.arange(1, 64, dtype=torch.int32).expand(40, -1)
    left = torch.where((places % 2 == 1) & (places < 63), places, -1)  # of two children the first is a leaf
    trees = {
        "feature": torch.zeros_like(left), "threshold": torch.zeros(left.shape, dtype=torch.float64),
        "missing_left": torch.zeros_like(left, dtype=torch.bool), "left": left,
        "right": torch.where(left > 0, left + 1, -1),
        "leaf_value": torch.rand(left.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)),
    }  # fmt: skip
    values = torch.rand(int(200_000 * share), 2, generator=torch.Generator().manual_seed(0))
    return lambda: boosted_trees(values, **trees)
