"""The default has no unit: larger, sparser, noisier and moved scenes have the same or nearly the same segments."""

from dataclasses import replace

import pytest
import torch
from torchjoint_lab.synthetic import make_domain_scene

import torchjoint as tj
from torchjoint.cloud.scales import measure_scales
from torchjoint.metrics import segmentation_covering


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(("desk", 2, 8_000), id="desk"),
        pytest.param(("bin", 8, 15_000), id="bin", marks=pytest.mark.slow),
    ],
)
def scene(request):
    domain, seed, num_points = request.param
    return make_domain_scene(domain, seed, num_points=num_points, num_views=4).scene


@pytest.fixture(scope="module")
def labels(scene):
    return segments(scene)


def segments(scene):
    return tj.JointSegmenter()(scene).points


def scaled(scene, factor):
    """The same scene in another unit of length."""
    frames = []
    for frame in scene.frames:
        pose = frame.world_to_camera.clone()
        pose[:3, 3] *= factor
        depth = None if frame.depth is None else frame.depth * factor
        frames.append(replace(frame, world_to_camera=pose, depth=depth))
    return tj.Scene(scene.points * factor, frames, colors=scene.colors)


def covering(one, other):
    return float(segmentation_covering(one, other).symmetric)


@pytest.mark.parametrize("factor", [2.0, pytest.param(0.25, marks=pytest.mark.slow)])
def test_a_power_of_two_changes_nothing(scene, labels, factor):
    assert torch.equal(segments(scaled(scene, factor)), labels)


@pytest.mark.parametrize("factor", [pytest.param(10.0, marks=pytest.mark.slow), 0.1])
def test_other_units(scene, labels, factor):
    assert covering(segments(scaled(scene, factor)), labels) > 0.93  # measured: .999 and .960; coordinates are rounded


@pytest.mark.slow
def test_half_of_the_points(scene, labels):
    half = torch.randperm(len(scene.points), generator=torch.Generator().manual_seed(0))[::2].sort().values
    assert covering(segments(scene.select_points(half)), labels[half]) > 0.85  # measured: .97 and .92


def test_twice_the_noise(scene, labels):
    # The median of the noise is .385 standard deviations, and two errors of the same size add to sqrt(2) of it.
    error = 3**0.5 / 0.385 * float(measure_scales(scene.points).noise.median())
    generator = torch.Generator().manual_seed(1)
    noisy = scene.points + error / 3**0.5 * torch.randn(scene.points.shape, generator=generator)
    other = tj.Scene(noisy, scene.frames, colors=scene.colors)
    assert covering(segments(other), labels) > 0.8  # measured: .96 and .82


def test_another_origin(scene):
    cloud = tj.Scene(scene.points, colors=scene.colors)
    moved = tj.Scene(scene.points + torch.tensor([64.0, -32.0, 16.0]), colors=scene.colors)
    assert covering(segments(moved), segments(cloud)) > 0.97  # float32 rounds coordinates more coarsely there
