"""Dark colours are brightened; others, and what has no colour, stay."""

import pytest
import torch

import torchjoint as tj
from torchjoint.images.segmenter import LEAST_MEAN, brightened


def test_bright_colours_stay_bit_for_bit():
    colors = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
    assert torch.equal(brightened(colors), colors)


@pytest.mark.parametrize("factor", [0.5, 0.1, 1 / 257])
def test_a_dim_light_changes_nothing(factor):
    colors = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)) * 0.5
    expected = brightened(colors)
    assert expected.mean() == pytest.approx(LEAST_MEAN)
    assert torch.allclose(brightened(colors * factor), expected, atol=1e-6)


def test_what_has_no_colour_does_not_count():
    colors = torch.tensor([[0.1, 0.1, 0.1], [0.0, 0.0, 0.0], [torch.nan, torch.nan, torch.nan]])
    found = brightened(colors)
    assert found[0].tolist() == pytest.approx([LEAST_MEAN] * 3)
    assert found[1].tolist() == [0, 0, 0]
    assert found[2].isnan().all()
    assert torch.equal(brightened(torch.zeros(4, 3)), torch.zeros(4, 3))


def test_lamps_are_limited():
    colors = torch.full((100, 3), 0.01)
    colors[0] = 0.9
    assert brightened(colors).max() == 1


def test_objects_of_a_dim_recording(scene_of):
    made = scene_of(3).scene
    clear = tj.JointSegmenter()(made)
    dim = tj.Scene(
        made.points,
        [tj.Frame(frame.image * 0.1, frame.intrinsics, frame.world_to_camera) for frame in made.frames],
        made.colors * 0.1,
    )
    covering = tj.metrics.segmentation_covering(tj.JointSegmenter()(dim).points, clear.points).symmetric
    assert covering > 0.8
