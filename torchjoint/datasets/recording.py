"""Makes a scene from posed frames: with the cloud of the recording, or a cloud fused from depth."""

import os
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from torchjoint.datasets.cameras import Camera
from torchjoint.datasets.files.clouds import read_cloud_file, up_of
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.datasets.files.readers import files_below, of_size, read_depth, read_image, read_label_image
from torchjoint.datasets.fusion import fuse_or_recall
from torchjoint.runtime.foreign_files import has_file, has_folder, no_twice
from torchjoint.runtime.outputs import Output
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame, Scene, Truth
from torchjoint.scene.checks import Invalid

T = TypeVar("T")
#: Suffixes of a file `cloud` in a recording's folder; the first that exists is used.
CLOUD_SUFFIXES = (".ply", ".pcd", ".las", ".laz", ".copc.laz", ".e57")


class Frames(LazySequence[Frame]):
    """Frames that are read on access; `has_depth(i)` tells whether frame `i` has a depth image without reading it."""

    #: What is in the names of images of depth, or of their folders; None: they are those of other frames.
    like_depth: str | None = "depth"

    def __init__(
        self, count: int, read: Callable[[int], Frame], names: Sequence[str], has_depth: Callable[[int], bool]
    ) -> None:
        super().__init__(count, read, names)
        self._has_depth = has_depth

    def tell_without_depth(self, path: Path) -> None:
        """Warns if some of the frames have depth, and others have none; or none has, and there are images like it."""
        without = len(self) - sum(map(self._has_depth, range(len(self))))
        if 0 < without < len(self):
            warnings.warn(f"depth: {without} of {len(self)} frames have no depth image", stacklevel=4)
        elif without and self.like_depth is not None:
            tell_not_read(path, self.like_depth, "a depth image")


@dataclass(frozen=True)
class Options:
    """Options of :func:`torchjoint.load_scene`; a format ignores the options that it does not need."""

    cloud: Path | None = None  #: a cloud file to use; if it does not exist, a fused cloud is written there
    voxel_size: float = 0.02  #: of the fusion, metres
    progress: bool | None = False  #: show a progress bar while fusing; None: if there is a terminal
    topics: Mapping[str, str] = field(default_factory=dict)  #: for a ROS recording: topics by role
    time_limit: float = 0.02  #: for a ROS recording: most seconds from an image to its depth and pose
    invalid: Invalid = "refuse"  #: what becomes of points of the cloud that are NaN or infinite
    least_opacity: float = 0.1  #: of the cloud, if it consists of Gaussian splats
    fuse: bool = True  #: False: one point stands for a cloud that would have to be fused
    format: str | None = None  #: name of the format; None: it was detected
    recording: Path | None = None  #: the path that was given: of several recordings in a folder, one


def scene_of_frames(
    path: Path,
    frames: Sequence[Frame],
    options: Options,
    clouds: Sequence[Path] = (),
    *,
    instances: Callable[[Tensor], Tensor | None] | None = None,
    images: Sequence[Tensor] = (),
) -> Scene:
    """Makes a scene from a folder's frames, with the cloud of :func:`find_cloud`, or else with a fused cloud.

    Args:
        path: the folder.
        frames: posed ones.
        options: of `load_scene`.
        clouds: the format's own clouds.
        instances: the true instance of each point [N, 3] of the first of these, or None.
        images: the true instances of the frames' pixels.
    """
    file = find_cloud(path, options, clouds)
    scene = _scene_of_frames(path, frames, options, file)
    is_first = str(file).lower() in (str(one).lower() for one in clouds[:1])
    points = instances(scene.points) if instances is not None and is_first else None
    return replace(scene, truth=Truth(points, images)) if points is not None or images else scene


def _scene_of_frames(path: Path, frames: Sequence[Frame], options: Options, file: Path | None) -> Scene:
    if file is not None:
        if isinstance(frames, Frames):
            frames.tell_without_depth(path)
        cloud = read_cloud_file(file, invalid=options.invalid, least_opacity=options.least_opacity)
        return Scene(cloud.points, frames, cloud.colors, cloud.normals, name=path.name, up=up_of(file))
    if not options.fuse:
        return Scene(torch.zeros(1, 3), frames, name=path.name)
    made = None if options.cloud is None else Output(options.cloud, overwrite=False, option="cloud")
    how = f"{sorted(options.topics.items())} {options.time_limit} {options.format}"
    points, colors = fuse_or_recall(options.recording or path, frames, options.voxel_size, options.progress, how)
    if made is not None:
        with made.written() as file:
            write_cloud(file, points, colors)
    return Scene(points, frames, colors, name=path.name)


def find_cloud(path: Path, options: Options, clouds: Sequence[Path] = ()) -> Path | None:
    """Returns the first cloud that exists: `options.cloud`, `cloud.*` in the folder, the format's own `clouds`.

    The names of the latter two are compared without case.
    """
    files = map(without_case, [*(path / f"cloud{suffix}" for suffix in CLOUD_SUFFIXES), *clouds])
    return next((file for file in (options.cloud, *files) if file is not None and has_file(file)), None)


