"""What do boundaries of real rooms show, and what generated ones? Quantiles of the features of the first regions.

`python lab/studies/real_boundaries.py [--data DATA] [--models FURNITURE] [--write]` (half a minute). --write draws
lab/studies/real_boundaries.png, of the features that differ most.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from matplotlib import pyplot as plt
from torchjoint_lab.benchmark.real_scenes import find_real_scenes
from torchjoint_lab.synthetic import make_domain_scene

from torchjoint import JointSegmenter
from torchjoint.cloud.neighbors import SPACING_NEIGHBORS, nearest_neighbors
from torchjoint.scene import Scene
from torchjoint.scene.scene import voxel_subsample
from torchjoint.segments.learned.boundary_features import FEATURE_NAMES, boundary_features
from torchjoint.segments.learned.superpoints import build_superpoint_graph

#: Generated scenes, of seeds that no training has.
KINDS, SEEDS = ("room", "kitchen"), (50, 51)
QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
#: Lumps of a surface: side of the voxels and height, in units of the spacing; as wide as so many neighbours, blurred.
VOXEL, HEIGHT, NEIGHBORS, BLURS = 1.0, 1.5, 16, 2
#: Features in the picture.
SHOWN = 12
PICTURE = Path(__file__).with_name("real_boundaries.png")

Array = npt.NDArray[np.float32]


def main() -> None:
    """Prints the largest differences of each pair, in units of the 80 % range of real rooms."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[3] / "shared" / "data")
    parser.add_argument("--models", type=Path)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    rooms = [one for one in find_real_scenes(options.data, ("rio",)) if not one.masks]
    made = [make_domain_scene(kind, seed, models=options.models).scene for kind in KINDS for seed in SEEDS]
    alone = [replace(scene, frames=()) for scene in made]
    of = {
        "real rooms (3RScan)": features([replace(one.load().scene, frames=()) for one in rooms]),
        "generated": features(alone),
        "generated, lumpy": features([lumpy(scene) for scene in alone]),
    }
    real, *others = of.values()
    far = [differences(real, other) for other in others]
    worst = np.argsort(-far[0])[:SHOWN]
    for place in worst:
        print(f"| {FEATURE_NAMES[place]} | {far[0][place]:.2f} | {far[1][place]:.2f} |")
    print(f"| mean of all {np.isfinite(far[0]).sum()} | {np.nanmean(far[0]):.2f} | {np.nanmean(far[1]):.2f} |")
    if options.write:
        draw({name: quantiles(values)[:, worst] for name, values in of.items()}, [FEATURE_NAMES[i] for i in worst])


def lumpy(scene: Scene) -> Scene:
    """A cloud with one point in each voxel, whose surfaces rise and fall, as those of clothes, bags and heaps."""
    spacing = float(nearest_neighbors(scene.points, SPACING_NEIGHBORS).spacing.median())
    scene = scene.select_points(voxel_subsample(scene.points, VOXEL * spacing))
    near = nearest_neighbors(scene.points, NEIGHBORS)
    lumps = torch.randn(scene.points.shape, generator=torch.Generator().manual_seed(0))
    for _ in range(BLURS):
        lumps = (lumps + lumps[near.indices].sum(1)) / (NEIGHBORS + 1)
    return replace(scene, points=scene.points + HEIGHT * lumps / lumps.std() * near.spacing[:, None])


def features(scenes: Sequence[Scene]) -> Array:
    """The features of the boundaries [B, F] between the superpoints of clouds."""
    found = []
    for scene in scenes:
        segmenter = JointSegmenter()
        segmenter.reset(scene.points, scene.colors, scene.normals)
        assert segmenter.graph is not None
        assert segmenter.state is not None
        found.append(
            boundary_features(build_superpoint_graph(segmenter.graph, segmenter.graph.scales, segmenter.state))
        )
    return torch.cat(found).numpy()


def quantiles(values: Array) -> Array:
    """Of each feature, [Q, F]."""
    known = np.where(np.isfinite(values), values, np.nan)
    return np.asarray([np.nanquantile(known, share, axis=0) for share in QUANTILES], dtype=np.float32)


def differences(real: Array, other: Array) -> Array:
    """Of each feature [F], the mean difference of the quantiles, in units of the real ones' range; NaN: none has it."""
    one = quantiles(real)
    return np.asarray(np.abs(one - quantiles(other)).mean(0) / np.maximum(one[-1] - one[0], 1e-6))


def draw(found: dict[str, Array], names: Sequence[str]) -> None:
    """For each feature and kind of scene: a line over 80 % of the values, a box over half of them, their median."""
    figure, axes = plt.subplots(3, 4, figsize=(10, 4.8), layout="constrained")
    for place, (axis, name) in enumerate(zip(axes.flat, names, strict=True)):
        for row, (kind, values) in enumerate(found.items()):
            low, first, middle, third, high = values[:, place]
            color = f"C{row}"
            axis.plot([low, high], [-row, -row], color=color, linewidth=1)
            axis.plot([first, third], [-row, -row], color=color, linewidth=7, solid_capstyle="butt", label=kind)
            axis.plot([middle], [-row], "|", color="black", markersize=10)
        axis.set_title(name.replace("_", " "), fontsize=9)
        axis.set_yticks([])
        axis.tick_params(labelsize=8)
        axis.margins(y=0.3)
    figure.legend(*axes.flat[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(found), fontsize=9)
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
