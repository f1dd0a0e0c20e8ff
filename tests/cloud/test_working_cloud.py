"""Step 3, method learned: large clouds that are much denser than their noise are thinned."""

import pytest
import torch

import torchjoint as tj
from torchjoint.cloud import scales as module
from torchjoint.cloud.scales import cell_means, measure_scales, working_cloud
from torchjoint.scene import Scene


def sheet(noise, side=60, step=0.01):
    """A square grid of points with normally distributed heights."""
    x, y = torch.meshgrid(torch.arange(side) * step, torch.arange(side) * step, indexing="ij")
    z = noise * torch.randn(side, side, generator=torch.Generator().manual_seed(0))
    return torch.stack([x, y, z], -1).view(-1, 3)


def test_cell_means_by_hand():
    points = torch.tensor([[0.0, 0, 0], [0.2, 0.4, 0], [1.5, 0, 0], [0.4, 0.2, 0]])
    colors = torch.tensor([[0.0, 0, 0], [0.3, 0, 0], [0, 1, 0], [0.6, 0, 0]])
    of_point, thinned = cell_means(Scene(points, colors=colors), 1.0)
    assert of_point.tolist() == [0, 0, 1, 0]
    torch.testing.assert_close(thinned.points, torch.tensor([[0.2, 0.2, 0], [1.5, 0, 0]]))
    torch.testing.assert_close(thinned.colors, torch.tensor([[0.3, 0, 0], [0, 1.0, 0]]))
    assert thinned.normals is None


def test_normals_that_cancel_out_are_not_averaged():
    normals = torch.tensor([[0.0, 0, 1], [0, 0, -1], [0, 1, 0]])
    _, thinned = cell_means(Scene(torch.zeros(3, 3), normals=normals[[0, 1, 0]]), 1.0)
    torch.testing.assert_close(thinned.normals, torch.tensor([[0.0, 0, 1]]))
    _, thinned = cell_means(Scene(torch.zeros(2, 3), normals=normals[:2]), 1.0)
    torch.testing.assert_close(thinned.normals, torch.tensor([[0.0, 0, 1]]))


def test_exact_clouds_and_small_clouds_stay_as_they_are(monkeypatch):
    assert working_cloud(Scene(sheet(0.005))).of_point is None  # small
    monkeypatch.setattr(module, "LEAST_POINTS", 300)
    assert working_cloud(Scene(sheet(0.0001))).of_point is None  # exact
    for few in (1, 2, 5):
        assert working_cloud(Scene(torch.rand(few, 3, generator=torch.Generator().manual_seed(0)))).of_point is None
    assert working_cloud(Scene(torch.zeros(500, 3))).cloud.points.shape[1] == 3  # copies of one point


def test_a_dense_cloud_is_thinned(monkeypatch):
    monkeypatch.setattr(module, "LEAST_POINTS", 300)
    cloud = Scene(sheet(0.003))
    working, scales, of_point = working_cloud(cloud)
    assert 300 <= len(working.points) < 0.6 * len(cloud.points)
    assert of_point is not None
    assert torch.equal(of_point.unique(), torch.arange(len(working.points)))
    assert scales.spacing.median() > 1.2 * measure_scales(cloud.points).spacing.median()
    assert working.points[:, 2].std() < cloud.points[:, 2].std()  # means are more exact


@pytest.mark.parametrize("side", [0.0213, 0.017, 3.0])
def test_the_side_of_a_cell_does_not_follow_tiny_changes(side):
    """The measured spacing moves a little with each point; the borders of cells far from the corner stay."""
    rounded = module._rounded(side, 7.3)
    assert side / 2**0.125 < rounded < side * 2**0.125
    assert module._rounded(side * (1 + 1e-6), 7.3) == rounded
    assert module._rounded(side * 8, 7.3 * 8) == rounded * 8
    assert module._rounded(side * 10, 7.3 * 10) == pytest.approx(rounded * 10, rel=1e-12)
    assert module._rounded(side, 0.0) == side


def test_every_given_point_gets_the_label_of_its_working_point(monkeypatch, scene_of):
    scene = scene_of(3).scene
    generator = torch.Generator().manual_seed(0)
    noisy = Scene(scene.points + 0.01 * torch.randn(scene.points.shape, generator=generator), scene.frames)
    monkeypatch.setattr(module, "LEAST_POINTS", 1000)
    segmenter = tj.JointSegmenter()
    result = segmenter(noisy)
    of_point = segmenter.graph.of_given
    assert of_point is not None
    assert len(result.points) == len(noisy.points) > segmenter.graph.num_points
    label = torch.full((segmenter.graph.num_points,), -1)
    label[of_point] = result.points
    assert torch.equal(label[of_point], result.points)
    assert torch.equal(torch.unique(result.points, return_inverse=True)[1], result.points)
    assert len(result.at(1.0).points) == len(noisy.points)
    assert torch.equal(segmenter.compute(images=False, config=tj.Config()).points, result.points)


def test_a_cloud_with_more_cells_than_numbers_is_not_thinned(monkeypatch):
    monkeypatch.setattr(module, "LEAST_POINTS", 300)
    far = torch.cat([sheet(0.003), torch.tensor([[1e4, 1e4, 1e4]])])
    assert working_cloud(Scene(far)).of_point is not None  # about 5e5 cells a side
    assert working_cloud(Scene(torch.cat([sheet(0.003), torch.tensor([[1e6, 1e6, 1e6]])]))).of_point is None
