"""COLMAP, binary: two images of two camera models, sparse points with tracks, rigs beside them as of version 4."""

import struct

from samples._parts import HEIGHT, WIDTH, wall, write_noise

FORMAT = "colmap"


def write(folder):
    model = folder / "sparse"
    model.mkdir()
    cameras = struct.pack("<QIiQQ8d", 2, 3, 4, WIDTH, HEIGHT, 20.5, 20, 8, 6, 0.05, -0.01, 0.001, 0.002)
    cameras += struct.pack("<IiQQ3d", 1, 0, WIDTH, HEIGHT, 20, 8, 6)
    (model / "cameras.bin").write_bytes(cameras)
    images = struct.pack("<Q", 2)
    for index, camera in enumerate((3, 1)):
        write_noise(folder / "images" / f"{index}.png", index)
        images += struct.pack("<I7dI", 5 - index, 0.8, 0.6, 0, 0, -0.1 * index, 0.5, 0.25, camera)
        images += f"{index}.png".encode() + b"\0" + struct.pack("<Q", index)
        images += struct.pack("<ddq", 4.5, 3.25, -1) * index
    (model / "images.bin").write_bytes(images)
    points = struct.pack("<Q", 40)
    for index, position in enumerate(wall()):
        points += struct.pack("<Q3d3BdQ4i", 7 + index, *position, 115, 121, index, 1.3, 2, 5, 0, 4, 0)
    (model / "points3D.bin").write_bytes(points)
    (model / "rigs.bin").write_bytes(struct.pack("<QIIiI", 1, 1, 1, 0, 1))
    return folder
