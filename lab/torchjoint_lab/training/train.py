"""Trains a forest: one tree per process at a time; each finished tree is saved."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from torchjoint.images.forest import LABEL_SIZE, NUM_FEATURES, Forest, read_forest
from torchjoint.runtime.files import atomic_write
from torchjoint.runtime.outputs import Output, work_folder
from torchjoint_lab.datasets.bsds import BsdsImage
from torchjoint_lab.training.forest_file import write_forest
from torchjoint_lab.training.patches import FeatureCodes, draw_samples, segmentation_lines
from torchjoint_lab.training.tree import TreeOptions, grow_tree


@dataclass(frozen=True)
class TrainingOptions:
    """Options of the training.

    Attributes:
        trees: number of trees; `trees_per_site` of them are evaluated at each site.
        trees_per_site: a larger number gives smoother boundaries, but takes longer.
        samples: number of training patches per tree.
        feature_share: share of all features that a tree may use.
        seed: of all random choices; each tree has its own random stream.
        tree: options of a tree.
    """

    trees: int = 8
    trees_per_site: int = 4
    samples: int = 500_000
    feature_share: float = 0.5
    seed: int = 0
    tree: TreeOptions = field(default_factory=TreeOptions)

    def __post_init__(self) -> None:
        for name, value, least in (
            ("trees", self.trees, 1), ("trees_per_site", self.trees_per_site, 1), ("samples", self.samples, 1000),
            ("seed", self.seed, 0),
        ):  # fmt: skip
            if not isinstance(value, int) or value < least:
                raise ValueError(f"{name}: expected a whole number >= {least}, got {value!r}")
        if self.trees_per_site > self.trees:
            raise ValueError(f"trees_per_site: expected at most trees = {self.trees}, got {self.trees_per_site}")
        if not 0 < self.feature_share <= 1:
            raise ValueError(f"feature_share: expected a number in (0, 1], got {self.feature_share}")


class GrownTree(NamedTuple):
    """A tree in the format of the forest."""

    children: NDArray[np.int32]
    features: NDArray[np.int32]
    thresholds: NDArray[np.float32]
    boundary_counts: NDArray[np.int32]
    boundary_pixels: NDArray[np.uint8]


def train_boundaries(
    images: Sequence[BsdsImage],
    out: Path,
    options: TrainingOptions = TrainingOptions(),
    *,
    workers: int = 2,
    overwrite: bool = True,
) -> Forest:
    """Trains a forest and writes it in OpenCV's format.

    Finished trees are saved in ``OUT.trees`` until the forest is complete: an interrupted run continues from there.

    Args:
        images: training images.
        out: file for the forest, ``NAME.yml.gz``.
        options: the same images and options make the same file with any number of workers.
        workers: number of processes; each takes about 6 kB of memory per sample with the default `feature_share`.
        overwrite: replace an earlier file.

    Raises:
        FileExistsError: ``OUT.trees`` exists, but not from an earlier training; or OUT, without `overwrite`.
        ValueError: no images, or a name that does not end in .yml.gz.
    """
    if not images:
        raise ValueError("images: expected at least one, got none")
    if workers < 1:
        raise ValueError(f"workers: expected a whole number >= 1, got {workers}")
    if not out.name.endswith(".yml.gz"):
        raise ValueError(f"out: expected a name that ends in .yml.gz, got {out}")
    made = Output(out, overwrite=overwrite)
    folder = _tree_folder(out, images, options)
    missing = [index for index in range(options.trees) if not (folder / _tree_name(index)).is_file()]
    with ProcessPoolExecutor(max(1, min(workers, len(missing))), mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(_make_tree, folder, images, options, index, index % workers) for index in missing]
        try:
            for job in as_completed(jobs):
                job.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    trees = [_load_tree(folder / _tree_name(index)) for index in range(options.trees)]
    forest = _forest(trees, options.trees_per_site)
    with made.written() as path:
        write_forest(path, forest)
        read_forest(path)
    shutil.rmtree(folder)
    return forest


def _tree_folder(out: Path, images: Sequence[BsdsImage], options: TrainingOptions) -> Path:
    """The folder with the trees of this training; deletes trees of a training with other images or options."""
    record = json.dumps([[image.name for image in images], dataclasses.asdict(options)])
    return work_folder(out.with_name(f"{out.name}.trees"), record)


def _tree_name(index: int) -> str:
    return f"tree-{index:02d}.npz"


def _make_tree(folder: Path, images: Sequence[BsdsImage], options: TrainingOptions, index: int, row: int) -> None:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):  # sums in matrix products depend on the number of threads
        tree = _grow(images, options, index, row)
    with atomic_write(folder / _tree_name(index)) as partial:
        np.savez(partial, **tree._asdict())


def _grow(images: Sequence[BsdsImage], options: TrainingOptions, index: int, row: int) -> GrownTree:
    codes = FeatureCodes.of_images(images, np.random.default_rng(options.seed))  # equal for all trees
    rng = np.random.default_rng([options.seed, index])
    chosen = np.sort(rng.choice(NUM_FEATURES, round(NUM_FEATURES * options.feature_share), replace=False))
    with tqdm(total=len(images), desc=f"tree {index}: patches", unit="image", position=row, leave=False) as bar:
        samples = draw_samples(images, codes, chosen, options.samples, rng, bar.update)
    total = samples.codes.shape[1]
    with tqdm(total=total, desc=f"tree {index}: growing", unit="patch", position=row, leave=False) as bar:
        tree = grow_tree(samples, rng, options.tree, bar.update)
    features = chosen[tree.features]
    is_leaf = tree.children == 0
    lines = np.stack([segmentation_lines(leaf) for leaf in tree.segments.reshape(-1, LABEL_SIZE, LABEL_SIZE)])
    leaf, pixels = np.nonzero(lines.reshape(len(lines), -1))
    counts = np.zeros(len(is_leaf), np.int32)
    counts[is_leaf] = np.bincount(leaf, minlength=len(lines))
    return GrownTree(
        tree.children,
        np.where(is_leaf, 0, features).astype(np.int32),
        np.where(is_leaf, 0, codes.thresholds(features, tree.codes.astype(np.int64))).astype(np.float32),
        counts,
        pixels.astype(np.uint8),
    )


def _load_tree(path: Path) -> GrownTree:
    with np.load(path) as arrays:
        return GrownTree(**{name: arrays[name] for name in GrownTree._fields})


def _forest(trees: Sequence[GrownTree], trees_per_site: int) -> Forest:
    nodes = max(len(tree.children) for tree in trees)

    def stacked(name: str) -> NDArray[Any]:
        arrays = (getattr(tree, name) for tree in trees)
        return np.stack([np.pad(array, (0, nodes - len(array))) for array in arrays])

    return Forest(
        stacked("children"),
        stacked("features"),
        stacked("thresholds"),
        stacked("boundary_counts"),
        np.concatenate([tree.boundary_pixels for tree in trees]),
        trees_per_site,
    )
