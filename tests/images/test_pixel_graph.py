import math

import pytest
import torch

from torchjoint.config import ImageGraphConfig, ImageSegmentsConfig
from torchjoint.images.boundary import GradientBoundary
from torchjoint.images.contours import smooth
from torchjoint.images.pixel_graph import grid_edges, pixel_weights, segment_image


def test_grid_edges_by_hand():
    # 0 1
    # 2 3
    expected = {(0, 1), (2, 3), (0, 2), (1, 3), (0, 3), (2, 1)}
    assert {tuple(edge) for edge in grid_edges(2, 2).T.tolist()} == expected


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 5), (4, 1), (3, 4), (7, 5)])
def test_grid_edges_are_the_8_neighbourhood_once(height, width):
    edges = {frozenset(edge) for edge in grid_edges(height, width).T.tolist()}
    pixels = [(r, c) for r in range(height) for c in range(width)]
    expected = {
        frozenset((a[0] * width + a[1], b[0] * width + b[1]))
        for a in pixels
        for b in pixels
        if a != b and max(abs(a[0] - b[0]), abs(a[1] - b[1])) == 1
    }
    assert edges == expected
    assert grid_edges(height, width).shape[1] == len(expected)


def test_eq_2_by_hand():
    image = torch.zeros(3, 1, 2)
    image[:, 0, 1] = torch.tensor([0.3, 0.0, 0.4])  # colour distance 0.5
    boundary = torch.tensor([[0.2, 0.6]])  # the weaker is 0.2
    config = ImageGraphConfig(smoothing=0, color_weight=2.0, boundary_weight=3.0)
    weight = pixel_weights(image, boundary, config)
    torch.testing.assert_close(weight, torch.tensor([2.0 * 0.5 + 3.0 * 0.2]))


def test_eq_2_against_a_loop():
    generator = torch.Generator().manual_seed(0)
    image, boundary = torch.rand(3, 4, 5, generator=generator), torch.rand(4, 5, generator=generator)
    config = ImageGraphConfig(smoothing=0, color_weight=0.7, boundary_weight=0.4)
    expected = []
    for i, j in grid_edges(4, 5).T.tolist():
        color_i, color_j = image[:, i // 5, i % 5], image[:, j // 5, j % 5]
        b = min(boundary[i // 5, i % 5].item(), boundary[j // 5, j % 5].item())
        expected.append(0.7 * math.dist(color_i.tolist(), color_j.tolist()) + 0.4 * b)
    torch.testing.assert_close(pixel_weights(image, boundary, config), torch.tensor(expected))


def test_two_flat_halves_are_two_segments():
    image = torch.zeros(3, 20, 30)
    image[:, :, 12:] = 0.8
    segments = ImageSegmentsConfig(scale=1, min_size=10)
    labels = segment_image(image, torch.zeros(20, 30), ImageGraphConfig(smoothing=0), segments)
    assert (labels[:, :12] == 0).all()
    assert (labels[:, 12:] == 1).all()


def test_smoothing_zero_is_the_identity_and_keeps_constants_else():
    image = torch.full((1, 3, 9, 8), 0.25)
    assert smooth(image, 0) is image
    torch.testing.assert_close(smooth(image, 2.0), image)
    assert torch.equal(smooth(image.clone().requires_grad_(), 2.0), smooth(image, 2.0))


class TestGradientBoundary:
    def test_range_shape_and_place(self):
        images = torch.zeros(2, 3, 16, 24)
        images[0, :, :, 12:] = 1.0
        boundary = GradientBoundary(smoothing=1.0)(images)
        assert boundary.shape == (2, 16, 24)
        assert boundary.min() >= 0
        assert boundary.max() <= 1
        assert boundary[0, :, 11:13].min() > 0.9
        assert boundary[0, :, :6].max() < 0.05
        assert boundary[1].max() < 1e-6  # a constant image has no boundary

    def test_strength_by_hand(self):
        # A grey ramp of 0.5 L a pixel, seen through central differences, in the middle of the image.
        lightness = torch.arange(41, dtype=torch.float64) * 0.5 + 20
        linear = ((lightness + 16) / 116) ** 3  # inverse of CIE L above its linear part
        grey = torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        images = grey.float().expand(1, 3, 5, 41)
        boundary = GradientBoundary(smoothing=0, contrast=2.0)(images)
        assert boundary[0, 2, 20].item() == pytest.approx(1 - math.exp(-0.5 / 2.0), rel=2e-3)

    def test_a_batch_is_its_images(self):
        images = torch.rand(5, 3, 33, 47, generator=torch.Generator().manual_seed(1))
        together = GradientBoundary()(images)
        assert torch.equal(together, torch.stack([GradientBoundary()(image[None])[0] for image in images]))

    def test_one_image_does_not_depend_on_threads(self, set_threads):
        image = torch.rand(1, 3, 333, 471, generator=torch.Generator().manual_seed(2))
        results = []
        for count in (1, 2, 3):
            set_threads(count)
            results.append(GradientBoundary()(image))
        assert torch.equal(results[0], results[1])
        assert torch.equal(results[0], results[2])

    @pytest.mark.parametrize("shape", [(1, 3, 1, 1), (1, 3, 1, 7), (1, 3, 3, 2)])
    def test_tiny_images(self, shape):
        assert GradientBoundary(smoothing=2.0)(torch.rand(shape)).shape == (shape[0], *shape[2:])

    def test_no_images(self):
        assert GradientBoundary()(torch.zeros(0, 3, 4, 5)).shape == (0, 4, 5)

    def test_wrong_shape(self):
        with pytest.raises(ValueError, match=r"images: expected shape \[B, 3, H, W\], got \[3, 4, 5\]"):
            GradientBoundary()(torch.zeros(3, 4, 5))
