"""Step 6, method learned: the consensus of several trees of merges.

Merging is greedy: one boundary that is judged a hair higher changes all that merges later, so that points moved by a
tenth of a millimetre may give other objects. The members of an ensemble, each of which merges by itself, rarely make
the same accidental merge. Two superpoints are kept together where most of their trees have them together. The members
also see jittered copies of the cloud (:func:`jittered`), because superpoints grow greedily, too.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import chain

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.normals import dot, estimate_normals
from torchjoint.cloud.scales import Scales
from torchjoint.ops.internal import WEIGHT_UNIT, mask_merges
from torchjoint.runtime.groups import counted_pairs, most_frequent, numbers_by_first_place
from torchjoint.runtime.messages import advance
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Hierarchy
from torchjoint.scene.hierarchy import Votes
from torchjoint.segments.learned.agglomeration import (
    Merges,
    calibrated_linkage,
    last_levels,
    merge_superpoints,
    merges_by_probability,
    merging_steps,
)
from torchjoint.segments.learned.boundaries import MANY_BOUNDARIES
from torchjoint.segments.learned.boundary_features import boundary_features
from torchjoint.segments.learned.boundary_model import BoundaryModel
from torchjoint.segments.learned.masks import MaskLinkage
from torchjoint.segments.learned.region_statistics import sum_by
from torchjoint.segments.learned.small_regions import MIN_SIZE, MIN_SIZE_IN_IMAGES, merges_by_contact
from torchjoint.segments.learned.superpoint_graph import (
    MANY_POINTS,
    SuperpointGraph,
    give_back_much,
    pairs_in_one_group,
)

#: Number of copies of the cloud; the first one is the cloud itself, the others are jittered.
COPIES = 3
#: Standard deviation of the noise of the points along each axis, in multiples of their spacing.
DEVIATION = 0.1


def jittered(graph: PointGraph, scales: Scales, number: int) -> PointGraph:
    """The graph with its points moved a little, and with the normals of the moved points.

    Edges and neighbours stay, and each normal keeps its side, so all evidence of images is valid for it. Given normals
    stay, too.

    Args:
        graph: the cloud itself.
        scales: its noise and spacing.
        number: of the copy, 1, 2, ...; equal numbers give equal copies.
    """
    random = torch.Generator().manual_seed(number)
    # uniform, as the members' noise
    noise = 2 * torch.rand(graph.points.shape, generator=random, dtype=graph.points.dtype) - 1
    points = graph.points + DEVIATION * 3**0.5 * scales.spacing[:, None] * noise
    normals = graph.normals
    if not graph.has_given_normals:
        fitted = estimate_normals(points, graph.neighbors[:, : scales.normal_neighbors].contiguous())
        normals = torch.where(dot(fitted, normals)[:, None] < 0, -fitted, fitted)
    return replace(graph, points=points, normals=normals, wide_normals=estimate_normals(points, graph.neighbors))


#: Standard deviation of the noise of a perturbed member, in log odds. Chosen among 0, .4, .7 and 1 on six real sets.
NOISE = 0.7
#: Two regions merge if at most this share of the trees has them apart.
MAJORITY = 0.5


class Ensemble:
    """T members, of three kinds: a trained one of the model; one with noise; and the mean of all others.

    Args:
        model: M trained members, of which 3 M are made.
        share: the T of them that this ensemble has; the seed of their noise is its start.
    """

    def __init__(self, model: BoundaryModel, share: slice = slice(0, None)) -> None:
        self._trained = model.members
        count = len(self._trained)
        member = torch.eye(count, dtype=torch.float64)
        others = (1 - member) / (count - 1) if count > 1 else member
        self.weights = torch.cat([member, member, others])[share]  # [T, M]
        self.is_perturbed = (torch.arange(3 * count) // count == 1)[share]  # [T] bool
        self._random = torch.Generator().manual_seed(share.start)

    def probabilities(self, member_of_superpoint: Tensor, number: int, values: Tensor, superpoint: Tensor) -> Tensor:
        """The probability that two regions belong to different objects, [B] float64.

        Args:
            member_of_superpoint: [P] int64, who is asked.
            number: of the round.
            values: [B, F] float32, features of the boundaries.
            superpoint: [B] int64, a superpoint on one side of each.
        """
        member = member_of_superpoint[superpoint]
        probability = torch.zeros(len(values), dtype=torch.float64)
        for trained, weight in zip(self._trained, self.weights.T[:, member], strict=True):
            rows = torch.nonzero(weight).squeeze(1)
            probability[rows] += weight[rows] * trained.probability(number, values[rows])
        return self._perturbed(probability, self.is_perturbed[member])

    def first_probabilities(self, values: Tensor) -> Tensor:
        """The probabilities [T, B] of all members in the first round, of boundaries [B, F] that all see."""
        found = parallel_map(lambda trained: trained.probability(0, values), self._trained)
        probability = torch.zeros(len(self.weights), len(values), dtype=torch.float64)
        for of_trained, weight in zip(found, self.weights.T, strict=True):  # the bits of `@` differ between machines
            probability += weight[:, None] * of_trained
        return self._perturbed(probability, self.is_perturbed[:, None].expand_as(probability))

    def _perturbed(self, probability: Tensor, is_perturbed: Tensor) -> Tensor:
        # Uniform noise: the bits of normal deviates differ between processors.
        noise = 2 * torch.rand(int(is_perturbed.sum()), generator=self._random, dtype=torch.float64) - 1
        log_odds = torch.logit(probability[is_perturbed], eps=1e-6) + NOISE * 3**0.5 * noise
        return probability.masked_scatter(is_perturbed, torch.sigmoid(log_odds))


def build_consensus(copies: Sequence[SuperpointGraph], model: BoundaryModel) -> Hierarchy:
    """The consensus of the trees of the members of an :class:`Ensemble`.

    Args:
        copies: the superpoints and what is known about their boundaries, one or several times, each read once. Each
            copy has its share of the members. The first one has the superpoints of the result.
        model: its trained members.

    Returns:
        all levels. The cut at a threshold of the merging has those superpoints together that most trees have together
        at this threshold. Between two thresholds, heights ascend with the share of the trees that are against a merge.
        Its votes are the trees' segments at the default level.
    """
    superpoints, levels, segments = segments_of_members(copies, model)
    size = superpoints.statistics.size.long()
    linkage = MaskLinkage.of(superpoints.masks, size)
    merges, below, default = Merges(len(size)), 0.0, last_levels(model.thresholds, superpoints)[0]
    of_superpoint = torch.arange(len(size))
    for level, of_members in zip(levels, segments, strict=True):
        joined, against = vote(of_members, of_superpoint, size, superpoints.pairs)
        merges.add(of_superpoint, joined, below + (level - below) * against / MAJORITY, level)
        of_superpoint = ops.connected_components(joined, int(of_superpoint.max()) + 1)[of_superpoint]
        if level == max(model.thresholds):
            # what does not touch, but is together for the majority; all finer levels keep it apart
            joined, against = vote(of_members, of_superpoint, size)
            merges.add(of_superpoint, joined, torch.full_like(against, level), level)
            of_superpoint = ops.connected_components(joined, int(of_superpoint.max()) + 1)[of_superpoint]
        if level == default:
            votes = Votes(torch.stack(of_members), size)
            regions = superpoints.grouped(of_superpoint)
            stays = None if linkage is None else linkage.stays_small(of_superpoint)
            least = MIN_SIZE if superpoints.images is None or linkage is not None else MIN_SIZE_IN_IMAGES
            count = regions.boundaries.num_edges
            joined = merges_by_contact(regions.pairs, count, regions.statistics.size, stays, least)
            merges.add(of_superpoint, joined, torch.full((joined.shape[1],), level, dtype=torch.float64), level)
            of_superpoint = ops.connected_components(joined, int(of_superpoint.max()) + 1)[of_superpoint]
        below = level
    return replace(merges.hierarchy(superpoints.superpoint, default), votes=votes)


def segments_of_members(
    copies: Sequence[SuperpointGraph], model: BoundaryModel
) -> tuple[SuperpointGraph, list[float], list[list[Tensor]]]:
    """The first copy without measures; thresholds of the L levels; for each level the segments of each member's tree.

    The segments [P] are those of the first copy's superpoints: a superpoint is where most of its points are after the
    first step.
    """
    given = [copies[0]]  # whoever takes it is the only one who has its measures
    superpoints = given[0].without_measures()
    levels = sorted({one for _, one in merging_steps(model.thresholds)} | {*last_levels(model.thresholds, superpoints)})
    done = partial(advance.get(), 0.99 / (2 * len(copies)))  # each copy, and its members' first step; then they vote

    def taken(number: int) -> SuperpointGraph:
        copy = copies[number] if number else given.pop()
        done()
        return copy

    def of_copy(number: int) -> list[list[Tensor]]:
        ensemble = Ensemble(model, slice(number, None, len(copies)))
        first = _first_step(taken(number), ensemble, model, superpoints.superpoint)
        done()
        return _segments(*first, ensemble, model, levels)

    numbers = range(len(copies))
    found = parallel_map(of_copy, numbers) if len(superpoints.superpoint) <= MANY_POINTS else [*map(of_copy, numbers)]
    return superpoints, levels, [list(chain.from_iterable(of_level)) for of_level in zip(*found, strict=True)]


def _first_step(
    superpoints: SuperpointGraph, ensemble: Ensemble, model: BoundaryModel, other: Tensor
) -> tuple[SuperpointGraph, MaskLinkage | None, list[Tensor], list[Tensor]]:
    """The first step of each member.

    Args:
        superpoints: of the copy.
        ensemble: the members.
        model: the one that they are made of.
        other: [N] int64, the other superpoint of each point.

    Returns:
        the graph of the C cells, which are the superpoints that all members have together; what masks say of them; the
        regions [C] of each member; and the region of each other superpoint, for each member.
    """
    linkage, (_, threshold) = calibrated_linkage(superpoints, model), merging_steps(model.thresholds)[0]
    link = merges_by_probability if linkage is None else linkage.merges
    each, num_edges = torch.arange(len(superpoints)), superpoints.boundaries.num_edges

    def merged(probability: Tensor) -> Tensor:
        joined, _ = link(each, superpoints.pairs, probability.float(), num_edges, threshold)
        return ops.connected_components(joined, len(superpoints))

    give_back_much(len(other))
    regions = parallel_map(merged, ensemble.first_probabilities(boundary_features(superpoints)))
    give_back_much(len(other))
    cell = _together(regions)
    cells = superpoints.grouped(cell)
    of_cells = [torch.empty_like(cells.superpoint).index_put_((cell,), region) for region in regions]
    of_masks = None if linkage is None else linkage.grouped(cell)
    return cells, of_masks, of_cells, _of_other_superpoints(regions, superpoints.superpoint, other)


def _segments(
    cells: SuperpointGraph,
    linkage: MaskLinkage | None,
    of_cells: Sequence[Tensor],
    regions: Sequence[Tensor],
    ensemble: Ensemble,
    model: BoundaryModel,
    levels: Sequence[float],
) -> list[list[Tensor]]:
    """For each level the segments of each of the members, whose regions after the first step [C], [P] are known."""
    found: dict[int, list[Tensor]] = {}
    for members in _at_once(ensemble.is_perturbed, cells.boundaries.num_edges.numel()):
        sizes = [int(of_cells[member].max()) + 1 for member in members]
        asked = torch.tensor(members).repeat_interleave(torch.tensor(sizes))
        groups, steps = [of_cells[member] for member in members], merging_steps(model.thresholds)[1:]
        of_masks = None if linkage is None else linkage.grouped(*groups)
        forest = merge_superpoints(cells.grouped(*groups), steps, partial(ensemble.probabilities, asked), of_masks)
        of_levels = [forest.segments_of_superpoints(level).split(sizes) for level in levels[1:]]
        for member, of_member in zip(members, zip(*of_levels, strict=True), strict=True):
            found[member] = [regions[member], *((one - one[0])[regions[member]] for one in of_member)]
    return [list(of_level) for of_level in zip(*(found[member] for member in range(len(regions))), strict=True)]


def _at_once(is_perturbed: Tensor, num_boundaries: int) -> list[list[int]]:
    """The members whose graphs are one graph, which is faster but takes more memory. The perturbed ones share noise."""
    numbers = list(range(len(is_perturbed)))
    if num_boundaries * len(numbers) <= MANY_BOUNDARIES:
        return [numbers]
    perturbed = [number for number in numbers if is_perturbed[number]]
    return [[number] for number in numbers if number not in perturbed] + ([perturbed] if perturbed else [])


def _of_other_superpoints(regions: Sequence[Tensor], superpoint: Tensor, other: Tensor) -> list[Tensor]:
    """The region of each superpoint of an `other` division of the points: where most of its points are.

    Args:
        regions: each [P] int64, 0, 1, ...
        superpoint, other: [N] int64, the superpoint of each point, of P superpoints and of the others.
    """
    width = int(superpoint.max()) + 1
    key, count = torch.unique(other * width + superpoint, return_counts=True)
    return [most_frequent(region[key % width], key // width, count) for region in regions]


def _together(segments: Sequence[Tensor]) -> Tensor:
    """The cell of each superpoint: what all segmentations [P] have together; numbered by first appearance."""
    cell = segments[0]
    for other in segments[1:]:
        _, cell = torch.unique(cell * (int(other.max()) + 1) + other, return_inverse=True)
    return numbers_by_first_place(cell, int(cell.max()) + 1)[cell]


def vote(
    segments: Sequence[Tensor], of_superpoint: Tensor, size: Tensor, touching: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Repeatedly merges the two regions that most segmentations have together, while these are the majority.

    The share of two regions is the mean over all pairs of points, one of each region.

    Args:
        segments: K segmentations, each [P] int64, 0, 1, ...
        of_superpoint: [P] int64, region of each superpoint, 0 ... R - 1.
        size: [P] int64, points of each superpoint.
        touching: [2, Q] int64, pairs of superpoints; regions merge if they have such a pair. None: any regions may
            merge.

    Returns:
        [2, M] int64, for each merge the lowest regions of the two groups; [M] float64, the share that has them apart.
    """
    num_segments = torch.tensor([int(one.max()) + 1 for one in segments])
    first = num_segments.cumsum(0) - num_segments
    apart = (one + start for one, start in zip(segments, first, strict=True))
    in_segment = torch.cat([counted_pairs(of_superpoint, one, size) for one in apart], 1)
    num_regions = int(of_superpoint.max()) + 1
    region, segment, _ = in_segment
    ends = pairs_in_one_group(region, segment, num_regions) if touching is None else of_superpoint[touching]
    size_of_region = sum_by(of_superpoint, size, num_regions)
    segmentation = torch.arange(len(segments)).repeat_interleave(num_segments)
    return average_linkage(ends, size_of_region, in_segment, segmentation, MAJORITY)


