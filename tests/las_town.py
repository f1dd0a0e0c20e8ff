"""A small town as a LAS file, far from the origin."""

import laspy
import numpy as np

#: UTM: float32 keeps half a metre of the northing.
ORIGIN = np.array([691_000.0, 5_334_000.0, 500.0])
#: Their coordinate system.
WKT = 'PROJCS["WGS 84 / UTM zone 32N",UNIT["metre",1,AUTHORITY["EPSG","9001"]],AUTHORITY["EPSG","32632"]]'


def town(num_points, side, seed=0):
    """A floor with boxes on it, some of which the edges of tiles cross; points in random order."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, side, (2, num_points))
    z = np.zeros(num_points)
    for column in range(int(side // 5)):
        for row in range(int(side // 5)):
            inside = (abs(x - 5 * column - 2) < 1.2) & (abs(y - 5 * row - 3) < 1.5)
            z[inside] = 0.6 + 0.2 * ((column + row) % 3)
            edge = inside & (rng.random(num_points) < 0.4)  # some of these points stand on the sides
            x[edge] = 5 * column + 2 + 1.2 * np.where(x[edge] < 5 * column + 2, -1, 1)
            z[edge] *= rng.random(edge.sum())
    return np.stack([x, y, z], 1) + rng.normal(0, 0.002, (num_points, 3))


def write_las(path, points, seed=0):
    """A file with colours, another program's dimension, times, and a coordinate system."""
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.offsets, header.scales = ORIGIN, [0.001] * 3
    header.add_extra_dim(laspy.ExtraBytesParams("quality", np.int16))
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(WKT))
    cloud, rng = laspy.LasData(header), np.random.default_rng(seed)
    cloud.xyz = points + ORIGIN
    cloud.red = cloud.green = cloud.blue = np.full(len(points), 30000, np.uint16)
    cloud.gps_time, cloud["quality"] = rng.random(len(points)), rng.integers(-9, 9, len(points))
    cloud.classification = rng.integers(0, 32, len(points))
    cloud.write(path)
    return path
