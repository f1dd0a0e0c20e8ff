"""Clouds with labels: a PLY for each segment, one LAS file, one archive of arrays."""

import warnings
from pathlib import Path

import numpy as np

from torchjoint.datasets.files.las import check_no_copc, laz_backend
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.results.labelled_file import add_dimensions, file_stem
from torchjoint.results.result import Result
from torchjoint.runtime.archives import write_archive
from torchjoint.runtime.files import atomic_write, frame_files
from torchjoint.runtime.messages import needed_for
from torchjoint.runtime.threads import on_cpu


@on_cpu()
def export_ply(folder: Path, result: Result) -> None:
    """Writes ID.ply, or ID-NAME.ply, for each segment of the cloud, with its points' own colours, if there are any."""
    folder.mkdir()
    for segment in result.points[result.points >= 0].unique().tolist():
        cloud = result.cloud(segment)
        write_cloud(folder / f"{file_stem(segment, result)}.ply", cloud.points, cloud.colors)


@on_cpu()
def export_las(path: Path, result: Result) -> None:
    """Writes a LAS 1.4 file of all points: 16-bit colours, if there are any, and the extra dimension `label` (int32).

    Coordinates are kept to a tenth of a millimetre, or, with a warning, to what 32 bits can hold. A result with a
    confidence also has it at each point, as the extra dimension `confidence` (float32).
    """
    check_no_copc(path)
    with needed_for("--format las", "laspy", "torchjoint[export]"):
        import laspy
    points = result.scene.points.double().numpy()
    header = laspy.LasHeader(point_format=7 if result.scene.colors is not None else 6, version="1.4")
    # The power of ten with which the longest axis fits into the positive numbers of 32 bits.
    scale = max(1e-4, 10.0 ** np.ceil(np.log10((np.ptp(points, axis=0).max() + 1) / (2**31 - 1))))
    if scale > 1e-4:
        warnings.warn(f"coordinates are rounded to {scale:g} m: LAS has no finer ones for such clouds", stacklevel=2)
    header.offsets, header.scales = np.floor(points.min(0)), np.full(3, scale)
    columns = {"label": result.points.numpy().astype(np.int32)}
    if (sure := result.point_confidence) is not None:
        columns["confidence"] = sure.numpy().astype(np.float32)
    add_dimensions(laspy, header, columns)
    header.creation_date = None  # equal results give equal bytes
    cloud = laspy.LasData(header)
    cloud.xyz = points
    for name, values in columns.items():
        cloud[name] = values
    if result.scene.colors is not None:
        colors = (result.scene.colors.clamp(0, 1) * 65535).round().numpy().astype(np.uint16)
        cloud.red, cloud.green, cloud.blue = colors.T
    with atomic_write(path) as partial:
        cloud.write(partial, laz_backend=laz_backend(laspy))


@on_cpu()
def export_npz(path: Path, result: Result) -> None:
    """Writes the arrays points [N, 3], labels [N], colors [N, 3] if any, names [L], segment_names [S], `image:NAME`.

    names are those of the frames, and a segment without a name has "". Images are [H, W]; NAME is the name of the
    frame's file in a result. A result with a confidence also has the arrays confidence [S], of the segments, and
    point_confidence [N].
    """
    arrays = {"points": result.scene.points.numpy(), "labels": result.points.numpy()}
    some = {"colors": result.scene.colors, "confidence": result.confidence, "point_confidence": result.point_confidence}
    arrays |= {name: values.numpy() for name, values in some.items() if values is not None}
    names = [name or f"{index:06d}" for index, name in enumerate(result.names)]
    called = [result.segment_names.get(segment, "") for segment in range(result.num_point_segments)]
    arrays |= {"names": np.array(names, dtype=str), "segment_names": np.array(called, dtype=str)}
    named = zip(frame_files(names), result.images, strict=True)
    arrays |= {f"image:{name}": image.numpy().astype(np.int32) for name, image in named}
    write_archive(path, arrays)
