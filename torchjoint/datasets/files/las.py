"""Reads LAS, LAZ and COPC files (ASPRS LAS 1.4) with laspy and lazrs, whole or in parts.

A COPC file is a LAZ file whose points are sorted into an octree; its points are read in the order of the file.
laspy and lazrs trust the sizes of a header, and would allocate as much memory as a damaged file declares; so they are
checked against the file before. Coordinates are X, Y, Z x scale + offset, in float64: UTM coordinates have more digits
than float32. Colours have 16 bits. If none is above 255, they are read as 8 bits, because many programs write them so.
If all are 0, there are none.
"""

from __future__ import annotations

import math
import os
import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from torchjoint.datasets.files.binary import BinaryFile
from torchjoint.datasets.files.columns import CloudFile, cloud_of
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import damage_is, present
from torchjoint.runtime.messages import needed_for

SUFFIXES = (".las", ".laz")
COPC = ".copc.laz"
#: Points that are read at a time; a chunk of LAZ has 50,000.
CHUNK = 1_000_000
#: Sizes of the header's fixed part, and of the header of a variable length record, bytes.
HEADER, RECORD = 227, 54
#: Keys of GeoTIFF: the projected system, the geographic one, that of heights; their value if the code is not EPSG's.
PROJECTED, GEOGRAPHIC, VERTICAL, USER_DEFINED = 3072, 2048, 4096, 32767
#: Keys of the kind of coordinates (2: degrees, 3: geocentric) and of the units of lengths and of heights; codes of
#: metres, or none; and the record of WKT.
MODEL, UNITS, METRES, WKT = 1024, (3076, 4099), (0, 9001, USER_DEFINED), ("LASF_Projection", 2112)
#: EPSG's codes in feet: NAD83, its HARN, NAD27, and heights; and every second code of NSRS2007 and NAD83(2011).
_EACH = "2222-2289 2867-2930 26729-26803 32001-32058 3417-3438 3441-3446 3451-3459 6360-6360 8228-8228"
_SECOND = (
    "3479-3487 3490-3512 3515-3553 3582-3590 3598-3600 3608-3636 3640-3664 3668-3676 3677-3679 3680-3682 3686-3692 "
    "3696-3700 6405-6413 6416-6438 6441-6479 6484-6496 6499-6507 6515-6565 6568-6578 6582-6590 6593-6609 6612-6618"
)
_RANGES = ((*map(int, one.split("-")), step) for step, text in ((1, _EACH), (2, _SECOND)) for one in text.split())
IN_FEET = {code for first, last, step in _RANGES for code in range(first, last + 1, step)}
#: In WKT, a unit that is neither an angle nor 1 metre.
_NO_METRE = re.compile(r'\b(LENGTH)?UNIT\["(?![^"]*(deg|grad|rad|gon|arc|dms))[^"]*",(?!\s*1(\.0*)?\s*[],])', re.I)
#: The process that imported this module. One that is forked from it lacks the threads that lazrs waits for.
_PROCESS = os.getpid()
#: Set in the point format's number if the points are compressed.
COMPRESSED = 0x80


class LasPoints(NamedTuple):
    """Some points of a file."""

    xyz: npt.NDArray[np.float64]  #: [n, 3]
    rgb: npt.NDArray[np.uint16] | None  #: [n, 3], as in the file


def read_las(path: Path) -> CloudFile:
    """Reads a whole file: positions, float64, and colours and normals, if any; normals are extra dimensions."""
    with open_las(path) as reader:
        tell_unit(reader, path)
        kind = reader.header.point_format
        names = ["x", "y", "z", *({"red", "green", "blue"} & {*kind.dimension_names}), *kind.extra_dimension_names]
        chunks = [{name: np.asarray(chunk[name]) for name in names} for chunk in las_chunks(reader, path)]
    cloud = cloud_of({name: np.concatenate([chunk[name] for chunk in chunks]) for name in names}, str(path))
    return cloud if cloud.colors is not None and cloud.colors.any() else cloud._replace(colors=None)


