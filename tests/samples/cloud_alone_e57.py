"""E57: two scans with poses and colours."""

import numpy as np
import pye57

from samples._parts import wall

FORMAT = "cloud_alone"


def write(folder):
    points = np.asarray(wall(), np.float64)
    colors = (np.random.default_rng(0).random(points.shape) * 255).astype(np.uint8)
    with pye57.E57(str(folder / "cloud.e57"), mode="w") as file:
        for place in (0.0, 5.0):
            data = {f"cartesian{axis}": points[:, index] for index, axis in enumerate("XYZ")}
            data |= {f"color{name}": colors[:, index] for index, name in enumerate(("Red", "Green", "Blue"))}
            file.write_scan_raw(data, translation=np.array([place, 0.0, 0.0]))
    return folder / "cloud.e57"
