"""torchjoint superpoints: segments the cloud of a file into superpoints; writes labels and a picture."""

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from torch import Tensor

from torchjoint.cli.arguments import OptionalOut, output_file
from torchjoint.config import SuperpointsConfig, read_assignment
from torchjoint.datasets.files.clouds import read_cloud_file, up_of
from torchjoint.datasets.files.columns import CloudFile
from torchjoint.datasets.files.las import SUFFIXES
from torchjoint.datasets.files.ply import read_records, write_bytes, write_cloud
from torchjoint.datasets.files.readers import unchanged
from torchjoint.oversegmentation import superpoints as segment
from torchjoint.results.figures import cloud_figure
from torchjoint.results.render import label_colors
from torchjoint.runtime.foreign_files import damage_is, present
from torchjoint.runtime.messages import counted, say
from torchjoint.scene import Scene
from torchjoint.scene.checks import kept_points
from torchjoint.tiles import superpoints_of_files
from torchjoint.tiles.run import is_las

#: Name of the labels in a .ply, as in a .las.
NAME = "superpoint"


def superpoints(
    cloud: tyro.conf.Positional[Path],
    out: OptionalOut = None,
    preset: str = "default",
    set: tuple[str, ...] = (),
    viewpoint: tuple[float, float, float] | None = None,
    columns: str | None = None,
    drop_invalid: bool = False,
    picture: bool = True,
    overwrite: bool = False,
    tile: float | None = None,
    buffer: float | None = None,
    engine: str | None = None,
) -> None:
    """Segments a cloud into superpoints. LAS and LAZ files may have any size: see docs/large.md.

    Args:
        cloud: .ply, .pcd, .npy, .npz, .bin (KITTI), .pcd.bin (nuScenes), .xyz, .txt, .asc, .csv, .pts, .las, .laz or
            .e57 file, or a folder of .las and .laz files. Preset segmentator uses the triangles of a mesh, .ply, .obj,
            .glb, .gltf, .off or .stl.
        out: file for the result; default: CLOUD-superpoints.ply in the current folder. A .ply, .las or .laz has
            all data of a cloud's file of its kind, and a property or dimension `superpoint`; of other clouds a .ply has
            points, a colour for each superpoint, the triangles of a mesh. A .npy has the labels, int64, in the order
            of `tj.datasets.load_cloud`. A .npz has the arrays points, labels, and, if there are any, colors and faces.
            .laz is the default for .las and .laz clouds, which are needed for it. For a folder, OUT is a folder.
        preset: default, scan or segmentator, or a YAML file of your own.
        set: single parameters: --set scale=2 color_weight=0.5; `torchjoint parameters --superpoints` lists them.
        viewpoint: x y z of the sensor, metres; normals then point outward, so that convex and concave edges differ.
        columns: numbers per point in a .bin file; default: 4, or 5 for .pcd.bin. Or a letter for each column of a .bin,
            .npy, .xyz or .txt file: x y z, r g b, nnn (a normal), any other to leave it out: xyzrgbl.
        drop_invalid: leave out the points that are NaN or infinite, and tell their number; in a .npy, or a
            .ply of a .ply, they are -1. Else they are an error.
        picture: OUT.png, a picture of the cloud and its superpoints, stands next to OUT (not if OUT is .las or
            .laz), unless this is given.
        overwrite: replace existing files.
        tile: side of a tile of a .las or .laz, metres; default: the largest tile with at most 2 million points.
        buffer: width of the rim that a tile shares with its neighbours, metres; default: 60 x the typical distance of
            neighbouring points.
        engine: where tiles are segmented: loky (this machine, the default; loky:2: two workers), dask, dask://HOST:PORT,
            ray, ray://HOST:PORT. The workers must be able to access the folder of OUT.
    """
    config = SuperpointsConfig.from_preset(preset).set(set)
    if is_las(cloud) and (out is None or cloud.is_dir() or out.suffix.lower() in SUFFIXES):
        if viewpoint is not None or columns is not None or "convex_factor" in dict(map(read_assignment, set)):
            raise ValueError(f"{cloud}: expected no --viewpoint, --columns or convex_factor in tiles; or write .ply")
        out = out or Path(f"{cloud.stem}-superpoints{'' if cloud.is_dir() else '.laz'}")
        in_tiles = partial(superpoints_of_files, engine=engine or "loky", progress=sys.stderr.isatty())
        cut = in_tiles(cloud, out, tile=tile, buffer=buffer, preset=config, overwrite=overwrite)
        found = counted(cut.num_superpoints, "superpoint")
        say(f"{cut.num_points} points in {found}, {counted(cut.num_tiles, 'tile')}: {out}")
        return
    for name, value in (("--tile", tile), ("--buffer", buffer), ("--engine", engine)):
        if value is not None:
            raise ValueError(f"{name}: expected a .las or .laz cloud and result, got {cloud} and {out}")
    out = out or Path(f"{cloud.stem}-superpoints.ply")
    png = out.with_name(f"{out.name}.png")
    if cloud.is_dir():
        raise ValueError(f"{cloud}: expected a file, or a folder of .las and .laz files; other files one by one")
    present(cloud, "a point cloud")
    if out.suffix not in (".ply", ".npy", ".npz"):
        more = ", .las, .laz" if is_las(cloud) else ""
        raise ValueError(f"-o: expected a file that ends in .ply{more}, .npy or .npz, got {out}")
    made = output_file(out, overwrite, (cloud,))
    pictured = output_file(png, overwrite, (cloud,)) if picture else None
    with unchanged(cloud):
        read = read_cloud_file(cloud, int(columns) if columns and columns.isdecimal() else columns, "keep")
        records = read_records(cloud) if cloud.suffix.lower() == out.suffix == ".ply" else None
    if records is not None:
        with damage_is(str(cloud)):
            records.check_new(NAME)
    kept_points(read.points, str(cloud), "keep" if drop_invalid else "refuse")  # an error names the file
    of_rows = _segmented(read, config, viewpoint, drop_invalid=drop_invalid, **dict(map(read_assignment, set)))
    kept, labels = read.chosen(of_rows >= 0), of_rows[of_rows >= 0]
    scene = Scene(kept.points, colors=kept.colors, normals=kept.normals, up=up_of(cloud))
    with made.written() as path:
        if records is None:
            _write(path, scene, labels, of_rows, kept.faces)
        else:
            write_bytes(path, records.with_labels(NAME, {"vertex": of_rows.numpy()}))
    say(f"{len(labels)} points in {counted(int(labels.max()) + 1, 'superpoint')}: {out}")
    if pictured is not None:
        with pictured.written() as path:
            cloud_figure(scene, labels).savefig(path, dpi=100)
        say(png)


