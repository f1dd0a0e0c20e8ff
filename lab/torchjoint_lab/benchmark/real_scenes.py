"""The judges of `torchjoint-lab real`: real recordings, most of them of kinds that no training has seen.

DATA holds ``real/`` (plain folders whose truth knows -2, no thing), ``ycb/``, ``mosd/``, and LiDAR: ``kitti/``,
``semantickitti/``, ``vod/``, ``argo/``, ``nuscenes/``. A set that DATA lacks is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets import list_scenes, load_scene
from torchjoint.datasets.files.readers import read_label_image
from torchjoint.datasets.formats.folder import read_frames
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Scene, Truth
from torchjoint.scene.scene import voxel_subsample
from torchjoint.views.visibility import in_any_view
from torchjoint_lab.benchmark.robustness_scenes import THINNED
from torchjoint_lab.datasets.semantickitti import read_sweep
from torchjoint_lab.evaluation.partial_truth import PartialTruth
from torchjoint_lab.synthetic import with_network_masks

#: Values of a true image of ``real/``: no thing, and void. Smaller ones are things.
STUFF_PIXEL = 65534
#: The masks that are made of the truth: its errors, and the share of the things that get masks.
MASKS = {
    "perfect masks": ("perfect", 1.0),
    "SAM-like masks": ("sam-like", 1.0),
    "hard masks": ("hard", 1.0),
    "masks of some": ("sam-like", 0.4),
}
#: The sets whose scenes also get masks.
MASKED = ("shelf", "ycb")
LIDAR = ("kitti", "semantickitti", "vod", "argo", "nuscenes")

#: KITTI and SemanticKITTI are one sensor, on one car.
SAME_SENSOR = {"semantickitti": "kitti"}


def model_without(name: str) -> str:
    """The file of the scan model that has not seen the sensor of a set."""
    return f"without-{SAME_SENSOR.get(name, name)}.npz"


class LabelledScene(NamedTuple):
    """A scene and what is known about its points."""

    scene: Scene
    truth: PartialTruth


class RealScene(NamedTuple):
    """A scene of a set. It is read when it is needed."""

    set: str
    name: str
    load: Callable[[], LabelledScene]
    masks: str = ""  #: of MASKS, "" = none

    @property
    def is_scan(self) -> bool:
        """Whether it is of a LiDAR."""
        return self.set in LIDAR


def find_real_scenes(data: Path, sets: tuple[str, ...] = ()) -> list[RealScene]:
    """Finds all scenes of the sets, of all sets that DATA has if none is named, then those with masks.

    Raises:
        ValueError: no folder, an unknown set, or a set without a scene; the message names the option.
    """
    if not data.is_dir():
        raise ValueError(f"--data: {data} is not a folder")
    if unknown := [name for name in sets if name not in SETS]:
        raise ValueError(f"--sets: expected some of {', '.join(SETS)}, got {unknown[0]!r}")
    found: list[RealScene] = []
    for name in sets or SETS:
        of_set = [RealScene(name, f"{name}-{title}", load) for title, load in SETS[name](data)]
        if sets and not of_set:
            raise ValueError(f"--data: set {name} was not found in {data}")
        found += of_set
    if not found:
        raise ValueError(f"--data: {data} has none of {', '.join(SETS)}")
    masked = [one for one in found if one.set in MASKED]
    return found + [
        RealScene(f"{one.set}, {masks}", f"{one.name}-{masks.replace(' ', '-')}", one.load, masks)
        for masks in MASKS
        for one in masked
    ]


def with_masks(labelled: LabelledScene, masks: str, seed: int) -> Scene:
    """The scene with masks of one of MASKS; each seed makes other errors."""
    level, share = MASKS[masks]
    return with_network_masks(labelled.scene, level, seed, share)


Found = Iterator[tuple[str, Callable[[], LabelledScene]]]


def _plain(data: Path, pattern: str) -> Found:
    for folder in sorted((data / "real").glob(pattern)):
        yield folder.name, partial(read_plain, folder)


def read_plain(folder: Path) -> LabelledScene:
    """Reads a folder of ``real/``; in the scene's own truth, what is no thing is void."""
    cloud, frames = load_scene(folder / "cloud.ply"), read_frames(folder)
    label = torch.from_numpy(np.load(folder / "cloud.truth.npy")).long()
    files = sorted(folder.glob("frame-*.truth.png"))
    images = LazySequence(len(files), lambda index: _things(read_label_image(files[index])))
    scene = replace(cloud, frames=frames, truth=Truth(label.clamp(min=-1), images), name=folder.name)
    return LabelledScene(scene, PartialTruth(label.clamp(min=-1), label == -2))


