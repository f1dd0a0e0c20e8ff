"""Image segmentations that are computed once and reused for many settings of the later stages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchjoint.config import Config
from torchjoint.images.segmenter import ImageSegmenter, ImageSegments, brightened
from torchjoint.runtime.messages import Stopwatch
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.scene import Frame

#: Frames that are processed together.
BATCH = 8


class KnownImages(ImageSegmenter):
    """Replaces a segmenter's :class:`ImageSegmenter` for frames that are known in advance.

    Dark frames are brightened, as method learned sees them.

    Args:
        config: parameters of the image stages.
        frames: all of one size. They are recognised by their names and poses.
        bounded: source of the boundaries of these frames; must use the same detector and contours.
    """

    def __init__(self, config: Config, frames: Sequence[Frame], bounded: KnownImages | None = None) -> None:
        super().__init__(config, None if bounded is None else bounded.boundary)
        self._known: dict[tuple[str, bytes], ImageSegments] = {}
        self._bounded = bounded
        with one_thread_per_operation():
            for start in range(0, len(frames), BATCH):
                batch = [replace(one, image=brightened(one.image)) for one in frames[start : start + BATCH]]
                self._known |= {
                    _key(frame): segments
                    for frame, segments in zip(batch, super().forward(batch, Stopwatch()), strict=True)
                }

    def detect(self, frames: Sequence[Frame], stopwatch: Stopwatch) -> Tensor:
        """Returns the boundaries [B, H, W] of some of the frames, those that are known already without detecting."""
        if self._bounded is None:
            return super().detect(frames, stopwatch)
        return torch.stack([self._bounded._known[_key(frame)].boundary for frame in frames])

    def forward(self, frames: Sequence[Frame], stopwatch: Stopwatch) -> list[ImageSegments]:
        """Returns the cached boundaries and initial segments of these frames."""
        return [self._known[_key(frame)] for frame in frames]


def _key(frame: Frame) -> tuple[str, bytes]:
    return frame.name, frame.world_to_camera.numpy().tobytes()
