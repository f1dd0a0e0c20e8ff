"""torchjoint-lab train-forest: trains the boundary detector's forest on BSDS500, or on images annotated like it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import tyro

from torchjoint.cli.arguments import output_file
from torchjoint_lab.datasets.bsds import SPLITS, bsds_images


def train_forest(
    bsds_dir: tyro.conf.Positional[Path],
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("boundaries.yml.gz"),
    splits: tuple[str, ...] = ("train", "val"),
    trees: int = 8,
    samples: int = 500_000,
    min_child: int = 8,
    seed: int = 0,
    workers: int = 2,
    overwrite: bool = False,
) -> None:
    """Trains structured forests for boundary detection; an interrupted run continues with the unfinished tree.

    Args:
        bsds_dir: folder of the data set: images/ and groundTruth/, or the original BSR.
        out: file for the forest, NAME.yml.gz, in OpenCV's format; `--set boundary.model=NAME.yml.gz` uses it.
        splits: parts of the data set to train on; leave out the part on which the forest will be scored.
        trees: number of trees; half of them are evaluated at each pixel.
        samples: number of training patches per tree.
        min_child: smallest number of patches at a node; a larger value makes a smaller file.
        seed: of all random choices; the same seed makes the same file.
        workers: number of processes; each takes about 3 GB for half a million patches.
        overwrite: replace OUT if it exists.
    """
    from torchjoint_lab import training

    output_file(out, overwrite, (bsds_dir,))
    unknown = [split for split in splits if split not in SPLITS]
    if unknown or not splits:
        raise ValueError(f"--splits: expected some of {', '.join(SPLITS)}, got {' '.join(splits) or 'none'}")
    images = [image for split in splits for image in bsds_images(bsds_dir, split)]
    options = training.TrainingOptions(
        trees=trees,
        trees_per_site=(trees + 1) // 2,
        samples=samples,
        seed=seed,
        tree=training.TreeOptions(min_child=min_child),
    )
    begin = time.perf_counter()
    forest = training.train_boundaries(images, out, options, workers=workers, overwrite=overwrite)
    size = out.stat().st_size / 1e6
    print(
        f"{len(forest.children)} trees of up to {forest.children.shape[1]} nodes from {len(images)} images in "
        f"{time.perf_counter() - begin:.0f} s: {out}, {size:.1f} MB"
    )
