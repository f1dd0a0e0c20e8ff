"""The benchmark suites: labelled scenes, split into tuning scenes and checking scenes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch

from torchjoint.config import Config
from torchjoint.scene import Scene
from torchjoint.scene.scene import voxel_subsample
from torchjoint.views.visibility import in_any_view
from torchjoint_lab.datasets.scenes import list_scenes, load_scene
from torchjoint_lab.synthetic import DOMAINS, make_domain_scene, make_scene

#: Metres between points of a single depth image after thinning.
SPACING = 0.005

#: Number of frames, evenly spread, that are used of a long recording.
MOST_FRAMES = 20

Scenes = Mapping[str, Callable[[], Scene]]


@dataclass(frozen=True)
class Suite:
    """Scenes of one kind, split into two halves.

    Args:
        name: of the suite.
        what: a sentence for the table.
        tuning: from the data folder, the loaders by scene name of the scenes on which settings are chosen.
        checking: the same for the scenes that the table shows.
        config: parameters common to all methods on this data, for example of visibility.
        preset: name of the preset for this kind of data, see :mod:`torchjoint_lab.benchmark.presets`.
        needs_data: whether a data folder must be given.
        tuned_as: name of the suite whose settings are used, if this suite has no settings of its own.
    """

    name: str
    what: str
    tuning: Callable[[Path | None], Scenes]
    checking: Callable[[Path | None], Scenes]
    config: Config
    preset: str = "default"
    needs_data: bool = True
    tuned_as: str = ""

    def scenes(self, half: str, data: Path | None) -> Scenes:
        """Returns the loaders of a half, "tuning" or "checking", by scene name.

        Raises:
            ValueError: the suite needs a data folder and `data` is None, or the folder holds no scene for this half.
        """
        if self.needs_data and data is None:
            raise ValueError(f"--data: suite {self.name} needs the folder of its data; docs/your_data.md has layouts")
        found = (self.tuning if half == "tuning" else self.checking)(data)
        if not found:
            raise ValueError(f"--data: {data} holds too few scenes: none is left for {half}")
        return found


def load_all(scenes: Scenes) -> Iterator[Scene]:
    """Loads the scenes one after the other."""
    for load in scenes.values():
        yield load()


def _every_other(first: int, load: Callable[[Path], Scene], data: Path | None) -> Scenes:
    """Every other place of a data set, with all scenes of the place: several scans of a room stay in one half."""
    assert data is not None  # checked by Suite.scenes
    found = list_scenes(data)
    names = sorted(found, key=lambda name: (len(name), name))  # learn8 before learn10
    places = list(dict.fromkeys(map(_place, names)))[first::2]
    return {name: partial(load, found[name]) for name in names if _place(name) in places}


def _place(name: str) -> str:
    """The place of a ScanNet scan: scene0012 for scene0012_00, scene0012_01, ..."""
    return re.sub(r"(scene\d{4})_\d\d", r"\1", name)


def _folder_suite(
    name: str, what: str, load: Callable[[Path], Scene], config: Config, preset: str = "default"
) -> Suite:
    return Suite(name, what, partial(_every_other, 0, load), partial(_every_other, 1, load), config, preset)


def _synthetic(name: str, what: str, every: int = 1, tuned_as: str = "") -> Suite:
    def scenes(seeds: range, _: Path | None) -> Scenes:
        return {str(seed): partial(_make, seed, every) for seed in seeds}

    halves = partial(scenes, range(100, 104)), partial(scenes, range(10))
    return Suite(name, what, *halves, Config(), "indoor", needs_data=False, tuned_as=tuned_as)


def _make(seed: int, every: int) -> Scene:
    scene = make_scene(seed, "large", num_views=24, num_points=120_000, depth_ripple=0.002, hard=True).scene
    return scene.select_points(torch.arange(0, len(scene.points), every))  # the points are in random order


def _domain(name: str) -> Suite:
    """Generated scenes with built-in shapes; the model in the package was trained on other seeds, with other shapes."""

    def scenes(seeds: range, _: Path | None) -> Scenes:
        return {f"{name} {seed}": partial(_make_of_domain, name, seed) for seed in seeds}

    tuning, checking = partial(scenes, range(20, 24)), partial(scenes, range(10, 14))
    return Suite(name, f"generated scenes of the domain {name}", tuning, checking, Config(), needs_data=False)


def _make_of_domain(name: str, seed: int) -> Scene:
    return make_domain_scene(name, seed).scene


def _load_thinned(path: Path) -> Scene:
    """Thins the cloud: neighbouring pixels of a depth camera are closer to each other than the depth noise."""
    scene = load_scene(path)
    return scene.select_points(voxel_subsample(scene.points, SPACING))


def _load_in_view(path: Path) -> Scene:
    """Keeps the points in the camera's view: KITTI annotates boxes only there."""
    scene = load_scene(path)
    return scene.select_points(in_any_view(scene.points, scene.frames))


def _load_some_frames(path: Path) -> Scene:
    return load_scene(path).sample_frames(MOST_FRAMES)


SUITES = {
    suite.name: suite
    for suite in (
        _synthetic("synthetic", "furnished rooms, 24 views 640x480, 120,000 points; tuned on seeds 100-103"),
        _synthetic("sparse", "the same rooms, 20,000 points; settings of suite synthetic", 6, "synthetic"),
        _folder_suite(
            "mosd", "table-tops, one RGB-D view each, points 5 mm apart", _load_thinned, Config(), "tabletop"
        ),
        _folder_suite(
            "kitti",
            "street LiDAR and one camera, the points in its view",
            _load_in_view,
            Config(),
            preset="scan",
        ),
        _folder_suite("scannet", "rooms, up to 20 frames each", _load_some_frames, Config()),
        *(_domain(name) for name in DOMAINS),
    )
}