def without_case(file: Path) -> Path:
    """Returns the file of a folder that has this name, or this name but for the case, if there is one."""
    if os.path.lexists(file) or not has_folder(file.parent):
        return file
    return file.with_name(_names(file.parent, file.parent.stat().st_mtime_ns).get(file.name.lower(), file.name))


#: Each frame asks for files of the same folders.
_names = lru_cache(maxsize=16)(lambda folder, _: {name.lower(): name for name in sorted(os.listdir(folder))})


class Shot(NamedTuple):
    """What is known of a frame before its files are read."""

    color: Path | Callable[[], Tensor]  #: 8-bit; or what reads it as [3, H, W] uint8
    camera: Camera
    world_to_camera: Tensor  #: [4, 4]
    name: str
    depth: Path | Callable[[], Tensor | None] | None = None  #: 16-bit, none if the file is not there; or what reads it
    unit: float = 0.001  #: of a depth file, metres
    labels: Path | None = None  #: an initial segmentation, 0 = none; none if the file is not there
    first: Path | None = None  #: of the images of a camera without a size: all have its size

    def has_depth(self) -> bool:
        """Whether there is a depth image."""
        return has_file(self.depth) if isinstance(self.depth, Path) else self.depth is not None

    def read(self) -> Frame:
        """Reads the frame."""
        depth = None
        if self.depth is not None and self.has_depth():
            depth = read_depth(self.depth, self.unit) if isinstance(self.depth, Path) else self.depth()
        image = read_image(self.color, self.camera.size) if isinstance(self.color, Path) else self.color()
        if self.first is not None:
            image = of_size(image, self.color, self.first)
        frame = self.camera.frame(image, self.world_to_camera, depth, self.name)
        if self.labels is None or not has_file(self.labels):
            return frame
        return replace(frame, labels=read_label_image(self.labels) - 1)


def tell_left_out(name: str, left: int, total: int, why: str = "have no pose") -> None:
    """Warns of images that are left out; readers of all formats tell it with these words."""
    if left > 0:  # a recording may count its images wrongly
        warnings.warn(f"{name}: {left} of {total} images {why} and are left out", stacklevel=4)


def posed(items: Sequence[tuple[T, Tensor | None]], name: str, where: str, limit: float) -> list[tuple[T, Tensor]]:
    """The images that have a pose, of pairs of both; a warning tells of the others, and an error if none has."""
    kept = [(one, pose) for one, pose in items if pose is not None]
    if not kept:
        raise ValueError(f"{name}: none of {len(items)} images has a pose within {limit} s ({where})")
    tell_left_out(name, len(items) - len(kept), len(items), f"have no pose within {limit} s,")
    return kept


def tell_lost(name: str, posed: Iterable[object], there: Collection[object]) -> None:
    """Warns of images that have a camera or a pose, and are not there."""
    lost = len(set(posed).difference(there))
    tell_left_out(name, lost, lost + len(there), "have a pose, but are missing,")


def tell_unlisted(name: str, files: Sequence[Path]) -> None:
    """Warns of images beside those with a pose, `files`, which a list of poses does not name: they are left out.

    An image is one of theirs if it differs in its number only.
    """
    kinds = {(file.parent, _without_number(file)) for file in files}
    folders, used = {file.parent for file in files}, set(files)
    beside = {one for folder in folders for one in folder.iterdir() if (folder, _without_number(one)) in kinds}
    tell_left_out(name, len(beside - used), len(beside | used))


def tell_not_read(folder: Path, like: str, what: str) -> None:
    """Warns if no frame has an image of a kind, and one below the folder is like it: of another suffix or number."""
    name = re.compile(rf"{like}.*\.(png|tiff?|npy|exr|pgm)$", re.IGNORECASE)
    found = next((file for file in files_below(folder) if name.search(str(file.relative_to(folder)))), None)
    if found is not None:
        warnings.warn(f"{found}: not read: no frame has {what} of the name that its format gives it", stacklevel=5)


def sorted_images(folder: Path, files: Iterable[Path]) -> list[Path]:
    """Images of a folder, sorted by name, 2 before 10; each frame has one. Hidden files (macOS: ._NAME) are none."""
    stems = [(file.stem.removesuffix(".color"), file) for file in files if file.name[0] != "."]
    no_twice((stem for stem, _ in stems), f"{folder}: the colour image of frame")
    return [file for _, file in sorted(stems, key=lambda one: _words_and_numbers(one[0]))]


def _words_and_numbers(stem: str) -> tuple[list[str | int], str]:
    parts = re.split(r"(\d+)", stem)  # words and numbers in turn
    # Python reads at most 4300 digits
    return [part if number % 2 == 0 else int(part[-4000:]) for number, part in enumerate(parts)], stem


def _without_number(file: Path) -> str:
    return re.sub(r"\d+", "#", file.name)


def read_shots(shots: Sequence[Shot]) -> Frames:
    """Returns the frames in the order of the shots; each is read on access. Two of one name or image are an error."""
    no_twice((str(shot.color) for shot in shots if isinstance(shot.color, Path)), "frames: image")
    names = [shot.name for shot in shots]
    no_twice(map(str.lower, names), "the colour image of frame")
    return Frames(len(shots), lambda index: shots[index].read(), names, lambda index: shots[index].has_depth())
