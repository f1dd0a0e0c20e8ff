"""Writes a small COPC file (https://copc.io): LAZ with an octree of one node. laspy reads COPC, and writes none."""

import struct

import laspy
import numpy as np

#: Of LAS 1.4: sizes of the header, of a record's header and of an extended record's; and the places of two fields.
HEADER, RECORD, EXTENDED, POINTS_AT, EXTENDED_AT = 375, 54, 60, 96, 235


def write_copc(path, cloud):
    """Writes laspy.LasData of point format 6, 7 or 8 with fewer than 50,000 points, which are one chunk of LAZ."""
    cloud.header.vlrs.insert(0, laspy.VLR("copc", 1, "info", bytes(160)))
    cloud.header.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("copc", 1000, "hierarchy", bytes(32))])
    cloud.write(path)
    data = bytearray(path.read_bytes())
    (first,), (extended,) = struct.unpack_from("<I", data, POINTS_AT), struct.unpack_from("<Q", data, EXTENDED_AT)
    (table,) = struct.unpack_from("<q", data, first)  # of the chunks, after the points
    low, high = np.array(cloud.header.mins), np.array(cloud.header.maxs)
    half = float((high - low).max()) / 2
    info = (*(low + half), half, half / 64, extended + EXTENDED, 32, 0.0, 1.0)
    struct.pack_into("<5d2Q2d", data, HEADER + RECORD, *info)
    node = (0, 0, 0, 0, first + 8, table - first - 8, len(cloud.points))
    struct.pack_into("<4iQ2i", data, extended + EXTENDED, *node)
    path.write_bytes(data)
    with laspy.CopcReader.open(path) as reader:
        assert len(reader.query()) == len(cloud.points)
