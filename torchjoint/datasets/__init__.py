"""Readers of data on disk: `formats/` has the formats of data sets, `files/` the types of single files."""

import os
import warnings
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from torchjoint.datasets.files.clouds import SUFFIXES, read_cloud_file
from torchjoint.datasets.files.readers import RESULTS
from torchjoint.datasets.formats import FORMATS, Format
from torchjoint.datasets.fusion import fuse_cloud
from torchjoint.datasets.recording import Options
from torchjoint.runtime.foreign_files import has_file, has_folder, is_there, or_unreadable
from torchjoint.runtime.messages import counted
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene import Cloud, Scene
from torchjoint.scene.checks import Invalid

__all__ = ["fuse_cloud", "list_scenes", "load_cloud", "load_scene"]


@on_cpu()
def load_scene(
    path: str | Path,
    *,
    cloud: str | Path | None = None,
    voxel_size: float = 0.02,
    progress: bool | None = None,
    topics: Mapping[str, str] | None = None,
    time_limit: float = 0.02,
    drop_invalid: bool = False,
    least_opacity: float = 0.1,
    fuse: bool = True,
    format: str | None = None,
) -> Scene:
    """Loads a scene; detects its format. Frames are read from disk on access.

    Args:
        path: a folder or a file; docs/your_data.md lists the formats. A `cloud.ply` (or .pcd, .las, .laz, .e57) in a
            folder of posed frames is used as the cloud, and depth is then optional; otherwise the format's own cloud is
            used, or a cloud is fused from the depth images.
        cloud: a file to use as the cloud; if it does not exist yet, a fused cloud is written there, as PLY.
        voxel_size: of the fusion, metres; about the distance between fused points.
        progress: show a progress bar while fusing; None: if there is a terminal. A fused cloud is kept in the user's
            cache for the next time. The environment variable TORCHJOINT_CACHE names another folder; empty: no cache.
        topics: for a ROS recording: the topic of a role, such as {"color": "/camera/color/image_raw"}. The roles are
            color, info, depth, points and odometry. A role needs it only if several topics fit.
        time_limit: for a ROS recording: an image takes a depth image and a pose at most this many seconds away.
        drop_invalid: leave out the points of the cloud that are NaN or infinite, with a warning; else they are an
            error.
        least_opacity: Gaussian splats whose opacity is smaller are no part of the cloud, in [0, 1].
        fuse: False: a recording without a cloud gets a single point in its place, for those who need the frames alone.
        format: a name of `FORMATS`, if the format that is detected is not the right one: "cloud_alone" reads a file as
            points without images.

    Returns:
        The scene; `scene.truth` holds the ground-truth instances, if the data set has any.

    Raises:
        FileNotFoundError, ValueError: the message names the file; if no format fits, what the most similar one needs.
    """
    path = Path(path)
    if not is_there(path):
        raise FileNotFoundError(f"scene: {path} does not exist")
    if not 0 < time_limit < float("inf"):
        raise ValueError(f"time_limit: expected more than 0 seconds, got {time_limit}")
    if not 0 <= least_opacity <= 1:
        raise ValueError(f"least_opacity: expected a number in [0, 1], got {least_opacity}")
    file, roles = None if cloud is None else Path(cloud), dict(topics or {})
    invalid: Invalid = "drop" if drop_invalid else "refuse"
    options = Options(file, voxel_size, progress, roles, time_limit, invalid, least_opacity, fuse, format, path)
    return find_format(path, format).load(path, options)


def find_format(path: Path, format: str | None) -> Format:
    """The format of a scene, or the given one; raises as :func:`load_scene` does if it does not fit."""
    if format is not None and format not in FORMATS:
        raise ValueError(f"format: expected one of {', '.join(FORMATS)}, got {format!r}")
    fits = [name for name in FORMATS if format in (None, name) and or_unreadable(FORMATS[name].recognizes, path)]
    if len(fits) > 1 and has_folder(path):
        told = f"has files of {' and '.join(fits)}; read as {fits[0]}; format (--format) chooses another"
        warnings.warn(f"{path}: {told}", stacklevel=1)  # of one place: told once by a command
    if fits:
        return FORMATS[fits[0]]
    if format is not None:
        raise ValueError(f"scene: {path} is not of format {format}, which needs {FORMATS[format].WHAT}")
    some = ", ".join(str(one) for one in list(list_scenes(path).values())[:3])
    raise ValueError(f"scene: {path} is a data set; choose one of its scenes, such as {some}")


