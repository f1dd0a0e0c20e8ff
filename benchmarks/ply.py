"""Times reading PLY files, against Open3D's two readers: points with colours, ascii and binary, and a mesh.

    python benchmarks/ply.py --points 1000000
    python benchmarks/ply.py --points 10000000 --no-meshes

The files are written by Open3D (ascii: six digits), and once with the 17 digits of a double. All readers run in one
thread, in turn; their points are compared first. The ratio is the time of the faster one of Open3D's over ours.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

import numpy as np
import open3d as o3d
import report
import torch
from interleaved import medians

from torchjoint.datasets.files.ply import read_ply

MESHES = ("mesh, ascii", "mesh, binary")
#: Points of the file with 17 digits, which is written slowly.
MOST_PRECISE = 1_000_000


def write_files(folder: Path, num_points: int, meshes: bool = True) -> dict[str, Path]:
    rng = np.random.default_rng(0)
    cloud = o3d.t.geometry.PointCloud()
    points = rng.uniform(-10, 10, (num_points, 3))
    cloud.point.positions = o3d.core.Tensor(points.astype(np.float32))
    cloud.point.colors = o3d.core.Tensor(rng.integers(0, 256, (num_points, 3), dtype=np.uint8))
    files = {name: folder / f"{name}.ply" for name in ("ascii", "binary", *MESHES * meshes)}
    triangles = rng.integers(0, num_points, (2 * num_points, 3), dtype=np.int32)
    mesh = o3d.t.geometry.TriangleMesh(cloud.point.positions, o3d.core.Tensor(triangles))
    for name, file in files.items():
        if name.startswith("mesh"):
            o3d.t.io.write_triangle_mesh(str(file), mesh, write_ascii="ascii" in name)
        else:
            o3d.t.io.write_point_cloud(str(file), cloud, write_ascii=name == "ascii")
    if num_points <= MOST_PRECISE:
        files["ascii, 17 digits"] = folder / "precise.ply"
        lines = ["ply", "format ascii 1.0", f"element vertex {num_points}"]
        lines += [*(f"property double {axis}" for axis in "xyz"), "end_header"]
        np.savetxt(folder / "precise.ply", points, fmt="%.17g", header="\n".join(lines), comments="")
    return files


def readers(name: str, file: Path) -> dict[str, Callable[[], object]]:
    if name.startswith("mesh"):
        return {
            "torchjoint": partial(read_ply, file),
            "Open3D": partial(o3d.io.read_triangle_mesh, str(file)),
            "Open3D's tensors": partial(o3d.t.io.read_triangle_mesh, str(file)),
        }
    return {
        "torchjoint": partial(read_ply, file),
        "Open3D": partial(o3d.io.read_point_cloud, str(file)),
        "Open3D's tensors": partial(o3d.t.io.read_point_cloud, str(file)),
    }


def points_of(read: object) -> np.ndarray:
    if isinstance(read, tuple):  # ours
        return read[0].numpy()
    if isinstance(read, (o3d.geometry.PointCloud, o3d.geometry.TriangleMesh)):
        return np.asarray(read.points if isinstance(read, o3d.geometry.PointCloud) else read.vertices)
    return (read.point if isinstance(read, o3d.t.geometry.PointCloud) else read.vertex).positions.numpy()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[1_000_000])
    parser.add_argument("--seconds", type=float, default=5.0, help="for each file, at least three rounds")
    parser.add_argument("--no-meshes", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for num_points in arguments.points:
        with tempfile.TemporaryDirectory() as folder:
            for name, file in write_files(Path(folder), num_points, not arguments.no_meshes).items():
                functions = readers(name, file)
                expected = points_of(functions["torchjoint"]())
                for function in functions.values():
                    np.testing.assert_allclose(points_of(function()), expected, rtol=1e-6, atol=1e-7)
                times = medians(functions, arguments.seconds)
                ratio = min(times["Open3D"], times["Open3D's tensors"]) / times["torchjoint"]
                rows.append([f"{num_points:,}, {name}", *times.values(), ratio])
                print(rows[-1], flush=True)
    columns = {"points, file": 0, "torchjoint, ms": 0, "Open3D, ms": 0, "Open3D's tensors, ms": 0}
    name = "ply_large" if min(arguments.points) > MOST_PRECISE else "ply"
    report.save(name, [report.Table(columns | {"Open3D / torchjoint": 1}, rows)])


if __name__ == "__main__":
    main()
