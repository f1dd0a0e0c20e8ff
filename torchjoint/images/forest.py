"""Step 1: the arrays of a structured forest, and its file in OpenCV's format."""

from __future__ import annotations

import gzip
import json
import re
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from torchjoint.runtime.foreign_files import has_file

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
    """T structured trees, all padded to N nodes.

    Raises:
        ValueError: arrays of different shapes, or values out of range.
    """

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
        trees, nodes = self.children.shape
        if trees == 0 or nodes == 0 or not 1 <= self.trees_per_site <= trees:
            raise ValueError(f"trees_per_site: expected 1 to {trees}, got {self.trees_per_site} ({nodes} nodes a tree)")
        for name in ("features", "thresholds", "boundary_counts"):
            if getattr(self, name).shape != (trees, nodes):
                raise ValueError(f"{name}: expected shape {[trees, nodes]}, got {list(getattr(self, name).shape)}")
        is_inner = self.children != 0
        # If every child comes after its parent, there are no cycles.
        if (is_inner & ((self.children <= np.arange(1, nodes + 1)) | (self.children >= nodes))).any():
            raise ValueError("children: expected places after the parent's, and inside the tree")
        if ((self.features < 0) | (self.features >= NUM_FEATURES)).any():
            raise ValueError(f"features: expected numbers in [0, {NUM_FEATURES})")
        if not np.isfinite(self.thresholds).all():
            raise ValueError("thresholds: expected finite numbers")
        if (self.boundary_counts < 0).any() or self.boundary_counts.sum(dtype=np.int64) != len(self.boundary_pixels):
            raise ValueError(f"boundary_counts: expected counts of {len(self.boundary_pixels)} pixels in all")


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
