"""Steps 1 and 2 together: boundaries and initial labels of a batch of frames."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import torch
from torch import Tensor, nn

from torchjoint.config import Config
from torchjoint.images.boundary import make_boundary
from torchjoint.images.contours import close_contours
from torchjoint.images.pixel_graph import segment_image
from torchjoint.runtime.groups import renumber_by_value
from torchjoint.runtime.messages import Stopwatch
from torchjoint.runtime.threads import one_mode_at_a_time, parallel_map
from torchjoint.scene import Frame, Masks
from torchjoint.scene.checks import as_labels


@contextmanager
def eval_mode(module: nn.Module) -> Iterator[None]:
    """Sets a module and all its parts to evaluation mode inside a block, and restores their modes afterwards.

    In training mode the output would depend on the batches of frames. The old modes are restored because the module
    belongs to the caller. One thread is in such a block at a time.
    """
    with one_mode_at_a_time:
        before = [(part, part.training) for part in module.modules()]
        module.eval()
        try:
            yield
        finally:
            for part, training in before:
                part.training = training


#: Least mean of colours. The data that the model was trained on have 0.3 to 0.55.
LEAST_MEAN = 0.3


def brightened(colors: Tensor) -> Tensor:
    """Scales colours so that their mean is at least LEAST_MEAN; what becomes brighter than 1 is 1.

    Zeros and NaNs do not count: they are mostly pixels and points without a colour.

    Args:
        colors: RGB in [0, 1], of any shape.
    """
    if float(colors.mean()) >= LEAST_MEAN:  # the usual case, for which copies would take time
        return colors
    known = torch.nan_to_num(colors)
    total, count = float(known.double().sum()), int(torch.count_nonzero(known))
    if total >= LEAST_MEAN * count:
        return colors
    return (colors * (LEAST_MEAN * count / total)).clamp(max=1)


#: Masks or dense labels of a frame, its own or the segmenter's; None: there are none, the pixel graph is used.
Given = Masks | Tensor | None


class ImageSegments(NamedTuple):
    """The result of steps 1 and 2 for one frame."""

    boundary: Tensor  #: [H, W] float32 in [0, 1]
    labels: Tensor  #: [H, W] int64, 0, 1, ... without gaps, -1 = none; with masks: their atoms
    masks: Masks | None


class ImageSegmenter(nn.Module):
    """Computes boundaries and initial segments of frames of one size (steps 1 and 2).

    The segments are the frame's own masks or labels if it has them; otherwise those of `segmenter` if it is given;
    otherwise those of the pixel graph, which also divides the pixels outside masks.

    Args:
        config: parameters.
        boundary: any module [B, 3, H, W] RGB in [0, 1] -> [B, H, W] in [0, 1]; default: the detector of the config.
        segmenter: any module [B, 3, H, W] -> [B, H, W] integer labels, -1 = none, or -> B :class:`Masks`; default:
            the pixel graph.
        allow_import: whether the config's detector may be code of the user.
    """

    def __init__(
        self,
        config: Config,
        boundary: nn.Module | None = None,
        segmenter: nn.Module | None = None,
        allow_import: bool = False,
    ) -> None:
        super().__init__()
        self.config = config
        self.boundary = make_boundary(config.boundary, allow_import) if boundary is None else boundary
        self.segmenter = segmenter

    def forward(self, frames: Sequence[Frame], stopwatch: Stopwatch) -> list[ImageSegments]:
        """The boundaries and initial segments of B frames.

        Raises:
            ValueError, TypeError: a module returns a wrong shape, dtype or value.
        """
        with stopwatch("image segments"):
            given = self._given(frames)
        boundaries = self.detect(frames, stopwatch)
        with stopwatch("image segments"):
            return self._segment(frames, given, boundaries)

    def detect(self, frames: Sequence[Frame], stopwatch: Stopwatch) -> Tensor:
        """The boundaries [B, H, W] in [0, 1] of frames."""
        with stopwatch("boundaries"):
            images = torch.stack([frame.image for frame in frames])
            with eval_mode(self.boundary):
                boundaries = self.boundary(images)
            expected = images[:, 0].shape
            if boundaries.shape != expected:
                raise ValueError(f"boundary: expected [B, H, W] = {list(expected)}, got {list(boundaries.shape)}")
            if not ((boundaries >= 0) & (boundaries <= 1)).all():
                low, high = float(boundaries.min()), float(boundaries.max())
                raise ValueError(f"boundary: expected numbers in [0, 1], got {low:.4g} to {high:.4g}")
            boundaries = boundaries.float()
            return close_contours(boundaries) if self.config.contours.closed else boundaries

    def _given(self, frames: Sequence[Frame]) -> list[Given]:
        """What is given for each frame; labels 0, 1, ... without gaps."""
        given: list[Given] = [one.masks if isinstance(one.masks, Masks) else one.labels for one in frames]
        missing = [index for index, segments in enumerate(given) if segments is None]
        if self.segmenter is not None and missing:
            output = self._run(self.segmenter, torch.stack([frames[index].image for index in missing]))
            for index, segments in zip(missing, output, strict=True):
                given[index] = segments
        return [renumber_by_value(segments)[1] if isinstance(segments, Tensor) else segments for segments in given]

    def _run(self, segmenter: nn.Module, images: Tensor) -> list[Masks | Tensor]:
        """The masks or labels of images [B, 3, H, W], checked."""
        size = (images.shape[2], images.shape[3])
        with eval_mode(segmenter):
            output = segmenter(images)
        if len(output) != len(images):
            raise ValueError(f"image_segmenter's output: expected {len(images)} images, got {len(output)}")
        name = "image_segmenter's output"
        return [one.resized(size) if isinstance(one, Masks) else as_labels(one, size, name) for one in output]

    def _segment(self, frames: Sequence[Frame], given: Sequence[Given], boundaries: Tensor) -> list[ImageSegments]:
        def segment(job: tuple[Frame, Given, Tensor]) -> ImageSegments:
            frame, segments, boundary = job
            if isinstance(segments, Tensor):
                return ImageSegments(boundary, segments, None)
            own = segment_image(frame.image, boundary, self.config.image_graph, self.config.image_segments)
            if segments is None:
                return ImageSegments(boundary, own, None)
            masks = segments.divided(own)
            return ImageSegments(boundary, masks.atom.long(), masks)

        return parallel_map(segment, [*zip(frames, given, boundaries, strict=True)])
