"""Puts the labels of a result into the file of a cloud, a survey, a mesh or Gaussian splats (output after step 8).

Each vertex, and each face at its centre, gets the label of the nearest point of the result. So the file may have more
vertices than the result has points: those that were thinned out, faint splats, the corners of large triangles.
"""

import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torchjoint.datasets.files import las, meshes, text_clouds
from torchjoint.datasets.files.clouds import read_cloud_file
from torchjoint.datasets.files.columns import CloudFile
from torchjoint.datasets.files.las import las_chunks, las_library, laz_backend, open_las
from torchjoint.datasets.files.ply import PlyRecords, read_records, write_bytes, write_cloud
from torchjoint.datasets.files.readers import unchanged
from torchjoint.results.render import label_colors
from torchjoint.results.result import Result
from torchjoint.results.upright import up_direction
from torchjoint.runtime.files import portable_name
from torchjoint.runtime.foreign_files import damage_is
from torchjoint.runtime.groups import with_none
from torchjoint.runtime.messages import needed_for
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene.checks import without_return

#: Of columns that are not read; they stay in the file.
KEPT = ".*(: no position, normal or colour by these names|the rest is left out|counts the rows)"
#: Records that describe how a file stores its points; they do not fit the copy, which stores them in another way.
_STORAGE = ("LasZipVlr", "CopcInfoVlr", "CopcHierarchyVlr")


#: The longest name of a dimension, bytes, and what is said of those that are added.
LONGEST, ORIGIN = 32, "of torchjoint"


def check_dimension(path: Path, name: str, way_out: str = "remove it first") -> None:
    """Checks that a file can get a dimension: its name fits, and it is not there yet."""
    if len(name.encode()) > LONGEST:
        raise ValueError(f"--name: expected at most {LONGEST} bytes for a dimension of {path.name}, got {name}")
    with open_las(path) as reader:
        if name in {*reader.header.point_format.dimension_names, *"xyz"}:
            raise ValueError(f"{path}: expected no dimension {name}, got one; {way_out}")
        most = max((one.num_elements for one in reader.header.point_format.extra_dimensions), default=0)
        if most > 7:  # laspy writes this number where it looks for marks of a scale and an offset, 8 and 16
            told = f"expected at most 7 undocumented bytes behind each point, got {most}"
            raise ValueError(f"{path}: {told}; `pdal translate` leaves them out")


def write_labelled(
    path: Path,
    out: Path,
    columns: Mapping[str, npt.NDArray[Any]],
    progress: Callable[[int], object] = lambda count: None,
) -> int:
    """Copies a file, with all dimensions and records (such as the coordinate system), in the same order.

    Args:
        path: .las or .laz. A .copc.laz becomes a plain .laz: its points keep their order, but lose the octree.
        out: .las or .laz; the suffix determines the format.
        columns: new dimensions by name: [N or more] numbers; they may be mapped from disk.
        progress: is called with the number of points of each part.

    Returns:
        N, the number of points.
    """
    laspy, done = las_library(), 0
    with open_las(path, only_places=False) as reader:
        header = _header(laspy, reader.header, columns)
        packed, backend = out.suffix.lower() == ".laz", laz_backend(laspy)
        with _disk_errors(out), laspy.open(out, "w", laz_backend=backend, header=header, do_compress=packed) as writer:
            for chunk in las_chunks(reader, path):
                # lazrs 0.8 packs these wrongly.
                if packed and header.point_format.id in (9, 10) and np.unique(chunk.scanner_channel).size > 1:
                    raise ValueError(f"{path}: LAZ loses waveforms of several scanner channels; give -o OUT.las")
                record = laspy.ScaleAwarePointRecord.zeros(len(chunk), header=writer.header)
                for name in chunk.array.dtype.names:  # the stored numbers, not scaled coordinates: an exact copy
                    record.array[name] = chunk.array[name]
                for name, values in columns.items():
                    record.array[name] = values[done : done + len(chunk)]
                writer.write_points(record)
                done += len(chunk)
                progress(len(chunk))
            if extended := [record for record in reader.evlrs or () if type(record).__name__ not in _STORAGE]:
                writer.write_evlrs(laspy.vlrs.vlrlist.VLRList(extended))
            if waves := reader.header.start_of_waveform_data_packet_record:  # one of these records; LAS 1.3 has none
                moved = writer.header.start_of_first_evlr - reader.header.start_of_first_evlr
                writer.header.start_of_waveform_data_packet_record = waves + moved if extended else 0
    return done


