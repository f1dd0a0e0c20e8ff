"""Steps 7 and 8: labels of the given points and of the pixels, in one id space; and the superpoint in each pixel.

Until here everything is in the numbers of the graph. So it does not depend on the order of the given points, also not
where the lowest of equally good labels of a pixel counts. Here, once, the numbers become those of the given points.
The superpoint in each pixel gives the labels of every level.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchjoint import ops
from torchjoint.cloud.graph import PointGraph
from torchjoint.config import Config
from torchjoint.labels.geodesic import SuperpointNumbers, path_costs, superpoint_markers
from torchjoint.labels.image_labels import label_images
from torchjoint.labels.joint_ids import look_up
from torchjoint.runtime.groups import first_places, numbers_by_first_place, with_none
from torchjoint.runtime.messages import Stopwatch
from torchjoint.runtime.store import Packed, pack
from torchjoint.runtime.threads import LazySequence, one_thread_per_operation
from torchjoint.scene import Hierarchy, Segmentation
from torchjoint.scene.segmentation import level_images
from torchjoint.views.evidence import Evidence
from torchjoint.views.observations import Observation, Observations


class PointLabels(NamedTuple):
    """The segments of the points."""

    given: Tensor  #: [G] int64, labels of the given points, numbered by first appearance; -1 = none
    of_graph: Tensor  #: [N] int64, the same segments of the graph's points, with numbers of their own
    number: Tensor  #: [S] int64, the number in `given` of each segment in `of_graph`


def label_points(tree: Tensor | Hierarchy, graph: PointGraph) -> PointLabels:
    """The labels at the default level of what step 6 found."""
    of_graph = tree if isinstance(tree, Tensor) else tree.at()
    given = with_none(of_graph)[graph.of_given]
    number = numbers_by_first_place(given[given >= 0], int(of_graph.max()) + 1)
    return PointLabels(with_none(number)[given], of_graph, number)


def label(
    tree: Tensor | Hierarchy,
    graph: PointGraph,
    evidence: Evidence,
    config: Config,
    stopwatch: Stopwatch,
    *,
    images: bool = True,
    progress: bool = False,
) -> Segmentation:
    """The labels of the given points and of the frames' pixels.

    Args:
        tree: the result of step 6, labels [N] int64 of the graph's points, or all levels.
        graph: the points.
        evidence: of all frames.
        config: all parameters.
        stopwatch: records the seconds of each image.
        images: False: only the points.
        progress: show a progress bar.
    """
    points = label_points(tree, graph)
    levels = None if isinstance(tree, Tensor) else tree
    hierarchy, superpoint_number = (None, None) if levels is None else levels.transferred(graph.of_given)
    if not images:
        return Segmentation(points.given, (), seconds=dict(stopwatch.seconds), hierarchy=hierarchy)
    seen, count = evidence.observations[:], len(points.number)  # results keep them; more frames may follow
    labels, known = label_images(seen, points.of_graph, graph, config, stopwatch, levels, progress=progress)
    superpoints: Sequence[Tensor] = ()
    if levels is not None and superpoint_number is not None:
        superpoints = superpoint_images(labels, seen, levels, config, known)
        superpoints = level_images(superpoints, len(superpoint_number), superpoint_number, len(superpoint_number))
    return Segmentation(
        points=points.given,
        images=level_images(labels, count, points.number, count),
        initial_images=LazySequence(len(seen), lambda index: seen[index].initial_labels().long()),
        names=tuple(seen.names),
        seconds=dict(stopwatch.seconds),
        hierarchy=hierarchy,
        superpoint_images=superpoints,
    )


def superpoint_images(
    images: Sequence[Tensor],
    observations: Observations,
    hierarchy: Hierarchy,
    config: Config,
    known: Mapping[int, Packed],
) -> LazySequence[Tensor]:
    """The superpoints of a hierarchy in images: [H, W] int64 per frame, computed when first used, then kept packed.

    Args:
        images: final labels [H, W] int64 per frame, of the default level.
        observations: the frames; no more may be added.
        hierarchy: all levels of the graph's points.
        config: the refinement, and the smoothing of the image graph.
        known: superpoints of images that are known already, by index.
    """
    kept = dict(known)
    numbers = SuperpointNumbers.of(hierarchy.superpoint, hierarchy.segments_of_superpoints(hierarchy.default))

    def read(index: int) -> Tensor:
        if index not in kept:
            with torch.no_grad(), one_thread_per_operation():
                kept[index] = pack(superpoint_image(observations[index], images[index], numbers, config))
        return kept[index].unpack()

    return LazySequence(len(images), read)


def superpoint_image(seen: Observation, labels: Tensor, numbers: SuperpointNumbers, config: Config) -> Tensor:
    """The superpoint in each pixel of a frame with masks. It is always a superpoint of the pixel's segment.

    Frames without masks get their superpoints with their labels
    (:func:`~torchjoint.labels.geodesic.propagate_superpoints`).

    It is the superpoint of the point with the cheapest path to the pixel, as in geodesic label propagation. So
    superpoints also meet at edges of the image. If this point is not in the segment of the pixel's final label, the
    nearest visible point of that segment counts.

    Args:
        seen: the frame.
        labels: [H, W] int64, final labels; -1 = none, labels from S on have no points.
        numbers: the superpoints, and the 3D segment 0 ... S - 1 of each.
        config: the refinement, and the smoothing of the image graph.

    Returns:
        [H, W] int64, -1 for pixels without a 3D segment.
    """
    costs = path_costs(seen, config)
    found = ops.propagate_labels(superpoint_markers(seen, numbers, costs), *costs)
    has_segment = (labels >= 0) & (labels <= numbers.segment[-1])
    row, column = torch.nonzero(has_segment & (look_up(numbers.segment, found, -1) != labels), as_tuple=True)
    found[row, column] = _nearest_of_segment(seen, numbers, row, column, labels[row, column])
    return torch.where(has_segment, look_up(numbers.superpoint, found, -1), -1)


def _nearest_of_segment(
    seen: Observation, numbers: SuperpointNumbers, row: Tensor, column: Tensor, segment: Tensor
) -> Tensor:
    """The number of the superpoint of the nearest visible point of a given segment, [K] int32, for K pixels.

    A segment without a visible point gets its first superpoint.
    """
    first = first_places(numbers.segment.long()).to(torch.int32)[segment]
    there = numbers.of_point[seen.visible.point]
    if not len(row) or not len(there):
        return first
    from scipy.spatial import cKDTree

    # The segment is a third coordinate, with steps larger than any distance in the image. So the nearest point is in
    # the same segment, if that has one.
    layer = 2 * sum(seen.size)
    points = torch.stack([seen.visible.row, seen.visible.column, numbers.segment[there].long() * layer], dim=1)
    pixels = torch.stack([row, column, segment * layer], dim=1)
    distance, nearest = cKDTree(points.double().numpy()).query(pixels.double().numpy())
    return torch.where(torch.from_numpy(distance) < layer, there[torch.from_numpy(nearest)].to(torch.int32), first)
