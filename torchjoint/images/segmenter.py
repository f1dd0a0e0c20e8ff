"""Steps 1 and 2 together: boundaries and initial labels of a batch of frames."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torchjoint.config import Config
from torchjoint.images._eval_mode import eval_mode
from torchjoint.images.boundary import make_boundary
from torchjoint.images.contours import close_contours
from torchjoint.images.pixel_graph import segment_image
from torchjoint.runtime.stopwatch import Stopwatch
from torchjoint.runtime.threads import parallel_map
from torchjoint.scene import Frame
from torchjoint.scene.checks import as_labels


class ImageSegmenter(nn.Module):
    """Computes boundaries and initial labels of frames of one size (steps 1 and 2).

    The labels come from the frame itself if it has some, else from `segmenter` if given, else from the pixel graph.

    Args:
        config: parameters.
        boundary: any module [B, 3, H, W] RGB in [0, 1] -> [B, H, W] in [0, 1]; default: the detector of the config.
        segmenter: any module [B, 3, H, W] -> [B, H, W] integer labels, -1 = none; default: the pixel graph.
    """

    def __init__(self, config: Config, boundary: nn.Module | None = None, segmenter: nn.Module | None = None) -> None:
        super().__init__()
        self.config = config
        self.boundary = boundary or make_boundary(config.boundary)
        self.segmenter = segmenter

    def forward(self, frames: Sequence[Frame], stopwatch: Stopwatch) -> tuple[Tensor, list[Tensor]]:
        """Boundaries [B, H, W] in [0, 1], and B label images [H, W] int64, numbered 0, 1, ..., -1 = none.

        Raises:
            ValueError, TypeError: a module returns a wrong shape, dtype or value.
        """
        with stopwatch("boundaries"):
            boundaries = self._detect(torch.stack([frame.image for frame in frames]))
        with stopwatch("image segments"):
            return boundaries, self.label(frames, boundaries)

    def label(self, frames: Sequence[Frame], boundaries: Tensor) -> list[Tensor]:
        """B label images [H, W] int64, -1 = none, of frames whose boundaries [B, H, W] are known.

        Raises:
            ValueError, TypeError: the segmenter returns a wrong shape, dtype or value.
        """
        given = [frame.labels for frame in frames]
        missing = any(labels is None for labels in given)
        images = torch.stack([frame.image for frame in frames])
        segmented = self._segment(images, boundaries) if missing else [torch.empty(0)] * len(given)
        return [other if own is None else _dense(own) for own, other in zip(given, segmented, strict=True)]

    def _detect(self, images: Tensor) -> Tensor:
        with eval_mode(self.boundary):
            boundaries = self.boundary(images)
        if boundaries.shape != images[:, 0].shape:
            raise ValueError(f"boundary: expected [B, H, W] = {list(images[:, 0].shape)}, got {list(boundaries.shape)}")
        if not ((boundaries >= 0) & (boundaries <= 1)).all():
            raise ValueError("boundary: expected values in [0, 1] and no NaN")
        boundaries = boundaries.float()
        return close_contours(boundaries) if self.config.contours.closed else boundaries

    def _segment(self, images: Tensor, boundaries: Tensor) -> list[Tensor]:
        size = (images.shape[2], images.shape[3])
        if self.segmenter is None:
            return parallel_map(lambda pair: self._segment_by_graph(*pair), zip(images, boundaries, strict=True))
        with eval_mode(self.segmenter):
            output = self.segmenter(images)
        if len(output) != len(images):
            raise ValueError(f"image_segmenter's output: expected {len(images)} images, got {len(output)}")
        return [_dense(as_labels(labels, size, "image_segmenter's output")) for labels in output]

    def _segment_by_graph(self, image: Tensor, boundary: Tensor) -> Tensor:
        return segment_image(image, boundary, self.config.image_graph, self.config.image_segments)


def _dense(labels: Tensor) -> Tensor:
    """Renumbers labels to 0, 1, ... in ascending order; -1 stays."""
    values, dense = torch.unique(labels, return_inverse=True)
    return dense - int((values < 0).sum())
