"""Step 6, method learned: sums boosted decision trees over rows of features."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor

from torchjoint.ops._call import call
from torchjoint.ops._checks import check_array


def boosted_trees(
    values: Tensor,
    feature: Tensor,
    threshold: Tensor,
    missing_left: Tensor,
    left: Tensor,
    right: Tensor,
    leaf_value: Tensor,
) -> Tensor:
    """Sum the values of the leaves that each row reaches, over all trees.

    A row starts at node 0 of a tree. At an inner node it goes to the left child if its feature is at most the threshold
    (compared in float64, as in scikit-learn's HistGradientBoosting), otherwise to the right child. If the feature is
    NaN, ``missing_left`` decides.

    Args:
        values: ``[B, F]`` float32, the features of each row; NaN = missing.
        feature: ``[T, M]`` int32, the feature that an inner node tests, in [0, F); any number >= 0 at a leaf. T trees
            are padded to M >= 1 nodes.
        threshold: ``[T, M]`` float64, finite.
        missing_left: ``[T, M]`` bool, whether rows without the feature go left.
        left, right: ``[T, M]`` int32, numbers of the children in the tree, above the node's own number; both -1 at a
            leaf.
        leaf_value: ``[T, M]`` float64, finite; only those of leaves count.

    Returns:
        ``[B]`` float64. The trees are added in their order; the rows are spread over torch's threads, and the result
        does not depend on the number of threads. No gradient flows through it.

    Raises:
        TypeError: an argument of the wrong type or dtype.
        ValueError: a wrong shape or device, a feature outside [0, F), a child that is not after its parent or is
            outside the tree, a threshold or leaf value that is not finite.

    Example:
        >>> import torch
        >>> nan = float("nan")
        >>> boosted_trees(  # one tree: -1 if the feature is at most 0.5 or missing, else 2
        ...     torch.tensor([[0.5], [0.6], [nan]]),
        ...     feature=torch.tensor([[0, 0, 0]], dtype=torch.int32),
        ...     threshold=torch.tensor([[0.5, 0, 0]], dtype=torch.float64),
        ...     missing_left=torch.tensor([[True, False, False]]),
        ...     left=torch.tensor([[1, -1, -1]], dtype=torch.int32),
        ...     right=torch.tensor([[2, -1, -1]], dtype=torch.int32),
        ...     leaf_value=torch.tensor([[0, -1, 2]], dtype=torch.float64),
        ... )
        tensor([-1.,  2., -1.], dtype=torch.float64)
    """
    check_array("values", values, torch.float32, (None, None), "[B, F]")
    check_array("feature", feature, torch.int32, (None, None), "[T, M]")
    shape = (feature.shape[0], feature.shape[1])
    for name, array, dtype in (
        ("threshold", threshold, torch.float64),
        ("missing_left", missing_left, torch.bool),
        ("left", left, torch.int32),
        ("right", right, torch.int32),
        ("leaf_value", leaf_value, torch.float64),
    ):
        check_array(name, array, dtype, shape, f"[T, M] = [{shape[0]}, {shape[1]}]")
    return cast(
        Tensor,
        call(
            torch.ops.torchjoint.boosted_trees.default,
            values,
            feature,
            threshold,
            missing_left,
            left,
            right,
            leaf_value,
        ),
    )


@torch.library.register_fake("torchjoint::boosted_trees")
def _fake(values: Tensor, *_: object) -> Tensor:
    return values.new_empty(values.shape[0], dtype=torch.float64)
