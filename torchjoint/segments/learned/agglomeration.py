"""Step 6, method learned: merges regions in rounds where a model says that they belong to one object.

In each step the model judges all boundaries again, because larger regions tell more about objects. The first steps
merge only regions that almost certainly belong together. All merges form a tree; the segmentation is one of its levels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.runtime.groups import first_places
from torchjoint.scene import Hierarchy
from torchjoint.segments.learned.boundary_features import boundary_features
from torchjoint.segments.learned.boundary_model import BoundaryModel
from torchjoint.segments.learned.masks import MaskLinkage
from torchjoint.segments.learned.occluded_surfaces import continued_surfaces
from torchjoint.segments.learned.small_regions import merges_by_contact
from torchjoint.segments.learned.superpoint_graph import SuperpointGraph

#: Height of the default level of a cloud alone, and with images, if the model has no higher threshold. Probabilities
#: are too sure of borders on kinds of data that no training saw: at .5, where regions merge that more likely than not
#: are one object, objects fall apart.
ALONE, WITH_IMAGES = 0.7, 0.6
#: Thresholds of the rounds after that. At 1 all regions that touch have merged. There are several rounds, because the
#: model judges larger regions again. They cost little, because few regions are left.
COARSER = (0.8, 0.9, 1.0)
#: The heights of a round's merges are larger than the previous threshold by at least this number.
HEIGHT_STEP = 2.0**-20


#: Says how probable it is that two regions belong to different objects, [B] float64: of the number of the round, the
#: features of the boundaries [B, F], and a superpoint of one of the two regions of each boundary, [B] int64.
Judge = Callable[[int, Tensor, Tensor], Tensor]
#: The number of a round of the model, and the threshold up to which regions merge.
Step = tuple[int, float]
#: Merges regions; arguments and result as those of :meth:`~torchjoint.segments.learned.masks.MaskLinkage.merges`.
Link = Callable[[Tensor, Tensor, Tensor, Tensor, float], tuple[Tensor, Tensor]]


def merging_steps(thresholds: Sequence[float]) -> list[Step]:
    """The steps (round of the model, threshold) of the merging.

    Each round first merges up to half of the way to its threshold. Regions grow while they merge, and their
    probabilities then are out of date; smaller steps reduce this error. The last step is done twice.

    >>> merging_steps((0.2, 0.4))
    [(0, 0.1), (0, 0.2), (1, 0.3), (1, 0.4), (1, 0.4)]
    """
    steps, before = [], 0.0
    for index, threshold in enumerate(thresholds):
        steps += [(index, round((before + threshold) / 2, 6)), (index, threshold)]
        before = threshold
    return [*steps, steps[-1]]


@dataclass(frozen=True)
class Regions:
    """The regions of a step of the merging.

    Attributes:
        graph: the regions as superpoints.
        of_superpoint: [P] int64, region of each superpoint, 0 ... R - 1, numbered by their first superpoints.
    """

    graph: SuperpointGraph
    of_superpoint: Tensor

    def merged(self, pairs: Tensor) -> Regions:
        """The regions after merging pairs [2, M]."""
        group = ops.connected_components(pairs, len(self.graph))
        return Regions(self.graph.grouped(group), group[self.of_superpoint]) if pairs.shape[1] else self


def calibrated_linkage(superpoints: SuperpointGraph, model: BoundaryModel) -> MaskLinkage | None:
    """The linkage of the masks after a first merging, which shows how far they contradict each other."""
    linkage = MaskLinkage.of(superpoints.masks, superpoints.statistics.size)
    if linkage is None:
        return None
    regions, merges = Regions(superpoints, torch.arange(len(superpoints))), Merges(len(superpoints))
    first = _merge_in_steps(regions, judge_of(model), merging_steps(model.thresholds), linkage.merges, merges)
    return linkage.calibrated(first.of_superpoint)


def judge_of(model: BoundaryModel) -> Judge:
    """The judge that asks a model alone."""
    return lambda number, values, _: model.probability(number, values)


def merge_superpoints(
    superpoints: SuperpointGraph, steps: Sequence[Step], judge: Judge, linkage: MaskLinkage | None = None
) -> Hierarchy:
    """Merges superpoints in steps, and then further, until all regions that touch have merged.

    The default level of the hierarchy is the state after the last step, and what is between its threshold and the
    default's. A cut at the threshold of a step gives the state after this step.

    Args:
        superpoints: the superpoints and what is known about their boundaries.
        steps: those of :func:`merging_steps`.
        judge: gives the probability that two regions belong to different objects.
        linkage: of their masks; None without masks.
    """
    merges, regions = Merges(len(superpoints)), Regions(superpoints, torch.arange(len(superpoints)))
    last, highest = steps[-1]
    default, *coarser = last_levels([highest], superpoints)
    above = [(last, threshold) for threshold in coarser]
    between = [(last, default)] if default > highest else []
    if linkage is None:
        regions = _merge_in_steps(regions, judge, steps, merges_by_probability, merges)
        if regions.graph.occlusions is not None:
            graph = regions.graph
            pairs, against = continued_surfaces(regions.graph.occlusions, graph.statistics, graph.pairs)
            joined, height = ops.region_dendrogram(pairs, against, len(graph), highest)
            # At the height of the threshold, so all finer levels keep the regions apart.
            merges.add(regions.of_superpoint, joined, torch.full_like(height, highest), highest)
            regions = regions.merged(joined)
        _merge_in_steps(regions, judge, [*between, *above], merges_by_probability, merges)
        return merges.hierarchy(superpoints.superpoint, default)
    regions = _merge_in_steps(regions, judge, steps, linkage.merges, merges)
    regions = _merge_step(regions, judge, steps[-1], linkage.merges_far, merges)
    regions = _merge_in_steps(regions, judge, [steps[-1]], linkage.merges_of_small, merges)
    regions = _merge_in_steps(regions, judge, between, replace(linkage, keeps_outlines=True).merges, merges)
    graph = regions.graph
    size, stays = graph.statistics.size, linkage.stays_small(regions.of_superpoint)
    joined = merges_by_contact(graph.pairs, graph.boundaries.num_edges, size, stays)
    merges.add(regions.of_superpoint, joined, torch.full((joined.shape[1],), default, dtype=torch.float64), default)
    _merge_in_steps(regions.merged(joined), judge, above, linkage.merges, merges)
    return merges.hierarchy(superpoints.superpoint, default)


def last_levels(thresholds: Sequence[float], superpoints: SuperpointGraph) -> list[float]:
    """Height of the default level of a model with these thresholds, and of the coarser ones."""
    default = max(*thresholds, ALONE if superpoints.images is None else WITH_IMAGES)
    return [default, *(threshold for threshold in COARSER if threshold > default)]


def merges_by_probability(
    of_superpoint: Tensor, ends: Tensor, cost: Tensor, count: Tensor, threshold: float
) -> tuple[Tensor, Tensor]:
    """As :meth:`~torchjoint.segments.learned.masks.MaskLinkage.merges`, without masks."""
    return ops.region_dendrogram(ends, cost, int(of_superpoint.max()) + 1, threshold, count)


def _merge_in_steps(regions: Regions, judge: Judge, steps: Sequence[Step], link: Link, merges: Merges) -> Regions:
    """Merges regions in steps, adds the merges to `merges`, and returns the new regions."""
    for step in steps:
        if regions.graph.pairs.shape[1] == 0:
            break
        regions = _merge_step(regions, judge, step, link, merges)
    return regions


def _merge_step(regions: Regions, judge: Judge, step: Step, link: Link, merges: Merges) -> Regions:
    (number, threshold), graph, of_superpoint = step, regions.graph, regions.of_superpoint
    cost = judge(number, boundary_features(graph), first_places(of_superpoint)[graph.pairs[0]]).float()
    joined, height = link(of_superpoint, graph.pairs, cost, graph.boundaries.num_edges, threshold)
    merges.add(of_superpoint, joined, height, threshold)
    return regions.merged(joined)


class Merges:
    """The merges of all rounds. A merge is never lower than the merges inside it."""

    def __init__(self, num_superpoints: int) -> None:
        self._pairs: list[Tensor] = []
        self._heights: list[float] = []
        self._top = [0.0] * num_superpoints  # at the lowest superpoint of each region: the height of its last merge
        self._below = self._ceiling = 0.0  # heights of this round: above `below`, at most `ceiling`

    def add(self, of_superpoint: Tensor, joined: Tensor, mean: Tensor, threshold: float) -> None:
        """Adds a round's merges.

        A later round may find a boundary weaker than an earlier round did. Still, its heights are above all earlier
        thresholds, so that a cut at a threshold undoes whole rounds.

        Args:
            of_superpoint: [P] int64, region of each superpoint before the round; regions are numbered by their first
                superpoints.
            joined: [2, M] int64, the lowest region of each of the two groups that merge, in the order of the merges.
            mean: [M] float64, mean probability of their boundary.
            threshold: threshold of this round.
        """
        if threshold > self._ceiling:
            self._below, self._ceiling = self._ceiling, threshold
        superpoints = first_places(of_superpoint)[joined]
        self._pairs.append(superpoints.t())
        heights = mean.clamp(min=self._below + HEIGHT_STEP).clamp(max=self._ceiling)
        for a, b, height in zip(*superpoints.tolist(), heights.tolist(), strict=True):
            self._top[a] = max(height, self._top[a], self._top[b])
            self._heights.append(self._top[a])

    def hierarchy(self, superpoint: Tensor, default: float) -> Hierarchy:
        """The hierarchy of all merges; `superpoint` [N] int64 is the superpoint of each point."""
        merges = torch.cat([torch.empty(0, 2, dtype=torch.int64), *self._pairs])
        return Hierarchy(superpoint, merges, torch.tensor(self._heights, dtype=torch.float64), default)
