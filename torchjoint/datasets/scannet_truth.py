"""Reads ScanNet's ground-truth instances: of mesh vertices, from mesh segments grouped into objects; and of pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.cameras import resize_nearest
from torchjoint.datasets.files.members import Members
from torchjoint.datasets.files.readers import decode_image, labels_of, read_label_image
from torchjoint.datasets.files.text import Record, read_record
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame

SEGMENTS, OBJECTS = "_vh_clean_2.0.010000.segs.json", ".aggregation.json"


def has_point_instances(folder: Path, scan: str) -> bool:
    """Returns whether the vertices of `SCAN_vh_clean_2.ply` are annotated."""
    return has_file(folder / f"{scan}{OBJECTS}")


def read_point_instances(folder: Path, scan: str, num_points: int) -> Tensor:
    """Reads [N] int64, the objectId of each vertex of `SCAN_vh_clean_2.ply`; -1 = none."""
    return point_instances(folder / f"{scan}{SEGMENTS}", folder / f"{scan}{OBJECTS}", num_points)


def point_instances(
    segments_file: Path, objects_file: Path, num_points: int, *, smallest: bool = False, among: Set[int] | None = None
) -> Tensor:
    """Reads [N] int64, the objectId of each vertex of a mesh; -1 = none.

    Args:
        segments_file: the segment of each vertex.
        objects_file: the segments of each object.
        num_points: of the mesh.
        smallest: a vertex of several objects belongs to the one of fewest vertices; else to the last in the file.
        among: the objectIds of the objects that are there; None: all.
    """
    record = read_record(segments_file, "segments of a mesh")
    segments = record.integers("segIndices")
    if len(segments) != num_points:
        raise ValueError(f"{record.name}: expected the segments of {num_points} points, got {len(segments)}")
    numbers, segment_of_point, sizes = np.unique(segments, return_inverse=True, return_counts=True)
    groups = []
    for group in read_record(objects_file, "segments of objects").records("segGroups"):
        instance = object_id(group)
        if among is not None and instance not in among:
            continue
        inside = np.isin(numbers, group.integers("segments"))
        groups.append((int(sizes[inside].sum()) if smallest else 0, instance, inside.nonzero()[0]))
    objects = np.full(len(numbers), -1, dtype=np.int64)
    for _, instance, members in sorted(groups, key=lambda group: -group[0]):
        objects[members] = instance
    return torch.from_numpy(objects[segment_of_point])


def image_instances(folder: Path, scan: str, frames: LazySequence[Frame]) -> Sequence[Tensor]:
    """Returns label images of the frames, [H, W] int64 of the image's size, ids as for points, -1 = none; lazy.

    The labels are in `instance-filt/N.png`, or in `SCAN_2d-instance-filt.zip` as downloaded; empty if neither exists.
    """
    names, archive = frames.names, folder / f"{scan}_2d-instance-filt.zip"
    read = _folder_reader(folder / "instance-filt", names) or _archive_reader(archive, names)
    if read is None:
        return ()
    return LazySequence(len(names), lambda i: resize_nearest(read(names[i]) - 1, frames[i].size))


def _folder_reader(folder: Path, names: Sequence[str]) -> Callable[[str], Tensor] | None:
    if not has_folder(folder):
        return None
    for name in names:
        if not has_file(folder / f"{name}.png"):
            raise FileNotFoundError(f"{folder / name}.png: missing; expected the instances of every frame's pixels")
    return lambda name: read_label_image(folder / f"{name}.png")


def _archive_reader(file: Path, names: Sequence[str]) -> Callable[[str], Tensor] | None:
    if not has_file(file):
        return None
    archive = Members(file)
    for name in names:
        if (member := f"instance-filt/{name}.png") not in archive.names:
            raise FileNotFoundError(f"{file}: expected a member for every frame; {member} is missing")
    return lambda name: _read_label_member(archive, f"instance-filt/{name}.png")


def _read_label_member(archive: Members, member: str) -> Tensor:
    name = f"{archive.path}, {member}"
    return labels_of(decode_image(archive.read(member, bounds.IMAGE_BYTES), name), name)


def object_id(group: Record) -> int:
    """The objectId of an annotated object."""
    instance = group.values.get("objectId")
    if type(instance) is not int or not 0 <= instance < 2**31:
        raise ValueError(f"{group.name}: objectId: expected an integer >= 0")
    return instance
