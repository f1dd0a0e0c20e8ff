"""Shows a run in the viewer before it is finished: updates the labels so far, in a limited share of the time."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchjoint.joint import JointSegmenter
from torchjoint.labels.image_labels import label_image
from torchjoint.labels.label import label_points
from torchjoint.live import LiveResult
from torchjoint.masks.folder import frame_names
from torchjoint.results.folder import load_result
from torchjoint.results.render import Shading
from torchjoint.results.result import Result
from torchjoint.results.upright import up_direction
from torchjoint.runtime.groups import with_none
from torchjoint.runtime.threads import LazySequence, one_thread_per_operation
from torchjoint.scene import Frame, Scene, Segmentation
from torchjoint.viewer.app import Viewer
from torchjoint.viewer.server import import_viser, viewpoint
from torchjoint.viewer.shown import LiveRun, Shown

#: The drawn camera, as a share of the distance from which the cloud is first seen.
CAMERA = 0.04


def _opened(on_open: Callable[[str], object], *arguments: Any, **options: Any) -> Viewer:
    """A new page, whose address is told."""
    viewer = Viewer(*arguments, **options)
    on_open(viewer.url)
    return viewer


class GrowingView:
    """A page that opens with the first result of a :class:`~torchjoint.LiveSegmenter`.

    Args:
        on_open: called with the page's address when the page is ready.
        host, port: see :class:`~torchjoint.viewer.app.Viewer`.
    """

    def __init__(self, on_open: Callable[[str], object] = print, *, host: str = "127.0.0.1", port: int = 8080) -> None:
        import_viser()
        self.viewer: Viewer | None = None
        self._open = partial(_opened, on_open, host=host, port=port)

    def show(self, live: LiveResult, frames: Sequence[Frame], note: str = "") -> None:
        """Shows another result.

        Args:
            live: the result.
            frames: that have come so far; their poses tell what is up.
            note: a line at the top of the panel.
        """
        scene = Scene(live.cloud.points, colors=live.cloud.colors)
        result = Result.of(Segmentation(live.labels, ()), scene)
        if self.viewer is None:
            up = up_direction(Scene(scene.points, frames))
            self.viewer = self._open(result, Shown(is_running=True), up=up)
        else:
            self.viewer.grow(result, Shading(scene.points, self.viewer.model.up))
        self.viewer.tell(note)

    def camera(self, frame: Frame) -> None:
        """Draws the camera where it is now."""
        if self.viewer is not None:
            self.viewer.draw_camera(viewpoint(frame), CAMERA)


#: Largest share of a run's time for the labels so far, after the page has opened and shown the first frames.
SHARE = 0.1


class LiveView:
    """Shows a run in the browser, from before its first frame: call it after each of the segmenter's steps.

    It does not change the segmenter, so the result and the checkpoint are the same as without it.

    Args:
        on_open: called with the page's address when the page is ready.
        share: largest share of the run's time for the view.
        host, port: see :class:`~torchjoint.viewer.app.Viewer`.
    """

    def __init__(
        self,
        on_open: Callable[[str], object] = print,
        *,
        share: float = SHARE,
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        import_viser()  # so that an error comes at once, not after an hour of fusing a cloud
        self.viewer: Viewer | None = None
        self._share, self._open = share, partial(_opened, on_open, host=host, port=port)
        self._next, self._labelled = 0.0, 0
        self._names: tuple[str, ...] = ()

    def __call__(self, segmenter: JointSegmenter, scene: Scene) -> None:
        """Shows the labels so far, if it is time."""
        start = time.monotonic()
        if start >= self._next:
            is_first = self.viewer is None
            self._show(segmenter, scene)
            if not is_first:  # the first call opens the page before the first frame
                end = time.monotonic()
                self._next = end + (end - start) * (1 / self._share - 1)
        if self.viewer is not None:
            seen, count = len(segmenter.state.observations), len(scene.frames)
            self.viewer.tell(f"running: {seen} of {count} frames; labels of {self._labelled}")

    def finish(self, folder: Path, run: LiveRun) -> Viewer:
        """Shows the result that was written to a folder, with all controls."""
        result = load_result(folder, edits=False)
        shown = Shown(folder, run)
        if self.viewer is None:
            self.viewer = self._open(result, shown)
        else:
            self.viewer.open(result, shown)
        return self.viewer

    def _show(self, segmenter: JointSegmenter, scene: Scene) -> None:
        before = None if self.viewer is None else self.viewer.result.points
        self._names = self._names or tuple(frame_names(scene.frames))  # only once, because it may read frames
        result = Result.of(labels_so_far(segmenter, scene, before, self._names), scene, segmenter.config)
        self._labelled = len(segmenter.state.observations)
        if self.viewer is None:
            self.viewer = self._open(result, Shown(is_running=True))
        else:
            self.viewer.replace(result)


def labels_so_far(
    segmenter: JointSegmenter, scene: Scene, before: Tensor | None = None, names: tuple[str, ...] = ()
) -> Segmentation:
    """Computes the result that a segmenter would give without further frames; images are labelled on access.

    Args:
        segmenter: has seen the first frames of the scene, or none; is not changed.
        scene: the whole scene; label images of the other frames are -1.
        before: [N] the points' labels of the previous call; segments keep their numbers where possible.
        names: of all frames.

    Returns:
        a result with one level. Pixels of image segments without points are -1. Labels may have gaps.
    """
    with torch.no_grad(), one_thread_per_operation():
        tree = segmenter.method.segment(segmenter.graph, segmenter.state, segmenter.config)
        labels = label_points(tree, segmenter.graph)
        number = torch.arange(int(labels.given.max()) + 1)
        if before is not None:
            number = kept_numbers(labels.given[labels.given >= 0], before)
    of_own = number[labels.number]
    seen, sizes = segmenter.state.observations[:], torch.bincount(labels.of_graph)  # a copy: frames may be added

    @lru_cache(maxsize=4)
    def image(index: int) -> Tensor:
        if index >= len(seen):
            return torch.full(scene.frames[index].size, -1)
        with torch.no_grad(), one_thread_per_operation():
            own = label_image(seen[index], labels.of_graph, sizes, segmenter.config)[0].long()
        return torch.where((own >= 0) & (own < len(of_own)), of_own[own.clamp(0, len(of_own) - 1)], -1)

    return Segmentation(with_none(number)[labels.given], LazySequence(len(scene.frames), image), names=names)


def kept_numbers(labels: Tensor, before: Tensor) -> Tensor:
    """Numbers segments so that they keep the numbers of the earlier segments that they match.

    Pairs of a segment and an earlier segment are sorted by the number of common points, largest first (ties: the lower
    segment, then the lower earlier segment). If neither is in a pair yet, the segment gets the number of the earlier
    segment. The remaining segments get the lowest free numbers, in their order.

    Args:
        labels: [N] int64, 0 ... S - 1.
        before: [N] int64, >= 0, of the same points.

    Returns:
        [S] int64, all different.

    Example:
        >>> kept_numbers(torch.tensor([0, 0, 1, 1, 2]), torch.tensor([5, 5, 5, 3, 3]))
        tensor([5, 3, 0])
    """
    count = int(before.max()) + 1
    pairs, shared = torch.unique(labels * count + before, return_counts=True)  # pairs ascend
    number, taken = [-1] * (int(labels.max()) + 1), set[int]()
    for pair in pairs[torch.argsort(shared, descending=True, stable=True)].tolist():
        segment, earlier = divmod(pair, count)
        if number[segment] < 0 and earlier not in taken:
            number[segment] = earlier
            taken.add(earlier)
    free = (candidate for candidate in itertools.count() if candidate not in taken)
    return torch.tensor([one if one >= 0 else next(free) for one in number])
