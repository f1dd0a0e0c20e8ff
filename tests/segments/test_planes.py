"""Step 6, regions: small regions stop where they must, and planes that look at one side only make creases sharp."""

import math

import pytest
import torch
from hand_graph import graph_of

import torchjoint.cloud.graph as graph_module
from torchjoint import ops
from torchjoint.cloud.graph import build_point_graph
from torchjoint.scene import Cloud
from torchjoint.segments.planes import MIN_POINTS, one_sided_planes, small_regions


def corner(side=20, spacing=0.02, noise=0.0, seed=0):
    """A floor (z = 0, x > 0) and a wall (x = 0, z > 0) that meet along the y axis: points, 0 for floor, 1 for wall."""
    steps = torch.arange(side) * spacing
    along, out = (grid.flatten() for grid in torch.meshgrid(steps, steps + spacing / 2, indexing="ij"))
    floor = torch.stack([out, along, torch.zeros_like(out)], 1)
    wall = torch.stack([torch.zeros_like(out), along, out], 1)
    points = torch.cat([floor, wall])
    points = points + noise * torch.randn(points.shape, generator=torch.Generator().manual_seed(seed))
    return points, torch.arange(len(points)) // len(floor)


def turned(degrees):
    """[N, 3] normals in the x-z plane, turned away from z towards x."""
    angle = torch.tensor(degrees).deg2rad()
    return torch.stack([angle.sin(), torch.zeros_like(angle), angle.cos()], 1)


class TestSmallRegions:
    def test_weights(self, monkeypatch):
        """1 - n_i . n_j, squared where convex, unless a sign is not known; colours do not count."""
        points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0]])
        normals = turned([0.0, 60.0, 0.0, 120.0, 120.0])
        colors = torch.tensor([[0.0, 0, 0], [0, 0, 0], [0.3, 0, 0.4], [0.3, 0, 0.4], [0.3, 0, 0.4]])
        graph = graph_of(points, [[0, 1], [1, 2], [2, 3], [3, 4]], normals, colors)
        known = torch.tensor([True, True, True, False, True])
        weights = {}

        def felzenszwalb(edge_index, weight, num_nodes, scale, min_size):
            weights["got"] = weight
            assert (num_nodes, scale, min_size) == (5, 0.5, 7)

        monkeypatch.setattr(ops, "felzenszwalb", felzenszwalb)
        small_regions(graph, normals, known, 0.5, 7)
        # convex; concave; 120 degrees of unknown sign are 60; flat
        assert weights["got"].tolist() == pytest.approx([0.25, 0.5, 0.5, 0.0], abs=1e-6)

    def test_none_reaches_around_a_corner(self):
        points, side = corner()
        graph = build_point_graph(Cloud(points), 16, 20)
        known = torch.ones(len(points), dtype=torch.bool)
        region = small_regions(graph, graph.normals, known, 0.003, 0)
        for label in region.unique():
            away = points[region == label][:, [0, 2]].amax(1) > 0.05  # closer to the crease normals are in between
            assert side[region == label][away].unique().numel() <= 1
        assert region[19] != region[-1]

    def test_points_in_one_place(self):
        points = torch.zeros(4, 3)
        graph = graph_of(points, [[0, 1], [1, 2], [2, 3]], turned([0.0, 0.0, 90.0, 90.0]))
        known = torch.ones(4, dtype=torch.bool)
        assert small_regions(graph, graph.normals, known, 1e-9, 0).tolist() == [0, 0, 1, 1]


class TestOneSidedPlanes:
    @pytest.mark.parametrize("noise", [0.0, 0.0005])
    def test_a_crease_is_sharp(self, noise):
        points, side = corner(noise=noise)
        graph = build_point_graph(Cloud(points), 16, 20)
        truth = torch.where((side == 0)[:, None], torch.tensor([0.0, 0, 1]), torch.tensor([1.0, 0, 0]))
        toward = torch.where((graph.normals * truth).sum(1, keepdim=True) < 0, -graph.normals, graph.normals)
        planes = one_sided_planes(graph, side, toward)
        near = points[:, [0, 2]].amax(1) < 0.015
        assert near.sum() == 40
        off, rounded = ((normals * truth).sum(1).clamp(max=1).acos() for normals in (planes.normal, toward))
        assert rounded[near].min() > math.radians(15)
        assert off[near].max() < math.radians(1 + 8000 * noise)
        assert ((planes.mean - points) * truth).sum(1).abs().max() < 1e-6 + 4 * noise

    def test_too_small_a_region_keeps_its_normals(self, monkeypatch):
        monkeypatch.setattr(graph_module, "PLANE_NEIGHBORS", 20)
        points, _ = corner(side=6)
        graph = build_point_graph(Cloud(points), 16, 45)
        given = torch.tensor([0.6, 0.0, 0.8]).expand(72, 3)
        region = torch.where(torch.arange(72) < MIN_POINTS - 1, 0, 1)
        planes = one_sided_planes(graph, region, given)
        assert torch.equal(planes.normal[: MIN_POINTS - 1], given[: MIN_POINTS - 1])
        assert not (planes.normal[MIN_POINTS - 1 :] == given[MIN_POINTS - 1 :]).all(1).any()

    def test_threads_change_nothing(self, set_threads):
        points, side = corner(side=70, noise=0.001)
        graph = build_point_graph(Cloud(points), 16, 45)
        set_threads(1)
        expected = one_sided_planes(graph, side, graph.normals)
        set_threads(3)
        for one, other in zip(one_sided_planes(graph, side, graph.normals), expected, strict=True):
            assert torch.equal(one, other)
