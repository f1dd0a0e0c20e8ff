"""Step 6, method learned: regions merge in rounds, where a model says that they belong to one object.

In each round the model judges all boundaries anew, because larger regions say more about objects. The first rounds
merge only what is almost certain.
"""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.points.boundary_features import boundary_features
from torchjoint.points.boundary_model import BoundaryModel
from torchjoint.points.evidence import Evidence


def merge_by_probability(
    evidence: Evidence, region: Tensor, pairs: Tensor, probability: Tensor, threshold: float
) -> Tensor:
    """Repeatedly merges the two regions whose boundary has the lowest mean probability, up to the threshold.

    The mean is over the edges of the point graph that cross the boundary.

    Args:
        evidence: the edges between pieces.
        region: [N] int64, 0 ... R - 1, region of each point; each region is a union of pieces.
        pairs: [2, B] int64, the pairs of regions a < b that edges connect, in ascending order.
        probability: [B] that the two regions of a pair belong to different objects.
        threshold: largest mean probability of two regions that merge.

    Returns:
        [N] int64 regions 0, 1, ..., numbered by their first old regions.
    """
    size = torch.bincount(region)
    first, second = evidence.regions_of_pieces(region)[evidence.pairs]
    low, high = torch.minimum(first, second), torch.maximum(first, second)
    ends = torch.stack([low, high])[:, evidence.edges.pair]
    across = ends[0] != ends[1]
    place = torch.searchsorted(pairs[0] * len(size) + pairs[1], low * len(size) + high)
    cost = probability.float()[place[evidence.edges.pair[across]]]
    return ops.merge_regions(ends[:, across], cost, size, threshold)[region]


def segment_learned(evidence: Evidence, model: BoundaryModel) -> Tensor:
    """Merges pieces to segments in as many rounds as the model has; the last round runs twice.

    Args:
        evidence: the pieces, and what is known about their boundaries.
        model: gives the probability that two regions belong to different objects.

    Returns:
        [N] int64 labels 0, 1, ..., numbered by first appearance.
    """
    region = evidence.piece
    rounds = range(len(model.thresholds))
    for index in (*rounds, *rounds[-1:]):
        pairs, values = boundary_features(evidence, region)
        if pairs.shape[1] == 0:
            break
        probability = model.probability(index, values)
        region = merge_by_probability(evidence, region, pairs, probability, model.thresholds[index])
    return region