def epsg_of(path: Path) -> int | None:
    """The EPSG code of a file's horizontal coordinate system, from its WKT or its GeoTIFF keys; None if it has none."""
    with open_las(path) as reader:
        text, keys = _system(reader)
    # The code of a system stands at its end; codes before it are those of its parts. A compound system may have only
    # one of the whole.
    for one in (re.split(r",\s*VERT", text)[0], text):
        if found := re.search(r'(?:AUTHORITY|ID)\["EPSG",\s*"?(\d+)"?\]\s*\][\s\0]*$', one):
            return int(found[1])
    code = keys.get(PROJECTED, keys.get(GEOGRAPHIC))
    return code if code not in (None, USER_DEFINED) else None


def tell_unit(reader: Any, path: Path) -> bool:
    """Warns if the coordinate system of an open file has no metres, and returns whether; degrees are an error."""
    text, keys = _system(reader)
    if re.match(r'\s*(COMP\w+\["[^"]*",\s*)?GEO\w+\[', text) or keys.get(MODEL) in (2, 3):
        way_out = "`pdal translate IN.laz OUT.laz reprojection --filters.reprojection.out_srs=EPSG:25832` projects it"
        raise ValueError(f"{path}: expected coordinates in metres, got degrees, or geocentric ones; {way_out}")
    has_feet = bool(IN_FEET & {keys.get(PROJECTED), keys.get(VERTICAL)}) or bool(_NO_METRE.search(text))
    if no_metre := has_feet or any(keys.get(unit, 0) not in METRES for unit in UNITS):
        warnings.warn(f"{path}: its coordinate system has feet or other units; taken as metres", stacklevel=4)
    return no_metre


def _system(reader: Any) -> tuple[str, dict[int, int]]:
    """The coordinate system of an open file: WKT, or else empty, and GeoTIFF keys."""
    records = [*reader.header.vlrs, *(reader.evlrs or ())]
    # Not laspy's text: it reads no Latin-1.
    texts = (str(one.record_data_bytes(), "utf-8", "replace") for one in records if (one.user_id, one.record_id) == WKT)
    return next(texts, ""), {key.id: key.value_offset for one in records for key in getattr(one, "geo_keys", ())}


def check_no_copc(out: Path) -> None:
    """Checks that the name of a new file does not promise COPC."""
    if out.name.lower().endswith(COPC):
        told = "COPC is read but not written: it prescribes another order of points (untwine converts a .laz)"
        raise ValueError(f"out: expected a name that ends in .laz, got {out}: {told}")


@contextmanager
def open_las(path: Path, only_places: bool = True) -> Iterator[Any]:
    """Checks the header of a file, then opens the file as a laspy.LasReader.

    Args:
        path: of the file.
        only_places: decompress only coordinates, colours and extra dimensions, if the file's point format allows it.
    """
    laspy = las_library()
    header, kinds = check_header(path), laspy.DecompressionSelection
    if not header.num_points:
        raise ValueError(f"{path}: not a whole LAS file: no points")
    places = kinds.XY_RETURNS_CHANNEL | kinds.Z | kinds.RGB | kinds.ALL_EXTRA_BYTES if only_places else kinds.all()
    with ExitStack() as stack:
        with _clear_errors(path):
            opened = laspy.open(path, decompression_selection=places, laz_backend=laz_backend(laspy))
            reader = stack.enter_context(opened)
            reader.header.point_count = header.num_points  # laspy takes a wide count of 0
            if header.is_compressed:
                _compare_chunks(reader, header, path)
        yield reader


