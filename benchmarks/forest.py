"""A random forest in the format of OpenCV's structured edges, for timing: right in shape, wrong in every answer."""

import gzip
from pathlib import Path

import cv2
import numpy as np

NUM_TREES = 8
#: A node at least this deep may be a leaf, and one at the most this deep is.
MIN_DEPTH, MAX_DEPTH = 12, 16
LEAF_CHANCE = 0.4
PIXELS_A_LEAF = 16
NUM_CHANNELS, REGULAR, SELF_SIMILAR = 13, 3328, 3900
OPTIONS = {
    "numberOfTrees": NUM_TREES,
    "numberOfTreesToEvaluate": 4,
    "selfsimilarityGridSize": 5,
    "stride": 2,
    "shrinkNumber": 2,
    "patchSize": 32,
    "patchInnerSize": 16,
    "numberOfGradientOrientations": 4,
    "gradientSmoothingRadius": 0,
    "regFeatureSmoothingRadius": 2,
    "ssFeatureSmoothingRadius": 8,
    "gradientNormalizationRadius": 4,
}


def random_detector(image: np.ndarray, folder: Path, seed: int = 0) -> cv2.ximgproc.StructuredEdgeDetection:
    """A detector with a random forest, whose thresholds part the patches of `image` ([H, W, 3] RGB in [0, 1])."""
    rng = np.random.default_rng(seed)
    trees = [_random_tree(rng, _channels(image)) for _ in range(NUM_TREES)]
    # All trees are padded to one number of nodes; what is padded is never reached.
    num_nodes = max(len(tree[0]) for tree in trees)
    children, features, thresholds = (
        [np.pad(tree[part], (0, num_nodes - len(tree[part]))) for tree in trees] for part in range(3)
    )
    num_bins = [np.where(child == 0, PIXELS_A_LEAF, 0) for child in children]
    bins = [rng.integers(0, 256, count.sum()) for count in num_bins]
    path = folder / "forest.yml.gz"
    with gzip.open(path, "wt", compresslevel=1) as file:
        file.write("%YAML:1.0\n---\noptions:\n")
        file.writelines(f"   {name}: {value}\n" for name, value in OPTIONS.items())
        _write(file, "childs", children)
        _write(file, "featureIds", features)
        _write(file, "thresholds", thresholds)
        _write(file, "edgeBoundaries", [np.concatenate([[0], np.cumsum(np.concatenate(num_bins))])])
        _write(file, "edgeBins", bins)
    return cv2.ximgproc.createStructuredEdgeDetection(str(path))


def _random_tree(rng: np.random.Generator, channels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Child (0: a leaf; else the left child's place, the right one follows), feature and threshold of every node."""
    depth, children, place = [0], [], 0
    while place < len(depth):
        here = depth[place]
        is_leaf = here >= MAX_DEPTH or (here >= MIN_DEPTH and rng.random() < LEAF_CHANCE)
        children.append(0 if is_leaf else len(depth) + 1)  # the format counts from one here
        if not is_leaf:
            depth += [here + 1] * 2
        place += 1
    children = np.array(children)
    # Half the nodes ask for a channel, half for the difference of two cells of one.
    regular = rng.random(len(children)) < 0.5
    channel = rng.integers(0, NUM_CHANNELS, len(children))
    feature = np.where(
        regular,
        channel * (REGULAR // NUM_CHANNELS) + rng.integers(0, 256, len(children)),
        REGULAR + channel * (SELF_SIMILAR // NUM_CHANNELS) + rng.integers(0, 300, len(children)),
    )
    values = np.sort(channels, axis=1)
    near_median = values[channel, (rng.uniform(0.3, 0.7, len(children)) * values.shape[1]).astype(int)]
    differences = rng.normal(0, 0.2, len(children)) * channels.std(axis=1)[channel]
    return children, feature * (children > 0), np.where(regular, near_median, differences) * (children > 0)


def _channels(image: np.ndarray) -> np.ndarray:
    """About the 13 channels of a structured forest, [13, pixels]: good enough to place thresholds."""
    luv = cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2Luv) / 270 + np.array([0, 88, 134]) / 270
    channels = list(
        cv2.resize(luv.astype(np.float32), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).transpose(2, 0, 1)
    )
    size = channels[0].shape[::-1]
    for scale in (1.0, 0.5):
        light = cv2.resize(luv[..., 0], None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        right, down = cv2.Sobel(light, cv2.CV_64F, 1, 0, ksize=1), cv2.Sobel(light, cv2.CV_64F, 0, 1, ksize=1)
        magnitude = np.hypot(right, down)
        magnitude = magnitude / (cv2.blur(magnitude, (9, 9)) + 0.01)
        direction = np.rint(np.arctan2(down, right) % np.pi / np.pi * 4) % 4
        for part in (magnitude, *(magnitude * (direction == k) for k in range(4))):
            channels.append(cv2.resize(part, size, interpolation=cv2.INTER_AREA))
    return np.stack([cv2.GaussianBlur(np.asarray(c, np.float64), (3, 3), 1).ravel() for c in channels])


def _write(file: gzip.GzipFile, name: str, parts: list[np.ndarray], row: int = 20) -> None:
    file.write(f"{name}:\n")
    for part in parts:
        for start in range(0, len(part), row):
            file.write(f"   - [ {', '.join(f'{value:.9g}' for value in part[start : start + row].tolist())} ]\n")
