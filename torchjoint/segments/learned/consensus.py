"""Step 6, method learned: the consensus of several trees of merges.

Merging is greedy: one boundary that is judged a hair higher changes all that merges later, so that points moved by a
tenth of a millimetre may give other objects. Several judges, each of which merges by itself, rarely make the same
accidental merge. Two pieces are kept together where most of their trees have them together. The judges also see
different draws of the evidence (:func:`drawn_anew`), because pieces grow greedily, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.normals import dot, estimate_normals
from torchjoint.cloud.scales import Scales
from torchjoint.ops.internal import WEIGHT_UNIT, mask_merges
from torchjoint.runtime.groups import members_of_groups, most_frequent, numbers_by_first_place
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Hierarchy
from torchjoint.scene.hierarchy import Votes
from torchjoint.segments.learned.agglomeration import Merges, build_hierarchy, last_levels, merge_pieces, merging_steps
from torchjoint.segments.learned.boundaries import MANY_BOUNDARIES
from torchjoint.segments.learned.boundary_features import boundary_features
from torchjoint.segments.learned.boundary_model import BoundaryModel
from torchjoint.segments.learned.masks import MaskLinkage
from torchjoint.segments.learned.piece_graph import MANY_POINTS, PieceGraph, counted
from torchjoint.segments.learned.region_statistics import sum_by
from torchjoint.segments.learned.small_regions import MIN_SIZE, MIN_SIZE_IN_IMAGES, merges_by_contact

#: Number of draws; the first one is the cloud itself.
DRAWS = 3
#: Standard deviation of the noise of the points along each axis, in multiples of their spacing.
DEVIATION = 0.1


def drawn_anew(graph: PointGraph, scales: Scales, number: int) -> PointGraph:
    """The graph with its points moved a little, and with the normals of the moved points.

    Edges and neighbours stay, and each normal keeps its side, so all evidence of images is valid for it. Given normals
    stay, too.

    Args:
        graph: the cloud itself.
        scales: its noise and spacing.
        number: of the draw, 1, 2, ...; equal numbers give equal draws.
    """
    random = torch.Generator().manual_seed(number)
    # uniform, as the judges' noise
    noise = 2 * torch.rand(graph.points.shape, generator=random, dtype=graph.points.dtype) - 1
    points = graph.points + DEVIATION * 3**0.5 * scales.spacing[:, None] * noise
    normals = graph.normals
    if not graph.has_given_normals:
        fitted = estimate_normals(points, graph.neighbors[:, : scales.normal_neighbors].contiguous())
        normals = torch.where(dot(fitted, normals)[:, None] < 0, -fitted, fitted)
    return replace(graph, points=points, normals=normals, wide_normals=estimate_normals(points, graph.neighbors))


#: Standard deviation of the noise of a disturbed judge, in log odds. Chosen among 0, .4, .7 and 1 on six real sets.
NOISE = 0.7
#: Two regions merge if at most this share of the trees has them apart.
MAJORITY = 0.5
#: The operator wants a prior; this much of it changes nothing.
NO_PRIOR = 1e-9


class Panel:
    """T judges, of three kinds: a member of the model; a member with noise; and the mean of all other members.

    Args:
        model: M members, of which 3 M judges are made.
        share: the T judges among them that this panel has; the seed of their noise is its start.
    """

    def __init__(self, model: BoundaryModel, share: slice = slice(0, None)) -> None:
        self._members = model.members
        count = len(self._members)
        member = torch.eye(count, dtype=torch.float64)
        others = (1 - member) / (count - 1) if count > 1 else member
        self.weights = torch.cat([member, member, others])[share]  # [T, M]
        self.is_unsure = (torch.arange(3 * count) // count == 1)[share]  # [T] bool
        self._random = torch.Generator().manual_seed(share.start)

    def probabilities(self, number: int, values: Tensor, judge: Tensor) -> Tensor:
        """The probability that two regions belong to different objects, [B] float64.

        Args:
            number: of the round.
            values: [B, F] float32, features of the boundaries.
            judge: [B] int64, who is asked.
        """
        probability = torch.zeros(len(values), dtype=torch.float64)
        for member, weight in zip(self._members, self.weights.T[:, judge], strict=True):
            rows = torch.nonzero(weight).squeeze(1)
            probability[rows] += weight[rows] * member.probability(number, values[rows])
        return self._disturbed(probability, self.is_unsure[judge])

    def first_probabilities(self, values: Tensor) -> Tensor:
        """The probabilities [T, B] of all judges in the first round, of boundaries [B, F] that all see."""
        members = parallel_map(lambda member: member.probability(0, values), self._members)
        probability = torch.zeros(len(self.weights), len(values), dtype=torch.float64)
        for of_member, weight in zip(members, self.weights.T, strict=True):  # the bits of `@` differ between machines
            probability += weight[:, None] * of_member
        return self._disturbed(probability, self.is_unsure[:, None].expand_as(probability))

    def _disturbed(self, probability: Tensor, is_unsure: Tensor) -> Tensor:
        # Uniform noise: the bits of normal deviates differ between processors.
        noise = 2 * torch.rand(int(is_unsure.sum()), generator=self._random, dtype=torch.float64) - 1
        log_odds = torch.logit(probability[is_unsure], eps=1e-6) + NOISE * 3**0.5 * noise
        return probability.masked_scatter(is_unsure, torch.sigmoid(log_odds))


def build_consensus(draws: Sequence[PieceGraph], model: BoundaryModel) -> Hierarchy:
    """The consensus of the trees of many judges: :class:`Panel`. With masks, each draw has one tree, of all members.

    Args:
        draws: the pieces and what is known about their boundaries, one or several times, each read once. Each draw has
            its share of the judges. The first one has the pieces of the result.
        model: the judges are made of its members.

    Returns:
        all levels. The cut at a threshold of the merging has those pieces together that most trees have together at
        this threshold. Between two thresholds, heights ascend with the share of the trees that are against a merge.
        Its votes are the trees' segments at the default level.
    """
    pieces, levels, segments = segments_of_judges(draws, model)
    size = pieces.statistics.size.long()
    linkage = MaskLinkage.of(pieces.masks, size)
    merges, below, default = Merges(len(size)), 0.0, last_levels(model.thresholds, pieces)[0]
    of_piece = torch.arange(len(size))
    for level, of_judges in zip(levels, segments, strict=True):
        joined, against = vote(of_judges, of_piece, size, pieces.pairs)
        merges.add(of_piece, joined, below + (level - below) * against / MAJORITY, level)
        of_piece = ops.connected_components(joined, int(of_piece.max()) + 1)[of_piece]
        if level == max(model.thresholds):
            # what does not touch, but is together for the majority; all finer levels keep it apart
            joined, against = vote(of_judges, of_piece, size)
            merges.add(of_piece, joined, torch.full_like(against, level), level)
            of_piece = ops.connected_components(joined, int(of_piece.max()) + 1)[of_piece]
        if level == default:
            votes = Votes(torch.stack(of_judges), size)
            regions, stays = pieces.grouped(of_piece), None if linkage is None else linkage.confirmed(of_piece)
            least = MIN_SIZE if pieces.images is None or linkage is not None else MIN_SIZE_IN_IMAGES
            count = regions.boundaries.num_edges
            joined = merges_by_contact(regions.pairs, count, regions.statistics.size, stays, least)
            merges.add(of_piece, joined, torch.full((joined.shape[1],), level, dtype=torch.float64), level)
            of_piece = ops.connected_components(joined, int(of_piece.max()) + 1)[of_piece]
        below = level
    return replace(merges.hierarchy(pieces.piece, default), votes=votes)


def segments_of_judges(
    draws: Sequence[PieceGraph], model: BoundaryModel
) -> tuple[PieceGraph, list[float], list[list[Tensor]]]:
    """The first draw without measures; thresholds of the L levels; for each level the segments of each judge's tree.

    The segments [P] are those of the first draw's pieces: a piece is where most of its points are after the first step.
    """
    given = [draws[0]]  # whoever takes it is the only one who has its measures
    pieces = given[0].without_measures()
    levels = _levels(model.thresholds, pieces)

    def taken(number: int) -> PieceGraph:
        return draws[number] if number else given.pop()

    def of_draw(number: int) -> list[list[Tensor]]:
        if pieces.masks is not None:
            return _segments_by_masks(taken(number), model, levels, pieces.piece)
        panel = Panel(model, slice(number, None, len(draws)))
        cells, regions, after = _first_step(taken(number), panel, levels[0], pieces.piece)
        return _segments(cells, regions, after, panel, model, levels)

    numbers = range(len(draws))
    found = parallel_map(of_draw, numbers) if len(pieces.piece) <= MANY_POINTS else [*map(of_draw, numbers)]
    return pieces, levels, [list(chain.from_iterable(of_level)) for of_level in zip(*found, strict=True)]


def _levels(thresholds: Sequence[float], pieces: PieceGraph) -> list[float]:
    return sorted({threshold for _, threshold in merging_steps(thresholds)} | {*last_levels(thresholds, pieces)})


def _segments_by_masks(
    pieces: PieceGraph, model: BoundaryModel, levels: Sequence[float], other: Tensor
) -> list[list[Tensor]]:
    """For each level the segments of the one tree of all members, of other pieces (as :func:`_first_step`)."""
    tree = build_hierarchy(pieces, model)
    found = [tree.segments_of_pieces(level) for level in levels]
    return [[of_level] for of_level in _of_other_pieces(found, pieces.piece, other)]


def _first_step(
    pieces: PieceGraph, panel: Panel, threshold: float, other: Tensor
) -> tuple[PieceGraph, list[Tensor], list[Tensor]]:
    """The first step of each judge.

    Args:
        pieces: of the draw.
        panel: the judges.
        threshold: of the step.
        other: [N] int64, the other piece of each point.

    Returns:
        the graph of the C cells, which are the pieces that all judges have together; the regions [C] of each judge; and
        the region of each other piece, for each judge.
    """
    num_edges = pieces.boundaries.num_edges

    def merged(probability: Tensor) -> Tensor:
        joined, _ = ops.region_dendrogram(pieces.pairs, probability.float(), len(pieces), threshold, num_edges)
        return ops.connected_components(joined, len(pieces))

    regions = parallel_map(merged, panel.first_probabilities(boundary_features(pieces)))
    cell = _together(regions)
    cells = pieces.grouped(cell)
    of_cells = [torch.empty_like(cells.piece).index_put_((cell,), region) for region in regions]
    return cells, of_cells, _of_other_pieces(regions, pieces.piece, other)


def _segments(
    cells: PieceGraph,
    of_cells: Sequence[Tensor],
    regions: Sequence[Tensor],
    panel: Panel,
    model: BoundaryModel,
    levels: Sequence[float],
) -> list[list[Tensor]]:
    """For each level the segments of each of the judges, whose regions after the first step [C], [P] are known."""
    found: dict[int, list[Tensor]] = {}
    for judges in _at_once(panel.is_unsure, cells.boundaries.num_edges.numel()):
        sizes = [int(of_cells[judge].max()) + 1 for judge in judges]
        asked = torch.tensor(judges).repeat_interleave(torch.tensor(sizes))
        forest = merge_pieces(
            cells.grouped(*(of_cells[judge] for judge in judges)),
            model.thresholds,
            lambda number, values, piece, asked=asked: panel.probabilities(number, values, asked[piece]),
            begun=True,
        )
        of_levels = [forest.segments_of_pieces(level).split(sizes) for level in levels[1:]]
        for judge, of_judge in zip(judges, zip(*of_levels, strict=True), strict=True):
            found[judge] = [regions[judge], *((one - one[0])[regions[judge]] for one in of_judge)]
    return [list(of_level) for of_level in zip(*(found[judge] for judge in range(len(regions))), strict=True)]


def _at_once(is_unsure: Tensor, num_boundaries: int) -> list[list[int]]:
    """The judges [T] whose graphs are one graph: that is faster, but takes more memory. The unsure ones share noise."""
    numbers = list(range(len(is_unsure)))
    if num_boundaries <= MANY_BOUNDARIES:
        return [numbers]
    unsure = [number for number in numbers if is_unsure[number]]
    return [[number] for number in numbers if number not in unsure] + ([unsure] if unsure else [])


def _of_other_pieces(regions: Sequence[Tensor], piece: Tensor, other: Tensor) -> list[Tensor]:
    """For regions of pieces, the region of each piece of an `other` division of the points: where most of them are.

    Args:
        regions: each [P] int64, 0, 1, ...
        piece, other: [N] int64, the piece of each point, of P pieces and of the others.
    """
    width = int(piece.max()) + 1
    key, count = torch.unique(other * width + piece, return_counts=True)
    return [most_frequent(region[key % width], key // width, count) for region in regions]


def _together(segments: Sequence[Tensor]) -> Tensor:
    """The cell of each piece: pieces that all segmentations [P] have together; numbered by first appearance."""
    cell = segments[0]
    for other in segments[1:]:
        _, cell = torch.unique(cell * (int(other.max()) + 1) + other, return_inverse=True)
    return numbers_by_first_place(cell, int(cell.max()) + 1)[cell]


def vote(
    segments: Sequence[Tensor], of_piece: Tensor, size: Tensor, touching: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Repeatedly merges the two regions that most segmentations have together, while these are the majority.

    The share of two regions is the mean over all pairs of points, one of each region.

    Args:
        segments: K segmentations, each [P] int64, 0, 1, ...
        of_piece: [P] int64, region of each piece, 0 ... R - 1.
        size: [P] int64, points of each piece.
        touching: [2, Q] int64, pairs of pieces; regions merge if they have such a pair. None: any regions may merge.

    Returns:
        [2, M] int64, for each merge the lowest regions of the two groups; [M] float64, the share that has them apart.
    """
    num_regions, num_segments = int(of_piece.max()) + 1, [int(one.max()) + 1 for one in segments]
    # As if each segmentation were a frame that sees all points, and its segments were masks.
    first = [sum(num_segments[:place]) for place in range(len(segments))]
    in_mask = torch.cat([counted(of_piece, one + start, size) for one, start in zip(segments, first, strict=True)], 1)
    everything = torch.zeros_like(of_piece)
    in_frame = torch.cat([counted(of_piece, everything + frame, size) for frame in range(len(segments))], 1)
    ends = of_piece[touching] if touching is not None else _in_one_segment(in_mask)
    frame_of_mask = torch.arange(len(segments)).repeat_interleave(torch.tensor(num_segments))
    return mask_merges(
        ends,
        torch.zeros(ends.shape[1], dtype=torch.float32),
        torch.ones_like(ends[0]),
        sum_by(of_piece, size, num_regions),
        in_mask,
        in_frame,
        torch.full_like(frame_of_mask, WEIGHT_UNIT),
        frame_of_mask,
        apart_weight=1.0,
        prior_weight=NO_PRIOR,
        threshold=MAJORITY,
    )


def _in_one_segment(in_mask: Tensor) -> Tensor:
    """The pairs of regions [2, B] that a segmentation has together, of rows (region, segment, points) [3, I]."""
    region, segment = in_mask[:2, torch.argsort(in_mask[1], stable=True)]
    first, second = members_of_groups(torch.bincount(segment), segment)
    one, other = region[first], region[second]
    num_regions = int(region.max()) + 1
    key = torch.unique((one * num_regions + other)[one < other])
    return torch.stack([key // num_regions, key % num_regions])
