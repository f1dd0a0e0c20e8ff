"""The viewer's layers that are not of a result: a scene's truth, and superpoints of a file."""

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.files import text_clouds
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.columns import CloudFile
from torchjoint.datasets.files.las import SUFFIXES, las_chunks, open_las
from torchjoint.datasets.files.meshes import scene_of
from torchjoint.datasets.files.ply import read_vertex_property
from torchjoint.results.labelled_file import KEPT, ORIGIN
from torchjoint.results.result import Result
from torchjoint.runtime.archives import as_int64, read_archive
from torchjoint.runtime.foreign_files import no_twice, read_file
from torchjoint.runtime.messages import printable
from torchjoint.scene import Scene, Segmentation, Truth
from torchjoint.scene.checks import as_labels, as_tensor
from torchjoint.transforms import transfer_labels

#: Names of labels in a file. If it has several, the last one, which is the newest, is shown.
NAMES = "label", "superpoint"
#: Kinds of files that have labels.
KINDS = ".ply", ".npz", ".glb", *SUFFIXES, *text_clouds.SUFFIXES
#: The name of the file of a segment.
PART = re.compile(r"(-00001|\d{6,})(?:-(.*))?", re.DOTALL)
#: Largest distance between a point of a result and that of its scene, metres.
NEAR = 1e-3


def with_truth(result: Result, scene: Scene) -> Result:
    """Adds the truth of a scene to a result, in the order of the result's points and images.

    Args:
        result: of the scene, or of some of its points and frames.
        scene: the scene with its truth.
    """
    if scene.truth is None:
        raise ValueError(f"--truth: expected a scene with ground truth, got {scene.name} without")
    points = scene.truth.points
    if points is not None and not torch.equal(scene.points.double(), result.scene.points.double()):
        index = transfer_labels(torch.arange(len(points)), scene.points, result.scene.points, NEAR)
        if lost := int((index < 0).sum()):
            raise ValueError(f"--truth: expected the points of the result; {scene.name} lacks {lost} of them")
        points = points[index]
    images: list[Tensor] = []
    if len(scene.truth.images):
        place = {frame.name: index for index, frame in enumerate(scene.frames)}
        if missing := [name for name in result.names if name not in place]:
            raise ValueError(f"--truth: {scene.name} has no frame {missing[0]!r}")
        images = [scene.truth.images[place[name]] for name in result.names]
    return replace(result, scene=replace(result.scene, truth=Truth(points, images)))


def read_labelled_cloud(path: Path) -> Result:
    """Reads a .ply, .las, .laz or text with `label` or `superpoint`, a .npz with points and labels, or parts."""
    if files := part_files(path):
        return _of_parts(path, [file.stem for file in files], [read_cloud_file(file, None, "keep") for file in files])
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", KEPT)
        cloud, labels = read_cloud_file(path, None, "keep"), _labels(path)
    if path.suffix.lower() == ".glb" and (result := _of_nodes(path)) is not None:
        return result
    if labels is None or len(labels) != len(cloud.points):
        wanted = "a .ply, .las, .laz or text with `label` or `superpoint`, or a .npz with `labels`"
        raise ValueError(f"{path}: expected {wanted}, got no labels")
    name = f"{path}: labels"  # floats would be cut to integers
    whole = as_labels(as_tensor(as_int64(labels, name), name), labels.shape[:1], name)
    is_valid = cloud.points.isfinite().all(1)
    cloud, ids = cloud.chosen(is_valid), _with_rest(whole[is_valid])
    labels_of = ids if int(ids.max()) <= len(ids) else ids.unique(return_inverse=True)[1]
    return Result.of(Segmentation(labels_of, ()), Scene(cloud.points, colors=cloud.colors, name=path.stem))


def part_files(folder: Path) -> list[Path]:
    """The .ply of each segment that `label` and `export` write into a folder; none of another folder."""
    files = sorted(folder.glob("*.[pP][lL][yY]"))
    return files if all(PART.fullmatch(file.stem) for file in files) else []


def _of_parts(path: Path, stems: list[str], clouds: list[CloudFile], up: Tensor | None = None) -> Result:
    found = [one for stem in stems if (one := PART.fullmatch(stem))]
    ids = torch.tensor([int(one[1]) for one in found])
    no_twice(ids.tolist(), f"{path}: segment")
    labels = _with_rest(ids).repeat_interleave(torch.tensor([len(cloud.points) for cloud in clouds]))
    colors = [cloud.colors for cloud in clouds if cloud.colors is not None]
    points = torch.cat([cloud.points for cloud in clouds])
    scene = Scene(points, colors=torch.cat(colors) if len(colors) == len(clouds) else None, name=path.stem, up=up)
    names = {int(one[1]): printable(one[2]) for one in found if one[2]}
    return replace(Result.of(Segmentation(labels, ()), scene), segment_names=names)


def _with_rest(labels: Tensor) -> Tensor:
    """Labels in which what has none is the last thing."""
    return labels.where(labels >= 0, labels.max() + 1)


def _of_nodes(path: Path) -> Result | None:
    """The vertices of a .glb of `label`, by its nodes; None: of others."""
    mesh = scene_of(read_file(path, "a mesh"), path)
    # In glTF y is up; `label` tells of what it made of a file with another direction.
    parts, up = mesh.dump(), as_tensor(np.array(mesh.metadata.get("up", (0.0, 1.0, 0.0))), f"{path}: up")
    stems = [str(part.metadata.get("name")) for part in parts]
    clouds = [CloudFile(torch.from_numpy(np.array(part.vertices))) for part in parts]
    return _of_parts(path, stems, clouds, up) if all(map(PART.fullmatch, stems)) else None


def _labels(path: Path) -> npt.NDArray[Any] | None:
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return read_archive(path).get("labels")
    if suffix in text_clouds.SUFFIXES:
        return text_clouds.read_column(path, NAMES)
    if suffix in SUFFIXES:
        with open_las(path) as reader:
            own = reader.header.point_format.extra_dimensions
            found = [one.name for one in own if one.name in NAMES or (one.description, one.dtype) == (ORIGIN, np.int32)]
            chunks = [np.asarray(chunk[found[-1]]) for chunk in las_chunks(reader, path)] if found else []
        return np.concatenate(chunks) if chunks else None
    return read_vertex_property(path, *NAMES) if suffix == ".ply" else None