def average_linkage(
    edge_index: Tensor, size: Tensor, in_segment: Tensor, segmentation: Tensor, threshold: float
) -> tuple[Tensor, Tensor]:
    """Repeatedly merges the two adjacent regions that the fewest of some segmentations have apart; lists the merges.

    The share of segmentations that have two regions apart is the mean over all pairs of points, one of each region.

    Args:
        edge_index, size: as those of :func:`~torchjoint.ops.internal.mask_merges`.
        in_segment: [3, I] int64: region, segment, number of the region's points in it.
        segmentation: [S] int64, 0 ... K - 1, the segmentation of each segment. Each has all points.
        threshold: largest share of two regions that merge.

    Returns:
        as :func:`~torchjoint.ops.internal.mask_merges`, with the shares as costs.
    """
    # A segmentation is a frame that sees all points, and its segments are masks. The least prior changes nothing.
    frames = torch.arange(int(segmentation.max()) + 1)
    region = torch.arange(len(size))
    in_frame = torch.stack([region.repeat(len(frames)), frames.repeat_interleave(len(size)), size.repeat(len(frames))])
    prior, one = torch.zeros(edge_index.shape[1], dtype=torch.float32), torch.ones_like(edge_index[0])
    masks = (in_segment, in_frame, torch.full_like(segmentation, WEIGHT_UNIT), segmentation)
    return mask_merges(edge_index, prior, one, size, *masks, apart_weight=1.0, prior_weight=1e-9, threshold=threshold)
