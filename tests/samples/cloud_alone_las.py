"""LAS 1.4: points with colours, a record with the coordinate system, and an extra dimension, far from the origin."""

import laspy
import numpy as np

from samples._parts import wall

FORMAT = "cloud_alone"
NAME = "cloud.las"


def write(folder, name=NAME):
    points = wall()
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.offsets, header.scales = [691000.0, 5334000.0, 0.0], [0.001] * 3
    header.creation_date = None
    header.add_extra_dim(laspy.ExtraBytesParams("quality", np.float32))
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr('PROJCS["WGS 84 / UTM zone 32N"]'))
    cloud = laspy.LasData(header)
    cloud.xyz = points + header.offsets
    cloud.red, cloud.green, cloud.blue = (np.random.default_rng(0).random((3, len(points))) * 65535).astype(np.uint16)
    cloud["quality"] = np.linspace(0, 1, len(points))
    cloud.write(folder / name)
    return folder / name
