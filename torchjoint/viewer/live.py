"""Shows a run in the viewer before it is finished: updates the labels so far, in a limited share of the time."""

import math
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchjoint.joint import JointSegmenter
from torchjoint.labels.image_labels import label_image, unmasked_labels
from torchjoint.labels.label import label_points
from torchjoint.live import LiveResult
from torchjoint.masks.folder import frame_names
from torchjoint.results.folder import load_result
from torchjoint.results.render import Shading
from torchjoint.results.result import Result
from torchjoint.results.upright import up_direction
from torchjoint.runtime.messages import counted
from torchjoint.runtime.threads import LazySequence, one_thread_per_operation
from torchjoint.scene import Frame, Scene, Segmentation
from torchjoint.scene.frame import to_8_bits
from torchjoint.viewer.app import Viewer
from torchjoint.viewer.server import Page, viewpoint
from torchjoint.viewer.shown import LiveRun, Shown

#: The drawn camera, as a share of the distance from which the cloud is first seen.
CAMERA = 0.04
#: Most pixels of a side of its image.
PHOTO = 640


class GrowingView:
    """Shows the results of a :class:`~torchjoint.LiveSegmenter` on a page."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.viewer: Viewer | None = None

    def show(self, live: LiveResult, seen: Scene, note: str = "") -> None:
        """Shows another result.

        Args:
            live: the result.
            seen: the recording with the frames that have come so far; it tells what is up, or their poses.
            note: a line at the top of the panel.
        """
        up = None if self.viewer else up_direction(Scene(live.cloud.points, seen.frames, up=seen.up))
        scene = Scene(live.cloud.points, colors=live.cloud.colors, name=seen.name, up=up)
        result = Result.of(Segmentation(live.labels, ()), scene)
        if self.viewer is None:
            self.viewer = Viewer(result, Shown(is_running=True, has_camera=True), page=self.page)
        else:
            self.viewer.grow(result, Shading(scene.points, self.viewer.model.up))
        self.viewer.tell(note)

    def finish(self, folder: Path, live: LiveResult) -> None:
        """Shows the last result, which was written to a folder, with all controls."""
        if self.viewer is not None:
            result = load_result(folder, edits=False)
            shading = Shading(result.scene.points, self.viewer.model.up)
            self.viewer.grow(result, shading, Shown(folder), live.ids.numpy())

    def camera(self, frame: Frame) -> None:
        """Draws the camera where it is now, and shows its image."""
        if self.viewer is not None:
            image = to_8_bits(frame.image).permute(1, 2, 0).numpy()
            reduced = image[:: (step := math.ceil(max(frame.size) / PHOTO)), ::step]
            self.viewer.draw_camera(viewpoint(frame), CAMERA, np.ascontiguousarray(reduced))


#: Largest share of a run's time for the labels so far, after the page has opened and shown the first frames.
SHARE_OF_TIME = 0.1


class LiveView:
    """Shows a run in the browser, from before its first frame: call it after each of the segmenter's steps.

    It does not change the segmenter, so the result and the checkpoint are the same as without it.

    Args:
        open_page: opens the page.
        share: largest share of the run's time for the view.
    """

    def __init__(self, open_page: Callable[[], Page] = Page, *, share: float = SHARE_OF_TIME) -> None:
        self._open_page, self._share = open_page, share
        self._page: Page | None = None
        self.viewer: Viewer | None = None
        self._next, self._labelled = 0.0, 0
        self._names: tuple[str, ...] = ()

    def open(self) -> None:
        """Opens the page before there is something to show."""
        self._page = self._open_page()

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
            seen = f"{len(segmenter.state.observations)} of {counted(len(scene.frames), 'frame')}"
            self.viewer.tell(f"running: {seen}; labels of {self._labelled}" if scene.frames else "running")

    def finish(self, folder: Path, run: LiveRun) -> Viewer:
        """Shows the result that was written to a folder, with all controls."""
        assert self.viewer is not None  # each run has a step before the first frame
        self.viewer.replace(load_result(folder, edits=False), Shown(folder, run))
        return self.viewer

    def _show(self, segmenter: JointSegmenter, scene: Scene) -> None:
        self._names = self._names or tuple(frame_names(scene.frames))  # only once, because it may read frames
        if self.viewer is None:  # first the cloud in one colour, because labels take seconds
            none = LazySequence(len(scene.frames), lambda index: torch.full(scene.frames[index].size, -1))
            plain = Segmentation(torch.zeros(len(scene.points), dtype=torch.int64), none, names=self._names)
            one = Result.of(plain, scene, segmenter.config)
            self.viewer = Viewer(one, Shown(is_running=True), page=self._page or self._open_page())
        self.viewer.replace(Result.of(labels_so_far(segmenter, scene, self._names), scene, segmenter.config))
        self._labelled = len(segmenter.state.observations)


def labels_so_far(segmenter: JointSegmenter, scene: Scene, names: tuple[str, ...] = ()) -> Segmentation:
    """Computes the result that a segmenter would give without further frames; images are labelled on access.

    Args:
        segmenter: has seen the first frames of the scene, or none; is not changed.
        scene: the whole scene; label images of the other frames are -1.
        names: of all frames.

    Returns:
        a result with one level. Pixels of image segments without points are -1.
    """
    graph, config = segmenter.graph, segmenter.config
    seen = segmenter.state.observations[:]  # a copy: frames may be added
    with torch.no_grad(), one_thread_per_operation():
        labels = label_points(segmenter.method.segment(graph, segmenter.state, config), graph)
        of_own, unmasked = labels.number, unmasked_labels(seen, labels.of_graph)

    @lru_cache(maxsize=4)
    def image(index: int) -> Tensor:
        if index >= len(seen):
            return torch.full(scene.frames[index].size, -1)
        with torch.no_grad(), one_thread_per_operation():
            own, _ = label_image(seen[index], labels.of_graph, graph, unmasked, config)
        return torch.where((own >= 0) & (own < len(of_own)), of_own[own.long().clamp(0, len(of_own) - 1)], -1)

    return Segmentation(labels.given, LazySequence(len(scene.frames), image), names=names)