def las_chunks(reader: Any, path: Path, count: int = CHUNK) -> Iterator[Any]:
    """The points of an open file in their order, `count` at a time, as laspy's records."""
    left = reader.header.point_count
    while left > 0:
        with _clear_errors(path):
            chunk = reader.read_points(min(count, left))
            if len(chunk) != min(count, left):
                raise ValueError(f"truncated: {left} points are missing")
        left -= len(chunk)
        yield chunk


def las_points(reader: Any, path: Path, count: int = CHUNK) -> Iterator[LasPoints]:
    """Coordinates and colours of the points of an open file, as :func:`las_chunks`."""
    colored = "red" in set(reader.header.point_format.dimension_names)
    for chunk in las_chunks(reader, path, count):
        xyz = np.stack([chunk.x, chunk.y, chunk.z], axis=1)
        rgb = np.stack([chunk.red, chunk.green, chunk.blue], axis=1) if colored else None
        yield LasPoints(xyz.astype(np.float64, copy=False), rgb)


def las_library() -> Any:
    """The module laspy, with a backend that reads LAZ."""
    with needed_for("reading .las and .laz", "laspy and lazrs", "torchjoint[las]"):
        import laspy
        import lazrs  # noqa: F401
    return laspy


def laz_backend(laspy: Any) -> Any:
    """What packs and unpacks LAZ, for laspy: lazrs, with one thread in a forked process, as of a data loader."""
    return laspy.LazBackend.LazrsParallel if os.getpid() == _PROCESS else laspy.LazBackend.Lazrs


@contextmanager
def _clear_errors(path: Path) -> Iterator[None]:
    """Turns errors of laspy and lazrs, also a panic in Rust, into a ValueError that names the file."""
    try:
        yield
    except BaseException as error:
        if isinstance(error, MemoryError) or not (isinstance(error, Exception) or "Panic" in type(error).__name__):
            raise
        told = error if type(error) is ValueError else f"expected a header and points that laspy reads, got {error!r}"
        raise ValueError(f"{path}: not a whole LAS file: {told}") from error


def _compare_chunks(reader: Any, header: LasHeader, path: Path) -> None:
    """Compares the header's number of points with the chunks'; in formats 0 to 5 the last chunk is read to know it."""
    import lazrs

    record = reader.header.vlrs.get("LasZipVlr")[0].record_data
    kind = lazrs.LazVlr(record)
    with path.open("rb") as stream:
        stream.seek(header.points_at)
        if not (chunks := lazrs.read_chunk_table(stream, kind)):
            raise ValueError(f"truncated: {header.num_points} points in its header, no chunks of points")
        # lazrs makes room for the largest one, and aborts if there is none
        bounds.check_unpacked(max(count for count, _ in chunks) * header.record_size, path.stat().st_size)
        *full, last = chunks
        before = sum(count for count, _ in full)
        low, high = last[0] if kind.uses_variable_size_chunks() else 1, last[0]
        stream.seek(header.points_at + 8 + sum(size for _, size in full))
        data = stream.read(min(last[1], path.stat().st_size))
    if low == 1 and reader.header.point_format.id >= 6:  # the number stands behind the first point
        low = high = int.from_bytes(data[header.record_size : header.record_size + 4], "little")
    elif low < (count := header.num_points - before) <= high:
        with suppress(lazrs.LazrsError):  # without the last bytes of a chunk its last point cannot be read
            one = np.empty(count * header.record_size, np.uint8)
            lazrs.decompress_points_with_chunk_table(data[:-4], record, one, [(count, len(data) - 4)])
            low = count + 1
    if header.num_points > before + high:
        raise ValueError(f"truncated: {header.num_points} points in its header, {before + high} in its chunks")
    if (rest := before + low - header.num_points) > 0:
        told = f"{path}: at least {rest} points behind the {header.num_points} of its header are not read"
        warnings.warn(told, stacklevel=6)


class LasHeader(NamedTuple):
    """The values of a header that the checks need."""

    size: int  #: bytes of its fixed part
    points_at: int  #: byte of the first point
    num_records: int  #: variable length records, between header and points
    record_size: int  #: bytes of a point, not compressed
    num_points: int
    is_compressed: bool
    extended_at: int  #: byte of the first extended record
    num_extended: int


