"""Step 1: structured forests, their files, and the boundaries that they find."""

import gzip
import json
import math
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from torchjoint.images.contours import suppress_non_maxima
from torchjoint.ops.internal import structured_forest
from torchjoint.runtime.foreign_files import has_file
from torchjoint.runtime.threads import all_threads, parallel_map

#: Largest size of a forest's decompressed file, bytes; the forest of the package has 26 MB.
MAX_TEXT = 1 << 27
#: Side of the patch of boundaries that a leaf stores, pixels.
LABEL_SIZE = 16
#: Number of features that OpenCV's detector computes of a patch.
NUM_FEATURES = 7228

#: The options in a forest's file. They determine the features that OpenCV computes.
OPTIONS = {
    "numberOfTrees": 8,
    "numberOfTreesToEvaluate": 4,
    "selfsimilarityGridSize": 5,
    "stride": 2,
    "shrinkNumber": 2,
    "patchSize": 32,
    "patchInnerSize": LABEL_SIZE,
    "numberOfGradientOrientations": 4,
    "gradientSmoothingRadius": 0,
    "regFeatureSmoothingRadius": 2,
    "ssFeatureSmoothingRadius": 8,
    "gradientNormalizationRadius": 4,
}
#: The lists of numbers in a forest's file, in this order.
LISTS = ("childs", "featureIds", "thresholds", "edgeBoundaries", "edgeBins")


@dataclass(frozen=True)
class Forest:
    """T structured trees, all padded to N nodes."""

    #: [T, N] int32, 0 at a leaf, else 1 + the left child's index in the tree; the right child follows
    children: NDArray[np.int32]
    features: NDArray[np.int32]  #: [T, N] int32, the feature that an inner node tests
    thresholds: NDArray[np.float32]  #: [T, N] float32; a patch goes left if its feature is less than the threshold
    boundary_counts: NDArray[np.int32]  #: [T, N] int32, the number of `boundary_pixels` that belong to a leaf
    #: [P] uint8, column * 16 + row of each boundary pixel in a leaf's patch; leaves are in the order of trees,
    #: then nodes
    boundary_pixels: NDArray[np.uint8]
    trees_per_site: int = 4  #: number of trees that vote at one image site; neighbouring sites use different trees

    def __post_init__(self) -> None:
        structured_forest(torch.empty(0, 3, 1, 1, dtype=torch.float32, device="cpu"), *self.tensors())  # it checks them

    def tensors(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, int]:
        """The arguments of the operator."""
        *arrays, trees_per_site = vars(self).values()
        children, features, thresholds, counts, pixels = map(torch.from_numpy, arrays)
        return children, features, thresholds, counts, pixels, trees_per_site


def read_forest(path: Path) -> Forest:
    """Reads and checks a forest's file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is incomplete, is no structured forest, or has other options than `OPTIONS`.
    """
    text = _read_text(path)
    try:
        return _parse(text)
    except (ValueError, OverflowError, RecursionError) as error:
        raise ValueError(f"{path}: not a structured forest as OpenCV reads it: {error}") from error


