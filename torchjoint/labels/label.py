"""Steps 7 and 8: labels of the given points and of the pixels, in one id space.

Until here everything is in the numbers of the graph. So it does not depend on the order of the given points, also not
where the lowest of equally good labels of a pixel counts. Here, once, the numbers become those of the given points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from torch import Tensor

from torchjoint.cloud.graph import PointGraph
from torchjoint.config import Config
from torchjoint.labels.image_labels import label_images
from torchjoint.labels.piece_images import piece_images
from torchjoint.runtime.groups import numbers_by_first_place, with_none
from torchjoint.runtime.messages import Stopwatch
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Hierarchy, Segmentation
from torchjoint.scene.segmentation import level_images
from torchjoint.views.evidence import Evidence


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
    hierarchy, piece_number = (None, None) if levels is None else levels.transferred(graph.of_given)
    if not images:
        return Segmentation(points.given, (), seconds=dict(stopwatch.seconds), hierarchy=hierarchy)
    seen, count = evidence.observations[:], len(points.number)  # results keep them; more frames may follow
    labels, known = label_images(seen, points.of_graph, config, stopwatch, levels, progress=progress)
    pieces: Sequence[Tensor] = ()
    if levels is not None and piece_number is not None:
        pieces = piece_images(labels, seen, levels, config, known)
        pieces = level_images(pieces, len(piece_number), piece_number, len(piece_number))
    return Segmentation(
        points=points.given,
        images=level_images(labels, count, points.number, count),
        initial_images=LazySequence(len(seen), lambda index: seen[index].initial_labels().long()),
        names=tuple(seen.names),
        seconds=dict(stopwatch.seconds),
        hierarchy=hierarchy,
        piece_images=pieces,
    )
