"""What do normals that a file tells bring to a cloud alone? Of a mesh's triangles, and of splats' shortest axes.

    python lab/studies/normals.py [--first 10] [--rooms 4] [--runs 2] [--edges]

The meshes are fused (TSDF, 2 cm) of the frames of generated rooms; a vertex has the label of the point within 5 cm. The
splats are the rooms' points: their axes are 15 degrees off, a fifth are no discs and have the normals of their
neighbours, and the side of an axis is not known. All points are moved by .1 mm in each run. With --edges, meshes only:
what do the edges of the triangles bring in the graph, beside those to nearest neighbours or alone?
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn.functional import normalize
from torchjoint_lab.synthetic import SyntheticScene, make_scene

import torchjoint as tj
from torchjoint.cloud.graph import PointGraph
from torchjoint.cloud.mesh import face_edges
from torchjoint.cloud.neighbors import nearest_neighbors
from torchjoint.cloud.normals import estimate_normals
from torchjoint.datasets.formats.cloud_alone import agreed_normals
from torchjoint.segments.method import LEARNED

VOXEL, NEAR, OFF, DISCS = 0.02, 0.05, 15.0, 0.8
#: Which edges of triangles are in the graph: all, or no others.
EDGES = ("beside", "alone")
#: A cloud, its labels, and the normals to compare, by name.
Trial = tuple[tj.Scene, Tensor, dict[str, Tensor | None]]


def mesh_of(made: SyntheticScene) -> Any:
    """The frames of a room, fused: a mesh of Open3D."""
    import open3d as o3d

    color = o3d.pipelines.integration.TSDFVolumeColorType.RGB8
    volume = o3d.pipelines.integration.ScalableTSDFVolume(VOXEL, 4 * VOXEL, color)
    for frame in made.scene.frames:
        assert frame.depth is not None
        image = o3d.geometry.Image((frame.image.permute(1, 2, 0) * 255).byte().contiguous().numpy())
        depth = o3d.geometry.Image(frame.depth.float().contiguous().numpy())
        pair = o3d.geometry.RGBDImage.create_from_color_and_depth(image, depth, 1.0, 6.0, False)
        height, width = frame.size
        fx, fy, cx, cy = (float(frame.intrinsics[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        camera = o3d.camera.PinholeCameraIntrinsic(width, height, fx, fy, cx, cy)
        volume.integrate(pair, camera, frame.world_to_camera.double().numpy())
    return volume.extract_triangle_mesh()


def of_mesh(made: SyntheticScene) -> tuple[Trial, Tensor]:
    """The trial, and the triangles [F, 3]."""
    mesh = mesh_of(made)
    points, faces = torch.from_numpy(np.asarray(mesh.vertices)), torch.from_numpy(np.asarray(mesh.triangles)).long()
    away, near = cKDTree(made.scene.points.numpy()).query(points.numpy())
    normals = agreed_normals(points, faces)
    assert normals is not None
    colors = torch.from_numpy(np.asarray(mesh.vertex_colors)).float().clamp(0, 1)
    labels = torch.where(torch.from_numpy(away < NEAR), made.point_labels[near], -1)
    kinds = {"none": None, "triangles": normals, "inside out": -normals}
    return (tj.Scene(points, colors=colors), labels, kinds), faces


def of_splats(made: SyntheticScene, random: torch.Generator) -> Trial:
    import open3d as o3d

    points, count = made.scene.points, len(made.scene.points)
    surface = o3d.t.geometry.RaycastingScene()
    corners = made.triangles.reshape(-1, 3)
    faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    surface.add_triangles(o3d.core.Tensor(corners.numpy()), o3d.core.Tensor(faces))
    found = surface.compute_closest_points(o3d.core.Tensor(points.numpy()))
    true = torch.from_numpy(found["primitive_normals"].numpy())
    aside = normalize(torch.linalg.cross(true, torch.randn(count, 3, generator=random), dim=1), dim=1)
    axes = normalize(true + torch.deg2rad(OFF * torch.randn(count, 1, generator=random)).tan() * aside, dim=1)
    fitted = estimate_normals(points, nearest_neighbors(points, 30).indices)
    axes = torch.where(torch.rand(count, 1, generator=random) < DISCS, axes, fitted)
    axes *= torch.where(torch.rand(count, 1, generator=random) < 0.5, -1, 1)
    return tj.Scene(points, colors=made.scene.colors), made.point_labels, {"none": None, "axes": axes}


def with_edges(graph: PointGraph, faces: Tensor, alone: bool) -> PointGraph:
    """The graph with the edges of triangles, too, or alone."""
    count = graph.num_points
    edges = graph.of_given[face_edges(faces)].sort(0).values
    edges = edges[:, edges[0] < edges[1]]  # others have both ends in one point of a thinned cloud
    edges = edges if alone else torch.cat([graph.edge_index, edges], 1)
    code = torch.unique(edges[0] * count + edges[1])
    edges = torch.stack([code // count, code % count])
    return replace(graph, edge_index=edges)


def scores(trial: Trial, random: torch.Generator, faces: Tensor) -> Iterator[tuple[str, float, float]]:
    scene, labels, kinds = trial
    points = (scene.points + 1e-4 * torch.randn(scene.points.shape, generator=random)).float()
    prepare = LEARNED.prepare
    for name, normals in kinds.items():
        way = (lambda *of, name=name: with_edges(prepare(*of), faces, name == "alone")) if name in EDGES else prepare
        segmenter = tj.JointSegmenter(method=LEARNED._replace(prepare=way))
        got = segmenter(tj.Scene(points, colors=scene.colors, normals=normals)).points
        yield name, tj.metrics.objects_and_parts(got, labels).f, tj.metrics.mean_best_iou(got, labels)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=10)
    parser.add_argument("--rooms", type=int, default=4)
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--edges", action="store_true")
    arguments = parser.parse_args()
    found = defaultdict(list)
    for seed in range(arguments.first, arguments.first + arguments.rooms):
        made, random = make_scene(seed, "medium"), torch.Generator().manual_seed(seed)
        scan, faces = of_mesh(made)
        trials = [("mesh", scan), ("splats", of_splats(made, random))]
        if arguments.edges:
            trials = [("mesh", (*scan[:2], dict.fromkeys(("none", *EDGES), scan[2]["triangles"])))]
        for kind, trial in trials:
            for _ in range(arguments.runs):
                for name, *pair in scores(trial, random, faces):
                    found[f"{kind}, {name}"].append(pair)
                    print(f"room {seed}, {kind}, {name}: {pair[0]:.3f}/{pair[1]:.3f}", flush=True)
    for name, pairs in found.items():
        gain = np.subtract(pairs, found[f"{name.split(',')[0]}, none"])
        error = gain.std(0) / max(1, len(gain) - 1) ** 0.5
        print(
            name,
            *(f"{a:.3f} ({b:+.3f} ± {c:.3f})" for a, b, c in zip(np.mean(pairs, 0), gain.mean(0), error, strict=True)),
        )


if __name__ == "__main__":
    main()