def _read_text(path: Path) -> bytes:
    """The content of a file, decompressed and checked to be complete; errors as in :func:`read_forest`."""
    if not has_file(path):
        raise FileNotFoundError(f"{path}: missing; expected a structured forest, NAME.yml.gz")
    try:
        with path.open("rb") as stream:
            is_packed = stream.read(2) == b"\x1f\x8b"
        with gzip.open(path) if is_packed else path.open("rb") as content:
            text = content.read(MAX_TEXT + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError(f"{path}: not a whole .gz file: {error}") from error
    if len(text) > MAX_TEXT:
        raise ValueError(f"{path}: expected a structured forest, at most {MAX_TEXT} bytes, got more")
    return text


def _parse(text: bytes) -> Forest:
    if not text.startswith(b"%YAML"):
        raise ValueError("expected %YAML:1.0 at its beginning")
    places = [text.find(b"\n%s:" % name.encode()) for name in ("options", *LISTS)]
    if min(places) < 0 or places != sorted(places):
        raise ValueError(f"expected the entries options, {', '.join(LISTS)}, in this order")
    ends = [*places[1:], len(text)]
    options = dict(re.findall(rb"(\w+):\s*(\d+)\s*$", text[places[0] : ends[0]], re.MULTILINE))
    for name, expected in OPTIONS.items():
        value = options.get(name.encode())
        if value is None or (not name.startswith("numberOfTrees") and int(value) != expected):
            raise ValueError(f"options.{name}: expected {expected}, got {'nothing' if value is None else int(value)}")
    children, features, thresholds, boundaries, pixels = (
        _numbers(name, text[start + len(name) + 2 : end])
        for name, start, end in zip(LISTS, places[1:], ends[1:], strict=True)
    )
    trees = int(options[b"numberOfTrees"])
    if trees == 0 or len(children) % trees or not len(children) == len(features) == len(thresholds):
        raise ValueError(f"expected one number of nodes in each of {trees} trees")
    if len(boundaries) != len(children) + 1 or boundaries[0] != 0:
        raise ValueError(f"edgeBoundaries: expected {len(children) + 1} numbers from 0, got {len(boundaries)}")
    if len(pixels) and not 0 <= pixels.min() <= pixels.max() < LABEL_SIZE**2:
        raise ValueError(f"edgeBins: expected numbers in [0, {LABEL_SIZE**2})")
    shape = (trees, -1)
    return Forest(
        children.astype(np.int32).reshape(shape),
        features.astype(np.int32).reshape(shape),
        thresholds.astype(np.float32).reshape(shape),
        np.diff(boundaries).astype(np.int32).reshape(shape),
        pixels.astype(np.uint8),
        int(options[b"numberOfTreesToEvaluate"]),
    )


def _numbers(name: str, text: bytes) -> NDArray[np.float64]:
    """The numbers of a list of lists: 1, 2, 3 for `- [ 1, 2 ]`, `- [ 3 ]`."""
    flat = re.sub(rb"\]\s*-\s*\[", b",", text.strip())
    flat = re.sub(rb"^-\s*\[", b"[", flat, count=1)
    # OpenCV writes floats without a fraction as `1.`, which other readers do not accept.
    values = json.loads(re.sub(rb"\.(?=[^0-9])", b".0", flat) if b"." in flat else flat)
    if not isinstance(values, list):
        raise ValueError(f"{name}: expected lists of numbers")
    try:
        return np.array(values, np.float64)
    except TypeError as error:
        raise ValueError(f"{name}: expected numbers: {error}") from error


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
    """

    def __init__(
        self, model: str | Path | None = None, scales: Sequence[float] = (1.0,), nms: bool = False, stride: int = 2
    ) -> None:
        super().__init__()
        if stride not in (2, 4):
            raise ValueError(f"stride: expected 2 or 4, got {stride!r}")
        if not scales or not all(math.isfinite(scale) and 0 < scale <= 4 for scale in scales):
            raise ValueError(f"scales: expected numbers in (0, 4], got {scales!r}")
        self.model = None if model is None else str(Path(model).absolute())
        self.scales = tuple(float(scale) for scale in scales)
        self.nms, self.stride = nms, stride
        self._file_version = _version(self.model)
        if model is not None:  # report a bad file here; the package's own is read for the first image
            _trees(self.model, self._file_version)

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
        pixels = list(images.detach().float().numpy())
        votes = [self._votes(pixels, scale) for scale in self.scales]
        return torch.stack(parallel_map(lambda parts: self._strength(*parts), zip(pixels, *votes, strict=True)))

    def _strength(self, image: NDArray[np.float32], *votes: NDArray[np.float32]) -> Tensor:
        """Boundary strength [H, W] of an image [3, H, W], from the votes [H, W] at each scale."""
        weight = 1 - SHARPNESS + SHARPNESS * relative_gradient(image)
        strength = 1 - torch.exp(torch.from_numpy(sum(votes) * weight) * (-GAIN / len(votes)))
        return suppress_non_maxima(strength) if self.nms else strength

    def _votes(self, images: Sequence[NDArray[np.float32]], scale: float) -> list[NDArray[np.float32]]:
        """The forest's votes [H, W] for each of the images [3, H, W] of one size, detected at another size."""
        height, width = images[0].shape[1:]
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        sides = [2 * MARGIN + side + -side % 4 for side in reversed(size)]
        planes = torch.empty(len(images), 3, *sides, dtype=torch.float32)

        def pad(index: int) -> None:
            for plane, out in zip(images[index], planes[index].numpy(), strict=True):
                padded(_resized(plane, size, scale < 1), out)

        parallel_map(pad, range(len(images)))
        with all_threads():
            votes = structured_forest(planes, *_trees(self.model, self._file_version), self.stride)
        inside = votes[:, MARGIN : MARGIN + size[1], MARGIN : MARGIN + size[0]]
        return [_resized(one.numpy(), (width, height)) for one in inside]


def _resized(image: NDArray[np.float32], size: tuple[int, int], shrinks: bool = False) -> NDArray[np.float32]:
    """The image [H, W] at another size (width, height); `shrinks`: each pixel is the mean of those it covers."""
    import cv2

    if (image.shape[1], image.shape[0]) == size:
        return image
    how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size, interpolation=how), np.float32)


def relative_gradient(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """The colour gradient of an image [C, H, W] relative to the mean gradient around each pixel; [H, W] float32.

    A forest locates a boundary only to within some pixels. The gradient is highest at the boundary itself.
    """
    import cv2

    gradient = np.zeros(image.shape[1:], np.float32)
    for plane in image:
        smooth = cv2.GaussianBlur(plane, (0, 0), _GRADIENT_SMOOTHING)
        for way in ((1, 0), (0, 1)):
            cv2.accumulateSquare(cv2.Sobel(smooth, cv2.CV_32F, *way, ksize=1), gradient)
    np.sqrt(gradient, out=gradient)
    gradient /= 2
    around = np.asarray(cv2.blur(gradient, (_AROUND, _AROUND)), np.float32)
    around += _FAINT
    gradient /= around
    return gradient


def padded(image: NDArray[Any], out: NDArray[Any] | None = None) -> NDArray[Any]:
    """The image [H, W, ...] with mirrored margins, in `out` or new; its sides are multiples of 4, as in OpenCV."""
    import cv2

    height, width = image.shape[:2]
    margins = (MARGIN, MARGIN + -height % 4, MARGIN, MARGIN + -width % 4)
    return cv2.copyMakeBorder(image, *margins, cv2.BORDER_REFLECT, dst=out)


def _version(model: str | None) -> tuple[int, int] | None:
    """Modification time and size of the file, so that a replaced file is noticed; None for the package's own forest."""
    if model is None or not has_file(Path(model)):
        return None
    status = Path(model).stat()
    return status.st_mtime_ns, status.st_size


@lru_cache(maxsize=4)
def _trees(model: str | None, version: tuple[int, int] | None) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, int]:
    """A forest as the operator takes it, cached for the process, because reading a file takes a second."""
    if model is not None:
        return read_forest(Path(model)).tensors()
    with as_file(files("torchjoint.models") / "bsds500.yml.gz") as path:
        return read_forest(path).tensors()
