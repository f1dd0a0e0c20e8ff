"""ARKitScenes: two frames that look along y, the mesh, and a box around half of it."""

import json

import numpy as np
from scipy.spatial.transform import Rotation

from samples._parts import ALONG_Y, HEIGHT, WIDTH, wall_along_y, write_depth, write_noise, write_ply


def write(folder):
    scan = folder / "40753679"
    frames, lines = scan / "40753679_frames", []
    for index, time in enumerate((6791.523, 6791.623)):
        name = f"40753679_{time:.3f}"
        write_noise(frames / "lowres_wide" / f"{name}.png", index)
        write_depth(frames / "lowres_depth" / f"{name}.png", 2000)
        (frames / "lowres_wide_intrinsics").mkdir(exist_ok=True)
        shifted = f"40753679_{time + 0.001 * index:.3f}.pincam"
        (frames / "lowres_wide_intrinsics" / shifted).write_text(f"{WIDTH} {HEIGHT} 14.0 14.0 7.5 5.5\n")
        center = np.array([0.1 * index, 0, 0])
        numbers = [time, *Rotation.from_matrix(ALONG_Y).as_rotvec(), *(-ALONG_Y @ center)]
        lines.append(" ".join(f"{value:.9g}" for value in numbers))
    (frames / "lowres_wide.traj").write_text("\n".join(lines) + "\n")
    write_ply(scan / "40753679_3dod_mesh.ply", wall_along_y())
    turned = Rotation.from_euler("z", 30, degrees=True).as_matrix()  # one axis a row
    box = {"centroid": [0.5, 2.0, 0.0], "axesLengths": [1.0, 1.0, 2.0], "normalizedAxes": turned.flatten().tolist()}
    record = {"data": [{"uid": "a", "label": "cabinet", "segments": {"obbAligned": box}}], "skipped": False}
    (scan / "40753679_3dod_annotation.json").write_text(json.dumps(record))
    return scan