def _segmented(read: CloudFile, config: SuperpointsConfig, viewpoint: Sequence[float] | None, **more: Any) -> Tensor:
    """The superpoint of each row of a file, -1 of those that were dropped; from a mesh, if its triangles are used."""
    mesh = read.faces if config.weight == "segmentator" else None
    if mesh is None and read.faces is not None:
        told = "only vertices count, not triangles (--preset segmentator: they, too); if these are few and large"
        say(f"{told}, sample points on them first, such as Open3D's mesh.sample_points_uniformly(100_000)")
    sensor = None if viewpoint is None else torch.tensor(viewpoint, dtype=torch.float64)
    given = (read.points, read.colors, read.normals if mesh is None else None)
    return segment(*given, faces=mesh, viewpoint=sensor, preset=config, **more)


def _write(out: Path, scene: Scene, labels: Tensor, of_rows: Tensor, faces: Tensor | None) -> None:
    if out.suffix == ".ply":
        write_cloud(out, scene.points, label_colors(labels), labels, faces, NAME)
    elif out.suffix == ".npy":
        np.save(out, of_rows.numpy())
    else:
        arrays = {"points": scene.points, "labels": labels, "colors": scene.colors, "faces": faces}
        np.savez_compressed(out, **{name: of.numpy() for name, of in arrays.items() if of is not None})  # type: ignore[arg-type]
