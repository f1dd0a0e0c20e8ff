"""Step 3, method learned: noise and spacing of clouds whose noise and spacing are known."""

import pytest
import torch

import torchjoint.cloud.graph as graph_module
from torchjoint.cloud.graph import build_point_graph
from torchjoint.cloud.scales import NEIGHBORS_PER_NOISE, NOISE_QUANTILE, NORMAL_NEIGHBORS, low_quantile, measure_scales
from torchjoint.scene import Cloud

STEP = 0.01


def sheet(noise, side=40, seed=0):
    """A square grid of points in the plane z = 0, with normally distributed errors of z."""
    x, y = torch.meshgrid(torch.arange(side) * STEP, torch.arange(side) * STEP, indexing="ij")
    z = noise * torch.randn(side, side, generator=torch.Generator().manual_seed(seed))
    return torch.stack([x, y, z], -1).view(-1, 3)


@pytest.mark.parametrize("noise", [0.0002, 0.001, 0.003])
def test_the_noise_of_a_plane(noise):
    scales = measure_scales(sheet(noise))
    # The quantile 0.3 of |error| is 0.385 standard deviations; the fit takes a part of the error.
    assert scales.noise.median().item() == pytest.approx(0.385 * noise, rel=0.15)
    assert scales.noise.dtype == scales.spacing.dtype == torch.float32


@pytest.mark.parametrize("count", [1, 2, 3, 4, 11, 24])
def test_the_quantile_is_torchs(count):
    values = torch.rand(500, count, generator=torch.Generator().manual_seed(count))
    assert torch.equal(low_quantile(values), values.quantile(NOISE_QUANTILE, dim=1))


def test_more_noise_takes_more_neighbours():
    # Each point is a fixed distance above or below the plane, by chance: this distance is also the noise.
    points = sheet(0.0)
    side = torch.randint(2, (len(points),), generator=torch.Generator().manual_seed(0)) - 0.5
    counts = []
    for noise in (0.0, 0.002, 0.003, 0.006):
        points[:, 2] = 2 * noise * side
        counts.append(measure_scales(points).normal_neighbors)
    few, many = NORMAL_NEIGHBORS
    assert counts[0] == few
    assert counts[1] == pytest.approx(NEIGHBORS_PER_NOISE * 0.002 / STEP, rel=0.25)
    assert counts[1] < counts[2] < counts[3] <= many


def test_the_spacing_of_a_grid():
    inside = measure_scales(sheet(0.0)).spacing.view(40, 40)[1:-1, 1:-1]
    torch.testing.assert_close(inside, torch.full_like(inside, STEP))


def test_scales_are_never_0():
    for points in (torch.zeros(40, 3), torch.zeros(1, 3), torch.zeros(2, 3), sheet(0.0)):
        scales = measure_scales(points)
        assert len(scales.noise) == len(scales.spacing) == len(points)
        assert (scales.noise > 0).all()
        assert (scales.spacing > 0).all()
        few, many = NORMAL_NEIGHBORS
        assert few <= scales.normal_neighbors <= many


def test_units_do_not_matter():
    one, two = measure_scales(sheet(0.002)), measure_scales(2 * sheet(0.002))
    torch.testing.assert_close(two.noise, 2 * one.noise)
    torch.testing.assert_close(two.spacing, 2 * one.spacing)
    assert two.normal_neighbors == one.normal_neighbors


def test_threads_do_not_matter(set_threads):
    results = []
    for threads in (1, 3):
        set_threads(threads)
        results.append(measure_scales(sheet(0.002)))
    assert torch.equal(results[0].noise, results[1].noise)
    assert torch.equal(results[0].spacing, results[1].spacing)


def test_the_graph_s_neighbours_follow_from_the_scales(monkeypatch):
    points = sheet(0.002, side=15)
    scales = measure_scales(points)
    cases = ((20, 40), (40, 60), (128, 128))  # neighbours of normals, and of planes
    for for_normals, for_planes in cases:
        graph = build_point_graph(Cloud(points), 16, scales._replace(normal_neighbors=for_normals))
        monkeypatch.setattr(graph_module, "PLANE_NEIGHBORS", for_planes)
        expected = build_point_graph(Cloud(points), 16, for_normals)
        assert graph.is_same(expected)
        assert torch.equal(graph.neighbors, expected.neighbors)
        assert torch.equal(graph.edge_index, expected.edge_index)
        assert expected.scales is None
        assert graph.scales is not None