def check_header(path: Path) -> LasHeader:
    """Reads and checks the header of a file."""
    present(path, "a point cloud, .las or .laz")
    with BinaryFile(path, "its header") as file, damage_is(f"{path}: not a whole LAS file"):
        size = file.size
        header = _parse(file.read(f"{min(size, 375)}s")[0])
        end = header.extended_at if header.num_extended else size
        _skip_records(file, header.size, header.num_records, "H")
        if not file.place <= header.points_at <= size:
            raise ValueError(f"the points begin at byte {header.points_at}, records before them end at {file.place}")
        _skip_records(file, header.extended_at, header.num_extended, "Q")
        if not header.num_points:
            return header
        if header.is_compressed:
            bounds.check_points(header.num_points, size)
            bounds.check_unpacked(header.num_points * header.record_size, size)
            _check_chunks(file, header)
        elif header.num_points * header.record_size > size - header.points_at:
            told = f"truncated: {header.num_points} points take {header.num_points * header.record_size} bytes"
            raise ValueError(f"{told}, got {size - header.points_at}")
        elif (rest := end - header.points_at - header.num_points * header.record_size) >= header.record_size:
            told = f"{path}: {rest} bytes behind the {header.num_points} points of its header are not read"
            warnings.warn(told, stacklevel=3)
    return header


def _parse(head: bytes) -> LasHeader:
    if len(head) < HEADER or head[:4] != b"LASF":
        raise ValueError(f"expected a header of {HEADER} bytes that starts with LASF, got {head[:4]!r}")
    version = head[24:26]
    if version[0] != 1 or version[1] > 5:
        raise ValueError(f"expected version 1.0 to 1.5, got {version[0]}.{version[1]}")
    size, points_at, num_records, kind, record_size, num_points = struct.unpack_from("<HIIBHI", head, 94)
    extended_at = num_extended = 0
    if version[1] >= 4:
        extended_at, num_extended, wide = struct.unpack_from("<QIQ", head, 235)
        num_points = wide or num_points
    if size < HEADER or points_at < size + RECORD * num_records:
        raise ValueError(f"the points begin at byte {points_at}, inside a header with {num_records} records")
    if record_size < 20:
        raise ValueError(f"expected points of at least 20 bytes, got {record_size}")
    places = struct.unpack_from("<6d", head, 131)
    if not all(map(math.isfinite, places)) or 0 in places[:3]:
        raise ValueError(f"expected finite scales other than 0 and finite offsets, got {places}")
    compressed = bool(kind & COMPRESSED)
    return LasHeader(size, points_at, num_records, record_size, num_points, compressed, extended_at, num_extended)


def _skip_records(file: BinaryFile, place: int, count: int, length: str) -> None:
    """Skips records, which must lie in the file: 20 bytes, the length of their content, a text of 32 bytes, content."""
    file.place = place
    for _ in range(count):
        file.skip(20)
        file.skip(32 + file.read(length)[0])


def _check_chunks(file: BinaryFile, header: LasHeader) -> None:
    """Checks the number of chunks: each starts with an uncompressed point, so the file bounds their number."""
    file.place = header.points_at
    (table_at,) = file.read("q")
    if table_at == -1:  # a file that was written to a pipe: the position is at the end
        file.place = file.size - 8
        (table_at,) = file.read("q")
    if not header.points_at < table_at <= file.size - 8:
        raise ValueError(f"truncated: expected the table of chunks at byte {table_at}, got {file.size} bytes")
    file.place = table_at
    _, num_chunks = file.read("II")
    if num_chunks * header.record_size > table_at - header.points_at:
        raise ValueError(f"{num_chunks} chunks do not fit into {table_at - header.points_at} bytes")