@on_cpu()
def load_cloud(path: str | Path, *, columns: int | str | None = None, drop_invalid: bool = False) -> Cloud:
    """Loads the points of a single file as they are, with its colours, normals and triangles, if it has any.

    Beams without return, many points at (0, 0, 0), are left out, with a warning, but for those of a mesh.
    This is for superpoints of a mesh:

    >>> mesh = load_cloud("mesh.ply")  # doctest: +SKIP
    >>> labels = tj.superpoints(mesh.points, mesh.colors, faces=mesh.faces)  # doctest: +SKIP

    Args:
        path: a cloud or a mesh alone; docs/your_data.md lists the types of files.
        columns: numbers per point in a .bin file; None: 4, or 5 for .pcd.bin. Or a letter for each column of a .bin,
            .npy, .xyz or .txt file: x y z, r g b, nnn (a normal), any other to leave it out: "xyzrgbl".
        drop_invalid: leave out the points that are NaN or infinite, and their triangles, with a warning; else they are
            an error.

    Raises:
        FileNotFoundError, ValueError: the message names the file and its error.
    """
    read = read_cloud_file(Path(path), columns, "drop" if drop_invalid else "refuse")
    return replace(Cloud.checked(read.points, read.colors, read.normals), faces=read.faces)


def list_scenes(path: str | Path) -> dict[str, Path]:
    """Returns the scenes of a data set: their paths, for :func:`load_scene`, by name. A path may be a single scene.

    Links inside that lead nowhere are returned, too: a scene may be lost, and loading it raises the error.

    Raises:
        FileNotFoundError: there is no such path.
        ValueError: there is no scene; the message says what is there, and what the most similar format needs.
    """
    path = Path(path)
    if not is_there(path):
        raise FileNotFoundError(f"scenes: {path} does not exist")
    found = _find_scenes(path)
    if not found:
        if has_folder(path) and not RESULTS.isdisjoint(os.listdir(path)):
            raise ValueError(f"scene: {path}: expected a recording, got a result; `torchjoint show` shows it")
        cloud = _cloud_inside(path)
        told = f"scene: {path} is of no known format: it {_content(path)}.{cloud}{_nearest(path, not cloud)}"
        raise ValueError(f"{told} `torchjoint formats` lists all; own frames: plain folder")
    return found


def _find_scenes(path: Path) -> dict[str, Path]:
    if any(module.recognizes(path) for module in FORMATS.values()):
        return {path.stem if has_file(path) else path.name: path}
    found: dict[str, Path] = {}
    for module in FORMATS.values():
        found = found or getattr(module, "scenes", lambda _: {})(path)
    if not found:
        inside = sorted(path.iterdir()) if has_folder(path) else []
        found = {one.name: one for one in inside if or_unreadable(_is_folder_of_scene, one)}
    parents = {one.parent for one in found.values() if one.is_dir()}
    rest = {one for parent in parents for one in parent.iterdir() if one.name[0] != "."} - {*found.values()}
    left = sorted(one.name for one in rest if one.is_dir() and not RESULTS.intersection(os.listdir(one) or RESULTS))
    if found and left:
        told = f"{path}: {len(left)} of {len(found) + len(left)} folders are of no known format, and are left out"
        warnings.warn(f"{told}: {', '.join(left[:9])}", stacklevel=4)
    return found


def _is_folder_of_scene(path: Path) -> bool:
    return has_folder(path) and any(module.recognizes(path) for module in FORMATS.values())


def _content(path: Path) -> str:
    """What a folder or file of no known format has, in a few words."""
    if has_file(path):
        return f"is a file that ends in {path.suffix!r}" + " (unpack it)" * (path.suffix.lower() in (".zip", ".gz"))
    kinds = Counter("folder" if has_folder(one) else f"{one.suffix} file".strip() for one in sorted(path.iterdir()))
    return f"has {', '.join(counted(count, kind) for kind, count in kinds.most_common(6)) or 'no files'}"


def _cloud_inside(path: Path) -> str:
    inside = sorted(path.iterdir()) if has_folder(path) else []
    found = [one for one in inside if has_file(one) and one.suffix.lower() in {*SUFFIXES} - {".csv", ".npz", ".txt"}]
    if len(found) > 1 and found[0].suffix.lower() in (".las", ".laz"):
        whole = "merge them (`pdal merge A.laz B.laz SITE.laz`), `torchjoint segment SITE.laz`"
        each = "`torchjoint label OUT A.laz -o NEW.laz` for each; `torchjoint superpoints` takes all"
        return f" For objects of all its tiles, {whole}, and {each}."
    return f" For a cloud alone, give the file: {found[0]}." if found else ""


def _nearest(path: Path, by_suffix: bool) -> str:
    """What the format needs that mentions most of the names in a folder, or most of their suffixes, if one does."""
    present = [*path.iterdir(), *path.glob("*/*/")] if has_folder(path) else [path]
    names = {one.name + "/" * one.is_dir() for one in present}
    suffixes = {one.suffix.lower() for one in present} - {""} if by_suffix else ()

    def likeness(what: str) -> tuple[int, int]:
        return len(names.intersection(what.replace(",", "").split())), sum(suffix in what for suffix in suffixes)

    nearest = max((module.WHAT for module in FORMATS.values()), key=likeness)
    return f" The most similar one needs {nearest}." if any(likeness(nearest)) else ""
