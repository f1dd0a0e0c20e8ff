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

from torchjoint.images.forest import read_forest
from torchjoint.images.non_maximum_suppression import suppress_non_maxima
from torchjoint.ops.internal import structured_forest
from torchjoint.runtime.foreign_files import has_file
from torchjoint.runtime.threads import all_threads, parallel_map

#: Width of the mirrored margin around the image, pixels. It gives boundaries near the image border as many votes as
#: other boundaries.
MARGIN = 16
#: Boundary strength is 1 - exp(-GAIN x votes), which uses the whole range [0, 1).
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
    """Boundary detection by structured forests: P. Dollár and C. L. Zitnick (PAMI 2015).

    Args:
        model: a forest in OpenCV's format (``NAME.yml.gz``), as ``torchjoint-lab train-forest`` writes it; None: the
            forest that comes with the package, trained on BSDS500.
        scales: factors by which the image is resized before detection; the results are averaged. ``(0.5, 1, 2)`` is
            more accurate and about five times slower.
        nms: apply non-maximum suppression, which leaves lines about one pixel wide.
        stride: distance between the sites at which trees vote, 2 or 4 pixels; 4 is faster and less accurate.

    Raises:
        FileNotFoundError: the model's file is missing.
        ValueError: the file is incomplete or is no structured forest; or `scales` or `stride` is out of range.
    """

    def __init__(
        self,
        model: str | Path | None = None,
        scales: Sequence[float] = (1.0,),
        nms: bool = False,
        stride: int = 2,
    ) -> None:
        super().__init__()
        if stride not in (2, 4):
            raise ValueError(f"stride: expected 2 or 4, got {stride!r}")
        if not scales or not all(math.isfinite(scale) and 0 < scale <= 4 for scale in scales):
            raise ValueError(f"scales: expected numbers in (0, 4], got {scales!r}")
        self.model = None if model is None else str(Path(model).absolute())
        self.scales = tuple(float(scale) for scale in scales)
        self.nms = nms
        self.stride = stride
        self._file_version = _version(self.model)
        _trees(self.model, self._file_version)  # report a bad file here, not at the first image

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
        pixels = [image.permute(1, 2, 0).contiguous().numpy() for image in images.detach().float()]
        votes = [self._votes(pixels, scale) for scale in self.scales]
        return torch.stack(parallel_map(lambda parts: self._strength(*parts), zip(pixels, *votes, strict=True)))

    def _strength(self, image: NDArray[np.float32], *votes: NDArray[np.float32]) -> Tensor:
        """Boundary strength [H, W] of an image [H, W, 3], from the votes [H, W] at each scale."""
        weight = 1 - SHARPNESS + SHARPNESS * relative_gradient(image)
        strength = 1 - torch.exp(torch.from_numpy(sum(votes) * weight) * (-GAIN / len(votes)))
        return suppress_non_maxima(strength) if self.nms else strength

    def _votes(self, images: Sequence[NDArray[np.float32]], scale: float) -> list[NDArray[np.float32]]:
        """The forest's votes [H, W] for each of the images [H, W, 3] of one size, detected at another size."""
        height, width = images[0].shape[:2]
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        planes = torch.stack(parallel_map(lambda image: _padded_planes(_resized(image, size, scale < 1)), images))
        with all_threads():
            votes = structured_forest(planes, *_trees(self.model, self._file_version), self.stride)
        inside = votes[:, MARGIN : MARGIN + size[1], MARGIN : MARGIN + size[0]]
        return [_resized(one.numpy(), (width, height)) for one in inside]


def _resized(image: NDArray[np.float32], size: tuple[int, int], shrinks: bool = False) -> NDArray[np.float32]:
    """The image [H, W, ...] at another size (width, height); `shrinks`: each pixel is the mean of those it covers."""
    import cv2

    if (image.shape[1], image.shape[0]) == size:
        return image
    return np.asarray(
        cv2.resize(image, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR), np.float32
    )


def _padded_planes(image: NDArray[np.float32]) -> Tensor:
    """The image [H, W, 3] with its margins, [3, H', W']."""
    return torch.from_numpy(np.stack([padded(image[..., channel]) for channel in range(3)]))


def relative_gradient(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """The colour gradient of an image [H, W, 3] relative to the mean gradient around each pixel; [H, W] float32.

    A forest locates a boundary only to within some pixels. The gradient is highest at the boundary itself.
    """
    import cv2

    smooth = cv2.GaussianBlur(image, (0, 0), _GRADIENT_SMOOTHING)
    right, down = (np.asarray(cv2.Sobel(smooth, cv2.CV_32F, *way, ksize=1), np.float32) for way in ((1, 0), (0, 1)))
    # In place, and with OpenCV's sum over channels: new memory and NumPy's sum take twice as long as the rest.
    right *= right
    down *= down
    right += down
    gradient = np.asarray(cv2.transform(right, np.ones((1, 3), np.float32)), np.float32)
    np.sqrt(gradient, out=gradient)
    gradient /= 2
    around = np.asarray(cv2.blur(gradient, (_AROUND, _AROUND)), np.float32)
    around += _FAINT
    gradient /= around
    return gradient


def padded(image: NDArray[Any]) -> NDArray[Any]:
    """The image [H, W, ...] with mirrored margins; its sides are multiples of 4, as in OpenCV."""
    import cv2

    height, width = image.shape[:2]
    return cv2.copyMakeBorder(image, MARGIN, MARGIN + -height % 4, MARGIN, MARGIN + -width % 4, cv2.BORDER_REFLECT)


def _version(model: str | None) -> tuple[int, int] | None:
    """Modification time and size of the file, so that a replaced file is noticed; None for the package's own forest."""
    if model is None or not has_file(Path(model)):
        return None
    status = Path(model).stat()
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=4)
def _trees(model: str | None, version: tuple[int, int] | None) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, int]:
    """A forest as the operator takes it, cached for the process, because reading a file takes a second."""
    if model is None:
        with as_file(files("torchjoint.models") / "bsds500.yml.gz") as path:
            forest = read_forest(path)
    else:
        forest = read_forest(Path(model))
    children, features, thresholds, counts, pixels = (
        torch.from_numpy(array)
        for array in (
            forest.children,
            forest.features,
            forest.thresholds,
            forest.boundary_counts,
            forest.boundary_pixels,
        )
    )
    return children, features, thresholds, counts, pixels, forest.trees_per_site
