"""An organised, compressed PCD: a slanted wall, a table's and an object's labels, some pixels without depth."""

import numpy as np
from pcd_files import write_pcd

from samples._parts import HEIGHT, WIDTH


def write(folder):
    row, column = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    z = (2 + 0.01 * column).astype(np.float32)
    x, y = ((column - 7.5) * z / 20).astype(np.float32), ((row - 5.5) * z / 20).astype(np.float32)
    label = np.where(column < 8, 1, 20).astype(np.uint32)
    for values in (x, y, z):
        values[2:4, 3:6] = np.nan
    label[2:4, 3:6] = 0
    rgba = np.random.default_rng(0).integers(0, 1 << 24, (HEIGHT, WIDTH), dtype=np.uint32)
    fields = {"label": label, "x": x, "y": y, "z": z, "rgba": rgba}
    flat = {name: values.ravel() for name, values in fields.items()}
    return write_pcd(folder / "scene.pcd", flat, data="binary_compressed", width=WIDTH, height=HEIGHT)
