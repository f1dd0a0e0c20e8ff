"""The scenes of `torchjoint-lab robustness`, kind by kind; none of them trained the model of the package."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from torchjoint.datasets import list_scenes, load_scene
from torchjoint.scene import Scene, Truth
from torchjoint.scene.scene import voxel_subsample
from torchjoint_lab.datasets.semantickitti import read_sweep
from torchjoint_lab.synthetic import make_domain_scene

#: The first seed of generated scenes. The model was trained on smaller ones.
FIRST_SEED = 40
#: Metres: mOSD's clouds, one point a pixel, are thinned to this distance.
THINNED = 0.005


class NamedScene(NamedTuple):
    """A scene that is made or read when it is needed."""

    kind: str
    name: str
    load: Callable[[], Scene]


def generated(kind: str, count: int) -> list[NamedScene]:
    """Generated scenes of one domain."""
    seeds = range(FIRST_SEED, FIRST_SEED + count)
    return [NamedScene(kind, f"{kind}-{seed}", partial(_make, kind, seed)) for seed in seeds]


def _make(kind: str, seed: int) -> Scene:
    return make_domain_scene(kind, seed, held_out=True).scene


def _recordings(folder: Path) -> list[tuple[str, Callable[[], Scene]]]:
    return [(name, partial(load_scene, path)) for name, path in list_scenes(folder).items()]


def _mosd(folder: Path) -> list[tuple[str, Callable[[], Scene]]]:
    """Every second table-top: the others trained the model."""
    found = list_scenes(folder)
    return [(name, partial(_thinned, found[name])) for name in sorted(found, key=lambda name: (len(name), name))[1::2]]


def _thinned(path: Path) -> Scene:
    scene = load_scene(path)
    return scene.select_points(voxel_subsample(scene.points, THINNED))


def _semantickitti(folder: Path) -> list[tuple[str, Callable[[], Scene]]]:
    return [(path.stem, partial(_sweep, path)) for path in sorted(folder.glob("*.bin"))]


def _sweep(path: Path) -> Scene:
    sweep = read_sweep(path)
    return Scene(sweep.points, name=path.stem, truth=Truth(sweep.instance))


def _labelled_clouds(folder: Path) -> list[tuple[str, Callable[[], Scene]]]:
    return [(path.stem, partial(_labelled_cloud, path)) for path in sorted(folder.glob("*.ply"))]


def _labelled_cloud(path: Path) -> Scene:
    """A cloud with NAME.truth.npy: -1 and -2 are no thing."""
    instance = torch.from_numpy(np.load(path.with_suffix(".truth.npy"))).long()
    return replace(load_scene(path), truth=Truth(instance.clamp(min=-1)))


#: Domains of generated scenes.
GENERATED = ("table", "shelf", "bin", "desk", "kitchen", "room", "workshop")
#: Kinds of recorded scenes: the folder in the data, and what finds its scenes.
RECORDED = {
    "ycb": ("ycb", _recordings),
    "mosd": ("mosd", _mosd),
    "recorded-kitchen": ("kitchen", _recordings),
    "semantickitti": ("semantickitti", _semantickitti),
    "vod": ("vod", _labelled_clouds),
    "argo": ("argo", _labelled_clouds),
}
KINDS = (*GENERATED, *RECORDED)


def find_scenes(kinds: tuple[str, ...], count: int, data: Path | None) -> list[NamedScene]:
    """Finds at most `count` scenes of each kind. No kinds: all that are generated, and all that `data` has.

    Raises:
        ValueError: an unknown kind, a number below 1, or no data of a kind; the message names the option.
    """
    if count < 1:
        raise ValueError(f"--scenes: expected at least 1, got {count}")
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        raise ValueError(f"--kinds: expected some of {', '.join(KINDS)}, got {unknown[0]!r}")
    if data is not None and not data.is_dir():
        raise ValueError(f"--data: {data} is not a folder")
    found: list[NamedScene] = []
    for kind in KINDS:
        if kinds and kind not in kinds:
            continue
        if kind in GENERATED:
            found += generated(kind, count)
            continue
        name, scenes = RECORDED[kind]
        of_kind = [] if data is None or not (data / name).is_dir() else scenes(data / name)
        if kinds and not of_kind:
            raise ValueError(f"--data: kind {kind} needs a folder with scenes in {name}/, got {data}")
        found += [NamedScene(kind, f"{kind}-{title}", load) for title, load in of_kind[:count]]
    return found