def _things(pixels: Tensor) -> Tensor:
    return torch.where(pixels >= STUFF_PIXEL, -1, pixels)


def all_known(scene: Scene) -> LabelledScene:
    """Points without an instance are void."""
    assert scene.truth is not None
    assert scene.truth.points is not None
    instance = scene.truth.points.long()
    return LabelledScene(scene, PartialTruth(instance, torch.zeros_like(instance, dtype=torch.bool)))


def _ycb(data: Path) -> Found:
    for name, path in _scenes(data / "ycb").items():
        yield name, lambda path=path: all_known(load_scene(path))  # type: ignore[misc]


def _mosd(data: Path) -> Found:
    """Every second table-top: the others trained the model."""
    found = _scenes(data / "mosd")
    for name in sorted(found, key=lambda name: (len(name), name))[1::2]:
        yield name, partial(_thinned, found[name])


def _thinned(path: Path) -> LabelledScene:
    scene = load_scene(path)
    return all_known(scene.select_points(voxel_subsample(scene.points, THINNED)))


def _kitti(data: Path) -> Found:
    for name, path in _scenes(data / "kitti" / "training").items():
        yield name, partial(_in_the_image, path)


def _in_the_image(path: Path) -> LabelledScene:
    scene = load_scene(path)
    return all_known(replace(scene.select_points(in_any_view(scene.points, scene.frames)), frames=()))


def _nuscenes(data: Path) -> Found:
    for name, path in _scenes(data / "nuscenes").items():
        yield name, lambda path=path: all_known(replace(load_scene(path), frames=()))  # type: ignore[misc]


def _semantickitti(data: Path) -> Found:
    for path in sorted((data / "semantickitti").glob("*.bin")):
        yield path.stem, partial(_sweep, path)


def _sweep(path: Path) -> LabelledScene:
    sweep = read_sweep(path)
    scene = Scene(sweep.points, name=path.stem)
    return LabelledScene(scene, PartialTruth(sweep.instance, (sweep.instance < 0) & ~sweep.void))


def _scan(data: Path, name: str) -> Found:
    """A cloud with things in boxes; the colours are the image's."""
    for path in sorted((data / name).glob("cloud.ply")):
        yield "cloud", partial(_boxed, path)


def _boxed(path: Path) -> LabelledScene:
    label = torch.from_numpy(np.load(path.with_suffix(".truth.npy"))).long()
    return LabelledScene(load_scene(path), PartialTruth(label.clamp(min=-1), label == -2))


def _scenes(folder: Path) -> dict[str, Path]:
    return list_scenes(folder) if folder.is_dir() else {}


#: The sets, and what finds their scenes: names, and functions that read them.
SETS: dict[str, Callable[[Path], Found]] = {
    "shelf": partial(_plain, pattern="shelf"),
    "tote": partial(_plain, pattern="tote"),
    "rio": partial(_plain, pattern="rio_*"),
    "piles": partial(_plain, pattern="piles_*"),
    "trees": partial(_plain, pattern="trees_*"),
    "ycb": _ycb,
    "mosd": _mosd,
    "kitti": _kitti,
    "semantickitti": _semantickitti,
    "vod": partial(_scan, name="vod"),
    "argo": partial(_scan, name="argo"),
    "nuscenes": _nuscenes,
}
