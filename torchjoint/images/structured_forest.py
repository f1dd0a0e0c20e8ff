"""Step 1: the structured-forest boundary detector, by default with the forest that comes with the package."""

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

#: Width in pixels of the mirrored margin around the image. With it boundaries near the image border get as many votes
#: as other boundaries.
MARGIN = 16
#: Boundary strength is 1 - exp(-GAIN x votes): it uses the whole range [0, 1) and never reaches 1.
GAIN = 4.0
MULTI_SCALE = (0.5, 1.0, 2.0)
#: Share of a vote that depends on the ratio of the colour gradient at the pixel to the mean gradient around it.
SHARPNESS = 0.35
#: Standard deviation of the Gaussian before the gradient, and side of the square for the mean gradient, pixels.
_GRADIENT_SMOOTHING, _AROUND = 1.5, 9
#: Added to the mean gradient, so that faint gradients do not count: colours in [0, 1] per pixel.
_FAINT = 0.01
_MAX_SIZE = 2**14


class StructuredForestBoundary(nn.Module):
    """Boundary detection by structured forests: P. Dollár and C. L. Zitnick (PAMI 2015), computed by OpenCV.

    Args:
        model: a forest in OpenCV's format (``NAME.yml.gz``), as ``torchjoint train-boundaries`` writes it; None: the
            forest that comes with the package, trained on BSDS500.
        scales: factors by which the image is resized before detection; the results are averaged. ``(0.5, 1, 2)`` is
            more accurate and about five times slower.
        nms: apply non-maximum suppression, which leaves lines about one pixel wide.

    Raises:
        FileNotFoundError: the model's file is missing.
        ValueError: the file is incomplete or is no structured forest; or a bad scale.
    """

    def __init__(self, model: str | Path | None = None, scales: Sequence[float] = (1.0,), nms: bool = False) -> None:
        super().__init__()
        if not scales or not all(math.isfinite(scale) and 0 < scale <= 4 for scale in scales):
            raise ValueError(f"scales: expected numbers in (0, 4], got {scales!r}")
        self.model = None if model is None else str(Path(model).absolute())
        self.scales = tuple(float(scale) for scale in scales)
        self.nms = nms
        self._file_version = _version(self.model)
        _detector(self.model, self._file_version)  # report a bad file here, not at the first image

    @torch.no_grad()
    def forward(self, images: Tensor) -> Tensor:
        """Boundary strength of images: [B, 3, H, W] RGB in [0, 1] -> [B, H, W] in [0, 1).

        The result of an image does not depend on the other images, bit for bit.

        Raises:
            ValueError: a shape other than [B, 3, H, W], or an image that is too large.
        """
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
        votes = _detector(self.model, self._file_version).detectEdges(padded(image))[inside]
        return votes if scale == 1 else cv2.resize(votes, (width, height), interpolation=cv2.INTER_LINEAR)


def relative_gradient(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """The colour gradient of an image [H, W, 3] relative to the mean gradient around each pixel; [H, W] float32.

    A forest locates a boundary only to within some pixels. The gradient is highest at the boundary itself.
    """
    import cv2

    smooth = cv2.GaussianBlur(image, (0, 0), _GRADIENT_SMOOTHING)
    right, down = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1)
    gradient = np.sqrt((right * right + down * down).sum(axis=2)) / 2
    return np.asarray(gradient / (cv2.blur(gradient, (_AROUND, _AROUND)) + _FAINT), np.float32)


def padded(image: NDArray[Any]) -> NDArray[Any]:
    """The image [H, W, ...] with mirrored margins; its sides are multiples of 4, because OpenCV halves them twice."""
    import cv2

    height, width = image.shape[:2]
    return cv2.copyMakeBorder(image, MARGIN, MARGIN + -height % 4, MARGIN, MARGIN + -width % 4, cv2.BORDER_REFLECT)


def _version(model: str | None) -> tuple[int, int] | None:
    """Modification time and size of the file, so that a replaced file is noticed; None for the package's own forest."""
    if model is None or not Path(model).is_file():
        return None
    status = Path(model).stat()
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=4)
def _detector(model: str | None, version: tuple[int, int] | None) -> Any:
    """OpenCV's detector, cached for the process, because reading a forest takes most of a second."""
    import cv2

    if model is not None:
        read_forest(Path(model))  # checks the file, because OpenCV does not
        return cv2.ximgproc.createStructuredEdgeDetection(model)
    with as_file(files("torchjoint.models") / "bsds500.yml.gz") as path:
        read_text(path)  # checks that the package's file is complete
        return cv2.ximgproc.createStructuredEdgeDetection(str(path))
