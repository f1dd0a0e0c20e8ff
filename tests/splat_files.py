"""Gaussian splats as the reference program writes them (Kerbl et al. 2023), from a cloud."""

import numpy as np

NAMES = ("x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(45)))
NAMES += ("opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4)))


def splat_rows(points, colors, opacity, rng):
    """[N] records of float32; the opacity is given after the sigmoid."""
    rows = np.zeros(len(points), dtype=[(name, "<f4") for name in NAMES])
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis]
        rows[f"f_dc_{axis}"] = (colors[:, axis] - 0.5) * 2 * np.sqrt(np.pi)
        rows[f"scale_{axis}"] = np.log(0.01)
    for index in range(45):
        rows[f"f_rest_{index}"] = rng.normal(0, 0.05, len(points))
    rows["opacity"] = np.log(opacity / (1 - opacity))
    rows["rot_0"] = 1
    return rows


def splat_file(path, rows):
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    lines += [f"property float {name}" for name in rows.dtype.names]
    path.write_bytes("\n".join([*lines, "end_header\n"]).encode() + rows.tobytes())
    return path
