"""Reads E57 files (ASTM E2807) with pye57 and libE57Format: the points of all scans, in the file's world frame.

Scans are moved by their poses. What the scanner marks as invalid, and beams without return, is left out. Colours are
scaled by the limits in the file; there are none if any scan lacks them. Those that are marked as invalid are taken from
the nearest points. The library verifies the checksum of each page.
"""

import math
import re
import struct
import warnings
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
import torch

from torchjoint.datasets.cameras import poses_from_quaternions
from torchjoint.datasets.files.columns import Array, CloudFile, colors_of_all, tell_not_read
from torchjoint.runtime import bounds
from torchjoint.runtime.foreign_files import damage_is, open_file
from torchjoint.runtime.messages import needed_for
from torchjoint.scene.checks import kept_points
from torchjoint.scene.cloud import full_brightness

#: Bytes of a page, of which the last four are a checksum.
PAGE = 1024
#: A document type, the place of a schema, or another encoding, in which these could hide.
_FOREIGN_XML = re.compile(rb"<!(DOCTYPE|ENTITY)|schemaLocation\s*=|\0|\A[^>]*encoding\s*=\s*.(?!utf-8)", re.I)
#: A number of a pose with characters that no number has. The library would read NaN or a text as 0.
_NO_NUMBER = re.compile(rb"<[wxyz]\s[^<>]*>[^<]*[^<\s\d.eE+-]")
_XYZ = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_RGB = ("colorRed", "colorGreen", "colorBlue")
_READ = (*_XYZ, *_SPHERICAL, *_RGB, "cartesianInvalidState", "sphericalInvalidState", "isColorInvalid")
_KNOWN = re.compile("cartesian|spherical|color|isColor|isIntensity|isTimeStamp|intensity|row|column|return|timeStamp")


def read_e57(path: Path) -> CloudFile:
    """Reads a whole file: positions, float64, and colours, if any."""
    _check_xml(path)
    with needed_for("reading .e57", "pye57", "torchjoint[e57]"):
        import pye57
    try:
        with pye57.E57(str(path)) as file:
            counts = [file.get_header(index).point_count for index in range(file.scan_count)]
            if sum(counts) == 0 or min(counts) < 0:
                raise ValueError(f"expected scans with points, got {counts} points")
            bounds.check_points(sum(counts), path.stat().st_size)
            if images := len(file.root["images2D"]) if file.root.isDefined("images2D") else 0:
                warnings.warn(f"{path}: its {images} images are not read, the points are", stacklevel=4)
            scans = [_scan(file, index, f"{path}: scan {index}") for index in range(file.scan_count)]
    except Exception as error:  # the library raises several types of its own
        raise ValueError(f"{path}: not a whole E57 file: {str(error).strip() or type(error).__name__}") from error
    colors = [(str(index), None if rgb is None else torch.from_numpy(rgb)) for index, (_, rgb) in enumerate(scans)]
    points = torch.from_numpy(np.concatenate([xyz for xyz, _ in scans]))
    return CloudFile(points, colors_of_all(colors, str(path), "scans"))


