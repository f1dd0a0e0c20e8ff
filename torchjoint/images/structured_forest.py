"""Step 1: the structured-forest boundary detector, and the forest that comes with the package."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from torchjoint.images.forest import read_forest, read_text
from torchjoint.images.non_maximum_suppression import suppress_non_maxima
from torchjoint.runtime.threads import parallel_map

#: The image is mirrored beyond its border by this much, pixels, so that boundaries there get as many votes as others.
MARGIN = 16
#: Boundary strength is 1 - exp(-GAIN x votes): it uses the whole range, and never reaches its end.
GAIN = 4.0
MULTI_SCALE = (0.5, 1.0, 2.0)
#: Share of a vote that depends on the colour gradient there, compared with that around it.
SHARPNESS = 0.35
#: Standard deviation of the Gaussian before the gradient is taken, and side of the square around, pixels.
_GRADIENT_SMOOTHING, _AROUND = 1.5, 9
#: Mean gradient below which there is nothing to compare with, per pixel, of colours in [0, 1].
_FAINT = 0.01
_MAX_SIZE = 2**14


class StructuredForestBoundary(nn.Module):
    """Boundaries by structured forests: P. Dollár and C. L. Zitnick (PAMI 2015), run by OpenCV.

    Args:
        model: a forest in OpenCV's format (``NAME.yml.gz``), such as ``torchjoint train-boundaries`` writes; None for
            the one that comes with the package, trained on BSDS500.
        scales: sizes of the image at which boundaries are sought; results are averaged. ``(0.5, 1, 2)`` is better and
            takes about five times as long.
        nms: keep only the maxima across a boundary, and so lines about a pixel wide.

    Raises:
        FileNotFoundError, ValueError: the model's file is missing, cut off or no structured forest; a bad scale.
    """

    def __init__(self, model: str | Path | None = None, scales: Sequence[float] = (1.0,), nms: bool = False) -> None:
        super().__init__()
        if not scales or not all(math.isfinite(scale) and 0 < scale <= 4 for scale in scales):
            raise ValueError(f"scales: expected numbers in (0, 4], got {scales!r}")
        self.model = None if model is None else str(Path(model).absolute())
        self.scales = tuple(float(scale) for scale in scales)
        self.nms = nms
        self._file_version = _version(self.model)
        _detector(self.model, self._file_version)  # a bad file should be told of here

    @torch.no_grad()
    def forward(self, images: Tensor) -> Tensor:
        """[B, 3, H, W] RGB in [0, 1] -> [B, H, W] in [0, 1]; images are independent of one another, to the bit."""
        if images.ndim != 4 or images.shape[1] != 3:
            raise ValueError(f"images: expected shape [B, 3, H, W], got {list(images.shape)}")
        if images.numel() == 0:
            return images.new_zeros(images[:, 0].shape, dtype=torch.float32)
        largest = int(_MAX_SIZE / max(*self.scales, 1))
        if max(images.shape[2:]) > largest:
            raise ValueError(f"images: expected at most {largest} pixels a side, got {list(images.shape)}")
        return torch.stack(parallel_map(self._single, images))

    def _single(self, image: Tensor) -> Tensor:
        pixels = image.detach().float().permute(1, 2, 0).contiguous().numpy()
        votes = sum((self._votes(pixels, scale) for scale in self.scales), np.zeros(pixels.shape[:2], np.float32))
        votes *= 1 - SHARPNESS + SHARPNESS * relative_gradient(pixels)
        strength = 1 - torch.exp(torch.from_numpy(votes) * (-GAIN / len(self.scales)))
        return suppress_non_maxima(strength) if self.nms else strength

    def _votes(self, image: NDArray[np.float32], scale: float) -> NDArray[np.float32]:
        import cv2

        height, width = image.shape[:2]
        if scale != 1:
            size = (max(1, round(width * scale)), max(1, round(height * scale)))
            way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
            image = np.asarray(cv2.resize(image, size, interpolation=way), np.float32)
        inside = (slice(MARGIN, MARGIN + image.shape[0]), slice(MARGIN, MARGIN + image.shape[1]))
        votes = _detector(self.model, self._file_version).detectEdges(widened(image))[inside]
        return votes if scale == 1 else cv2.resize(votes, (width, height), interpolation=cv2.INTER_LINEAR)


def relative_gradient(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """How strong the colour gradient of an image [H, W, 3] is, compared with its mean around; [H, W].

    A forest sees that there is a boundary, and where to some pixels; the gradient is highest where it is.
    """
    import cv2

    smooth = cv2.GaussianBlur(image, (0, 0), _GRADIENT_SMOOTHING)
    right, down = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1)
    gradient = np.sqrt((right * right + down * down).sum(axis=2)) / 2
    return np.asarray(gradient / (cv2.blur(gradient, (_AROUND, _AROUND)) + _FAINT), np.float32)


def widened(image: NDArray[Any]) -> NDArray[Any]:
    """The image [H, W, ...] with mirrored margins, whose sides are multiples of 4: OpenCV halves them twice."""
    import cv2

    height, width = image.shape[:2]
    return cv2.copyMakeBorder(image, MARGIN, MARGIN + -height % 4, MARGIN, MARGIN + -width % 4, cv2.BORDER_REFLECT)


def _version(model: str | None) -> tuple[int, int] | None:
    """Tells a file from another one that takes its place."""
    if model is None or not Path(model).is_file():
        return None
    status = Path(model).stat()
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=4)
def _detector(model: str | None, version: tuple[int, int] | None) -> Any:
    """OpenCV's detector, kept for the process: it takes the better part of a second to read a forest."""
    import cv2

    if model is not None:
        read_forest(Path(model))  # OpenCV does not check what it reads
        return cv2.ximgproc.createStructuredEdgeDetection(model)
    with as_file(files("torchjoint.models") / "bsds500.yml.gz") as path:
        read_text(path)  # whole, and so the one that came with the package
        return cv2.ximgproc.createStructuredEdgeDetection(str(path))
