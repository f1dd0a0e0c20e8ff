"""Ground truth: instances of mesh vertices and of pixels, as ScanNet has them; label images; boxes around objects."""

import warnings
from collections.abc import Sequence, Set
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchjoint.datasets.cameras import resize_nearest
from torchjoint.datasets.files.binary import Members
from torchjoint.datasets.files.readers import decode_image, labels_of, of_size, read_label_image
from torchjoint.datasets.files.text import Record, read_record
from torchjoint.datasets.recording import tell_not_read, without_case
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import has_file, has_folder
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Frame
from torchjoint.scene.checks import RIGID_TOLERANCE, check_largest

SEGMENTS, OBJECTS = "_vh_clean_2.0.010000.segs.json", ".aggregation.json"


def vertex_instances(folder: Path, scan: str, points: Tensor) -> Tensor | None:
    """Reads [N] int64, the objectId of each vertex of `SCAN_vh_clean_2.ply`, -1 = none; None without annotation."""
    return point_instances(folder / f"{scan}{SEGMENTS}", folder / f"{scan}{OBJECTS}", points)


def point_instances(
    segments_file: Path, objects_file: Path, points: Tensor, *, smallest: bool = False, among: Set[int] | None = None
) -> Tensor | None:
    """Reads [N] int64, the objectId of each vertex of a mesh, -1 = none; None without the file of objects.

    Args:
        segments_file: the segment of each vertex.
        objects_file: the segments of each object.
        points: [N, ...] of the mesh; their number counts.
        smallest: a vertex of several objects belongs to the one of fewest vertices; else to the last in the file.
        among: the objectIds of the objects that are there; None: all.
    """
    if not has_file(objects_file := without_case(objects_file)):
        return None
    record = read_record(without_case(segments_file), "segments of a mesh")
    segments = record.integers("segIndices")
    if len(segments) != len(points):
        raise ValueError(f"{record.name}: expected the segments of {len(points)} points, got {len(segments)}")
    numbers, segment_of_point, sizes = np.unique(segments, return_inverse=True, return_counts=True)
    groups, lacking = [], 0
    for group in read_record(objects_file, "segments of objects").records("segGroups"):
        instance = object_id(group)
        if among is not None and instance not in among:
            continue
        members = group.integers("segments")
        inside, lacking = np.isin(numbers, members), lacking + int((~np.isin(members, numbers)).sum())
        groups.append((int(sizes[inside].sum()) if smallest else 0, instance, inside.nonzero()[0]))
    if lacking:
        warnings.warn(f"{objects_file}: {lacking} segments of objects are not in {segments_file.name}", stacklevel=2)
    objects = np.full(len(numbers), -1, dtype=np.int64)
    for _, instance, places in sorted(groups, key=lambda group: -group[0]):
        objects[places] = instance
    return torch.from_numpy(objects[segment_of_point])


def label_images(files: Sequence[Path], what: str, images: Sequence[Path]) -> Sequence[Tensor]:
    """Label images [H, W] int64 of frames, in files in which 0 means none, as -1; lazy; empty if there is no file."""
    missing = [file for file in files if not has_file(file)]
    if missing and len(missing) < len(files):
        raise FileNotFoundError(f"{missing[0]}: missing; {len(files) - len(missing)} other frames have their {what}")
    if missing:
        tell_not_read(files[0].parent, rf"(?<!cloud\.){what.rstrip('s')}", f"an image of {what}")
        return ()
    return LazySequence(
        len(files), lambda index: of_size(read_label_image(files[index]), files[index], images[index]) - 1
    )


def image_instances(folder: Path, scan: str, frames: LazySequence[Frame]) -> Sequence[Tensor]:
    """Returns label images of the frames, [H, W] int64 of the image's size, ids as for points, -1 = none; lazy.

    The labels are in `instance-filt/N.png`, or in `SCAN_2d-instance-filt.zip` as downloaded; empty if neither exists.
    """
    inside, archive = folder / "instance-filt", folder / f"{scan}_2d-instance-filt.zip"
    if not has_folder(inside) and not has_file(archive):
        return ()
    files, prefix = (Members(inside), "") if has_folder(inside) else (Members(archive), "instance-filt/")
    members = [f"{prefix}{name}.png" for name in frames.names]
    if missing := [member for member in members if member not in files.names]:
        raise FileNotFoundError(f"{files.path / missing[0]}: missing; expected the instances of every frame's pixels")

    def read(index: int) -> Tensor:
        name = f"{files.path}, {members[index]}"
        labels = labels_of(decode_image(files.read(members[index], bounds.IMAGE_BYTES), name), name)
        return resize_nearest(labels - 1, frames[index].size)

    return LazySequence(len(members), read)


def object_id(group: Record) -> int:
    """The checked objectId of a group of segments."""
    instance = group.values.get("objectId")
    if type(instance) is not int or not 0 <= instance < 2**31:
        raise ValueError(f"{group.name}: objectId: expected an integer >= 0")
    return instance


def instances_in_boxes(points: Tensor, centers: Tensor, sizes: Tensor, axes: Tensor, names: Sequence[str]) -> Tensor:
    """Assigns each point to the box that contains it; a box includes its faces.

    A point in several boxes gets the smallest box, since small objects stand in or on large objects. If several boxes
    are equally small, it gets the last of them.

    Args:
        points: [N, 3] metres.
        centers: [B, 3] centres of the boxes, metres.
        sizes: [B, 3] along each box's own axes, metres, above 0.
        axes: [B, 3, 3]; the columns are the axes of the box.
        names: B names, which begin the messages about boxes without an extent or with other axes.

    Returns:
        [N] int64, index of the box; -1 = in no box.
    """
    # Axes of a left hand are as good.
    off = (axes.mT @ axes - torch.eye(3, dtype=torch.float64)).abs().flatten(1).amax(1)
    for center, size, error, name in zip(centers, sizes, off, names, strict=True):
        check_largest(torch.stack([center, size]), name)
        if error > RIGID_TOLERANCE or not bool((size > 0).all()):
            got = f"{size.tolist()}, and axes off by {float(error):.3g}"
            raise ValueError(f"{name}: expected lengths > 0, and axes of length 1 at right angles, got {got}")
    last = dict(zip(map(tuple, torch.cat([centers, sizes, axes.flatten(1)], dim=1).tolist()), names, strict=True))
    if hidden := set(names).difference(last.values()):
        warnings.warn(f"{min(hidden)}: this box is there twice; its points belong to the last one", stacklevel=2)
    instances = torch.full((len(points),), -1, dtype=torch.int64)
    large_first = torch.argsort(sizes.prod(dim=1), descending=True, stable=True)
    for box in large_first.tolist():
        instances[(((points.double() - centers[box]) @ axes[box]).abs() <= sizes[box] / 2).all(dim=1)] = box
    return instances