@contextmanager
def _disk_errors(out: Path) -> Iterator[None]:
    """Turns the error of lazrs that it cannot write, which does not say why, into one that names the file."""
    import lazrs

    try:
        yield
    except lazrs.LazrsError as error:
        raise OSError(f"{out}: cannot be written ({error}); is the disk full?") from error


def _header(laspy: Any, given: Any, columns: Mapping[str, npt.NDArray[Any]]) -> Any:
    header = deepcopy(given)
    header.vlrs = [record for record in header.vlrs if type(record).__name__ not in _STORAGE]
    header.evlrs = None
    if header.version.minor == 0:  # laspy writes from 1.1 on
        header.version = laspy.header.Version(1, 2)
    add_dimensions(laspy, header, columns, b"".join(one.record_data_bytes() for one in given.vlrs.get("ExtraBytesVlr")))
    return header


def add_dimensions(laspy: Any, header: Any, columns: Mapping[str, npt.NDArray[Any]], known: bytes = b"") -> None:
    """Adds dimensions to a header, whose record of them begins with `known`, and which laspy does not change then.

    laspy forgets which value stands for none, and takes the value of the first point for the least and largest.
    """
    header.add_extra_dims([laspy.ExtraBytesParams(name, one.dtype, ORIGIN) for name, one in columns.items()])
    (record,) = header.vlrs.extract("ExtraBytesVlr")
    for one in record.extra_bytes_structs[len(known) // 192 :]:
        # 192 bytes; 4: marks of what is given, or the number of undocumented bytes; 64 to 112: the range.
        data = bytes(one)
        known += data if not one.data_type else data[:3] + bytes(1) + data[4:64] + bytes(48) + data[112:]
    header.vlrs.append(laspy.VLR("LASF_Spec", record.official_record_ids()[0], record.description, known))


#: If half of the vertices are farther from the result than this share of its diagonal, the file is of another place.
FAR = 0.25
#: Vertices farther than so many times the distance between neighbours of the result may have moved.
AWAY = 4
#: Vertices farther than this share of the diagonal were not segmented.
ALONE = 0.05


def nearest_labels(result: Result, points: Tensor) -> Tensor:
    """The label [M] int64 of the result's point nearest to each of M points; -1 where a point is not finite.

    Arguments and errors as of :func:`nearest_points`.
    """
    return with_none(result.points)[nearest_points(result, points)]


def nearest_points(result: Result, points: Tensor) -> Tensor:
    """The result's point nearest to each of these points.

    Args:
        result: a result.
        points: [M, 3] metres, in the frame of the result's cloud.

    Returns:
        [M] int64, their numbers; -1 where a point is not finite, or a beam without return.
    """
    own, finite = result.scene.points, points.isfinite().all(1)
    if not bool(without_return(own).any()):
        finite &= ~without_return(points)
    if points.shape == own.shape and torch.equal(points.double(), own.double()):
        return torch.arange(len(own))
    from scipy.spatial import cKDTree

    tree = cKDTree(own.double().numpy())
    distance, index = tree.query(points[finite].double().numpy(), workers=-1)
    spacing = np.median(tree.query(tree.data[:: len(own) // 2000 + 1], 2)[0][:, 1])  # 0: most points are copies
    diagonal = float((own.double().amax(0) - own.double().amin(0)).norm())
    middle = np.median(distance) if len(distance) else np.inf  # no vertex is finite
    near = AWAY * spacing / (2 if len(points) == len(own) else 1)  # as many: then it is the same cloud
    if middle > FAR * diagonal or bool((distance > max(AWAY * spacing, ALONE * diagonal)).all()):
        told = f"expected vertices near the result's points, got half of them farther than {middle:.3g} m"
        raise ValueError(f"{told}; is the file of another place, or in another frame?")
    for limit, share in ((near / 2, 0.5), (near, 0.1), (max(near, ALONE * diagonal), 0.05)):
        if limit > 0 and (lost := int((distance > limit).sum())) > share * len(distance):
            far = f"{lost} of {len(points)} vertices are farther than {limit:.3g} m from the result, whose points"
            warnings.warn(f"{far} are {spacing:.2g} m apart; was it moved, or a part segmented?", stacklevel=3)
            break
    return torch.full((len(points),), -1).masked_scatter(finite, torch.from_numpy(index))


def _label_text(source: Path, out: Path, result: Result, name: str) -> None:
    points = _read(source).points
    with damage_is(str(source)):
        nearest = nearest_labels(result, points)
    write_bytes(out, text_clouds.with_column(source, name, nearest.tolist(), out))


def _label_survey(source: Path, out: Path, result: Result, name: str) -> None:
    las.check_no_copc(out)
    sure = result.point_confidence
    with open_las(source) as reader:
        is_taken = "confidence" in reader.header.point_format.dimension_names
    sureness = f"{name}_confidence" if is_taken or name != "label" else "confidence"
    for one in [name] if sure is None else [name, sureness]:
        check_dimension(source, one, "remove it first, or choose a name: `torchjoint label ... --name NAME`")
    points = _read(source).points
    with damage_is(str(source)):
        nearest = nearest_points(result, points)
    columns = {name: with_none(result.points)[nearest].int().numpy()}
    if sure is not None:
        columns[sureness] = torch.cat([sure, sure.new_zeros(1)])[nearest].float().numpy()
    write_labelled(source, out, columns)


@on_cpu()
def label_file(source: Path, out: Path, result: Result, *, name: str = "label") -> None:
    """Writes a file of vertices again, with a label for each vertex and each face.

    * A .ply as OUT.ply is the same file, with one more property, int `name`; every other byte stays. Its faces also
      have the property if all are triangles.
    * Another mesh as OUT.ply has positions, colours, triangles and labels.
    * OUT.glb is the mesh in the colours of the segments, with a node for each, which has the segment's name.
    * Text is the same text, with one more column `name`.
    * A .las or .laz as OUT.las or OUT.laz is the same file, with the dimension `name` (int32), and
      `NAME_confidence` (float32; of `label` just `confidence`, if that is free), if the result has one. Coordinate
      system, records and all other dimensions stay.

    Args:
        source: a .ply, .obj, .glb, .gltf, .off, .stl, .las, .laz or text file in the frame of the result's cloud.
        out: a .ply, .glb, .las, .laz or text file.
        result: the result.
        name: of the property.
    """
    writers = {las.SUFFIXES: _label_survey, text_clouds.SUFFIXES: _label_text, (".ply", ".glb"): _label_mesh}
    *others, last = writers
    kinds = next((one for one in others if _check_kind(source) in one), last)
    if out.suffix.lower() not in kinds:
        raise ValueError(f"{out}: expected {' or '.join(kinds)} for {source.name}")
    with unchanged(source):  # it is read twice, and the labels are those of the first
        writers[kinds](source, out, result, name)


def _label_mesh(source: Path, out: Path, result: Result, name: str) -> None:
    mesh = _read(source)
    with damage_is(str(source)):
        of_vertex = nearest_labels(result, mesh.points)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", r"\d+ of \d+ vertices are farther")  # it has been told
            of_face = None if mesh.faces is None else nearest_labels(result, mesh.points[mesh.faces].double().mean(1))
        if out.suffix.lower() == ".glb":
            _write_glb(out, mesh, of_face, result)
            return
        records, labels = _records(source, mesh), {"vertex": of_vertex.numpy()}
        if of_face is not None and len(records.records.get("face", ())) == len(of_face):
            labels["face"] = of_face.numpy()
        write_bytes(out, records.with_labels(name, labels))


@on_cpu()
def part_files(source: Path, folder: Path, result: Result) -> None:
    """Writes a .ply for each segment: its vertices, with all properties of a .ply, and the triangles between them.

    Args:
        source: as for :func:`label_file`.
        folder: a new folder, for files 000000.ply, or 000000-NAME.ply, by label.
        result: the result.
    """
    if _check_kind(source) in (*las.SUFFIXES, *text_clouds.SUFFIXES):
        told = f"give -o {folder.name}{source.suffix}, or write parts with `torchjoint export RESULT --format ply`"
        raise ValueError(f"{source}: expected a mesh or a .ply, for a folder of parts; {told}")
    with unchanged(source):
        mesh = _read(source)
        parts = _records(source, mesh)
    folder.mkdir()
    with damage_is(str(source)):
        of_vertex = nearest_labels(result, mesh.points)
        for segment in of_vertex[of_vertex >= 0].unique().tolist():
            faces = mesh.chosen(which := of_vertex == segment).faces
            content = parts.some_vertices(which.numpy(), None if faces is None else faces.numpy())
            (folder / f"{file_stem(segment, result)}.ply").write_bytes(content)


def _check_kind(source: Path) -> str:
    """The suffix of a file that can have labels; an error for all else."""
    suffix, kinds = source.suffix.lower(), (".ply", *las.SUFFIXES, *meshes.SUFFIXES, *text_clouds.SUFFIXES)
    if suffix not in kinds:
        told = "files of a folder one by one; labels of other clouds: `torchjoint export RESULT --format las` or `ply`"
        raise ValueError(f"{source}: expected a file that ends in {', '.join(kinds)}; {told}")
    return suffix


def _read(source: Path) -> CloudFile:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", KEPT)
        return read_cloud_file(source, invalid="keep")


def file_stem(segment: int, result: Result) -> str:
    """The name of the file of a segment, without suffix."""
    name = result.segment_names.get(segment)
    return f"{segment:06d}" if name is None else portable_name(f"{segment:06d}-{name}")


def _records(source: Path, mesh: CloudFile) -> PlyRecords:
    """The records of a .ply, or those that another mesh has as a .ply."""
    if source.suffix.lower() == ".ply":
        return read_records(source)
    with tempfile.TemporaryDirectory() as temporary:
        write_cloud(Path(temporary) / "mesh.ply", mesh.points, mesh.colors, faces=mesh.faces)
        return read_records(Path(temporary) / "mesh.ply")


def _write_glb(out: Path, mesh: CloudFile, of_face: Tensor | None, result: Result) -> None:
    if mesh.faces is None or of_face is None:
        raise ValueError("expected a mesh with faces, for a .glb, got vertices only")
    with needed_for(".glb files", "trimesh", "torchjoint[mesh]"):
        import trimesh
    scene, place = trimesh.Scene(), np.eye(4)
    # A .glb has float32 for vertices, which is too coarse for places in surveys, but not for those of nodes.
    place[:3, 3] = origin = mesh.points.double().mean(0).numpy().round(-3)
    for segment in of_face.unique().tolist():
        corners, faces = mesh.faces[of_face == segment].unique(return_inverse=True)
        color = (label_colors(torch.tensor([segment])) * 255).round().to(torch.uint8).expand(len(corners), 3)
        vertices = mesh.points[corners].numpy() - origin
        part = trimesh.Trimesh(vertices, faces.numpy(), vertex_colors=color.numpy(), process=False, validate=False)
        scene.add_geometry(part, file_stem(segment, result), file_stem(segment, result), transform=place)
    scene.metadata["up"] = up_direction(result.scene).tolist()  # for the viewer; the coordinates are those of the file
    write_bytes(out, scene.export(file_type="glb"))