def _check_xml(path: Path) -> None:
    """Checks the part in XML. The library would fetch what it names as its type or schema, also from the network."""
    with open_file(path, "a point cloud, .e57") as stream, damage_is(f"{path}: not a whole E57 file", expat.ExpatError):
        at, size, page = struct.unpack("<24xQQQ", stream.read(48))
        bounds.check(size, min(path.stat().st_size, bounds.JSON_BYTES), "bytes of XML")
        if page != PAGE:
            raise ValueError(f"expected pages of {PAGE} bytes, got {page}")
        stream.seek(at - at % PAGE)
        data = stream.read(PAGE * (size // (PAGE - 4) + 2))
        xml = b"".join(data[first : first + PAGE - 4] for first in range(0, len(data), PAGE))[at % PAGE :][:size]
        if not xml.startswith((b"<", b"\xef\xbb\xbf<")) or _FOREIGN_XML.search(xml):
            raise ValueError("expected XML in UTF-8 without a document type or schema")
        if _NO_NUMBER.search(xml):
            raise ValueError("expected poses of numbers")
        _check_depth(xml)


def _check_depth(xml: bytes) -> None:
    parser, depth = expat.ParserCreate(), 0

    def move(step: int) -> None:
        nonlocal depth
        bounds.check(depth := depth + step, bounds.NESTED, "XML elements in each other")

    parser.StartElementHandler = lambda name, attributes: move(1)
    parser.EndElementHandler = lambda name: move(-1)
    parser.Parse(xml, True)


def _scan(file: Any, index: int, name: str) -> tuple[Array, Array | None]:
    """The valid points of a scan, and their colours; warnings begin with `name`."""
    header = file.get_header(index)
    if not header.point_count:
        return np.empty((0, 3)), np.empty((0, 3), np.float32)
    tell_not_read([field for field in header.point_fields if not _KNOWN.match(field)], name)
    data = _fields(file, header)
    if set(_XYZ) <= set(data):
        own, xyz = "cartesianInvalidState", np.stack([data[field] for field in _XYZ], axis=1)
    else:
        own, (far, azimuth, elevation) = "sphericalInvalidState", (data[field] for field in _SPHERICAL)
        flat = far * np.cos(elevation)
        xyz = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), far * np.sin(elevation)], axis=1)
    kept = data.get(own, np.zeros(len(xyz))) == 0
    kept[kept] = kept_points(torch.from_numpy(xyz[kept]), name, "keep", "drop many").numpy()
    turned, sensor = _pose(header)
    xyz, data = xyz[kept] @ turned.T + sensor, {field: values[kept] for field, values in data.items()}
    if any(field not in data for field in _RGB):
        return xyz, None
    low, high = (np.array([_limit(header, name, end) for name in _RGB]) for end in ("Minimum", "Maximum"))
    rgb = np.stack([data[name] for name in _RGB], axis=1)
    most = float(np.fmax.reduce(rgb, axis=None, initial=0))
    kind = 65535 if (rgb % 1 == 0).all() else None
    # No limits, or those of a narrower or a wider type.
    if not (high > low).all() or most > high.max() or (most <= 255 and full_brightness(most, kind) < high.max()):
        low, high = np.zeros(3), np.full(3, full_brightness(most, kind))
    rgb = ((rgb - low) / (high - low)).clip(0, 1).astype(np.float32)
    rgb[data.get("isColorInvalid", np.zeros(len(rgb))) != 0] = np.nan
    return xyz, rgb


def _fields(file: Any, header: Any) -> dict[str, Array]:
    """What is read of each point, float64. The library's own arrays hold no colours but of 8 bits."""
    from pye57 import libe57

    fields = [field for field in _READ if field in header.point_fields]
    data, buffers = {field: np.empty(header.point_count) for field in fields}, libe57.VectorSourceDestBuffer()
    for field, values in data.items():
        buffers.append(libe57.SourceDestBuffer(file.image_file, field, values, len(values), True, True))
    if (read := header.points.reader(buffers).read()) != header.point_count:
        # The rest of the arrays is whatever the memory held.
        raise ValueError(f"expected {header.point_count} points, got {read}")
    return data


def _pose(header: Any) -> tuple[Array, Array]:
    """The rotation [3, 3] and the place [3] of a scan. Their numbers have names, and may be in any order."""
    turned, place = (
        [header.node["pose"][part][axis].value() for axis in axes] if header.node.isDefined(f"pose/{part}") else none
        for part, axes, none in (("rotation", "xyzw", [0.0, 0.0, 0.0, 1.0]), ("translation", "xyz", [0.0, 0.0, 0.0]))
    )
    pose = poses_from_quaternions(np.array([turned]), np.array([place]), "pose of a scan")[0].numpy()
    return pose[:3, :3], pose[:3, 3]


def _limit(header: Any, name: str, end: str) -> float:
    """A limit of a colour; 0 if the file has none."""
    key = f"colorLimits/{name}{end}"
    value = float(header.node[key].value()) if header.node.isDefined(key) else 0.0
    return value if math.isfinite(value) else 0.0
