"""Closed contours: what they do to gaps, bands and batches."""

import pytest
import torch

import torchjoint as tj
from torchjoint.config import ImageGraphConfig, ImageSegmentsConfig
from torchjoint.images.contours import close_contours
from torchjoint.images.pixel_graph import segment_image
from torchjoint.images.segmenter import ImageSegmenter
from torchjoint.runtime.messages import Stopwatch


def outlined() -> torch.Tensor:
    """A square's broad outline with a gap."""
    boundary = torch.zeros(48, 64)
    boundary[10:38, 16:44] = 0.8
    boundary[15:33, 21:39] = 0.0
    boundary[22:25, 16:21] = 0.0
    return boundary


def test_the_segmentation_does_not_leak_and_has_no_band():
    """Through the gap the square would be one with what is around it, and its outline a segment of its own."""
    boundary = outlined()
    graph, segments = ImageGraphConfig(color_weight=0.0, boundary_weight=1.0), ImageSegmentsConfig(scale=1, min_size=20)
    image = torch.zeros(3, 48, 64)
    inside, band, outside = (24, 30), (12, 30), (4, 4)
    open_ = segment_image(image, boundary, graph, segments)
    assert open_[inside] == open_[outside]
    assert open_[band] != open_[inside]
    closed = segment_image(image, close_contours(boundary[None])[0], graph, segments)
    assert closed[inside] != closed[outside]
    assert len(closed.unique()) == 2


def test_strength_is_the_mean_to_the_power():
    boundary = torch.zeros(1, 20, 30)
    boundary[:, :, 14] = 0.5
    for exponent in (1.0, 2.0):
        contours = close_contours(boundary, smoothing=1.0, exponent=exponent)
        assert contours.max().item() == pytest.approx(0.5**exponent, abs=1e-4)
        assert (contours > 0).sum() == 40


def test_images_are_independent():
    generator = torch.Generator().manual_seed(0)
    boundaries = torch.rand(3, 30, 41, generator=generator)
    together = close_contours(boundaries)
    assert torch.equal(together, torch.cat([close_contours(one[None]) for one in boundaries]))


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (5, 1), (2, 2), (0, 4)])
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_any_size_and_nothing_to_see(size, value):
    contours = close_contours(torch.full((2, *size), value))
    assert contours.shape == (2, *size)
    assert not contours.any()


def test_errors():
    with pytest.raises(ValueError, match=r"boundaries: expected shape \[B, H, W\], got \[3, 4\]"):
        close_contours(torch.zeros(3, 4))
    with pytest.raises(ValueError, match=r"boundaries: expected numbers in \[0, 1\], got others in image 0"):
        close_contours(torch.full((1, 3, 4), 2.0))


class Outline(torch.nn.Module):
    def forward(self, images: torch.Tensor) -> torch.Tensor:
        return outlined().expand(len(images), -1, -1)


@pytest.mark.parametrize("closed", [True, False])
def test_the_config_decides(closed):
    config = tj.Config().set([f"contours.closed={closed}"])
    eye = torch.eye(4, dtype=torch.float64)
    frame = tj.Frame(name="a", image=torch.zeros(3, 48, 64), intrinsics=eye[:3, :3], world_to_camera=eye)
    segments = ImageSegmenter(config, Outline())([frame], Stopwatch())
    assert torch.equal(segments[0].boundary, outlined()) != closed


def test_the_letter_does_not_close():
    assert not tj.Config.from_preset("paper").contours.closed
