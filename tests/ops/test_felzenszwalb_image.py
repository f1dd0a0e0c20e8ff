"""felzenszwalb_image against the way by an edge list."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from effort import few_and_many
from hypothesis import strategies as st
from torch import Tensor

from torchjoint.config import ImageGraphConfig
from torchjoint.images.pixel_graph import grid_edges, pixel_weights
from torchjoint.ops import felzenszwalb, felzenszwalb_image


def by_edge_list(
    image: Tensor, boundary: Tensor, scale: float, min_size: int, color_weight: float = 1, boundary_weight: float = 1
) -> Tensor:
    _, height, width = image.shape
    config = ImageGraphConfig(smoothing=0, color_weight=color_weight, boundary_weight=boundary_weight)
    weight = pixel_weights(image, boundary, config)
    labels = felzenszwalb(grid_edges(height, width), weight, height * width, scale, min_size)
    return labels.view(height, width)


def random_image(seed: int, height: int, width: int, levels: int) -> tuple[Tensor, Tensor]:
    """An image and boundaries; `levels` > 0 makes ties."""
    generator = torch.Generator().manual_seed(seed)
    image, boundary = torch.rand(4, height, width, generator=generator).split([3, 1])
    if levels:
        image, boundary = (image * levels).round() / levels, (boundary * levels).round() / levels
    return image, boundary[0]


@few_and_many(
    60,
    300,
    seed=st.integers(0, 2**32 - 1),
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    levels=st.sampled_from([0, 1, 5]),
    scale=st.sampled_from([0.0, 0.1, 1.0, 5.0, float("inf")]),
    min_size=st.integers(0, 30),
    weights=st.sampled_from([(1.0, 1.0), (0.3, 0.0), (0.0, 2.0)]),
)
def test_equals_the_way_by_an_edge_list(
    seed: int, size: tuple[int, int], levels: int, scale: float, min_size: int, weights: tuple[float, float]
) -> None:
    image, boundary = random_image(seed, *size, levels)
    labels = felzenszwalb_image(
        image[None], boundary[None], scale=scale, min_size=min_size, color_weight=weights[0], boundary_weight=weights[1]
    )
    assert torch.equal(labels[0], by_edge_list(image, boundary, scale, min_size, *weights))


# Past 2^16 edges they no longer fit into memory at once and are read in rounds. Where most weights are alike, down to
# all of them, one weight alone is more than a round; where few edges are joined in the first pass, more of them are
# refused than are remembered, and the second pass reads them anew.
LARGE = {
    "no ties": (random_image(0, 300, 200, 0), 2.0, 20),
    "ties": (random_image(1, 200, 300, 7), 1.0, 20),
    "two values": (random_image(2, 300, 200, 1), 0.5, 50),
    "one value": ((torch.full((3, 300, 200), 0.3), torch.zeros(300, 200)), 1.0, 20),
    "nearly one value": ((0.3 + random_image(3, 300, 200, 0)[0] / 1e6, torch.zeros(300, 200)), 1e-5, 20),
    "mostly one value": ((random_image(4, 300, 200, 0)[0].clamp(min=0.8), torch.zeros(300, 200)), 0.3, 20),
    "nothing joined at first": (random_image(5, 300, 200, 0), 0.0, 20),
    "nothing joined at all": (random_image(6, 300, 200, 0), 0.0, 0),
    "wider than a block": (random_image(7, 30, 2500, 0), 2.0, 20),
}


@pytest.mark.parametrize("case", LARGE)
def test_large_images(case: str) -> None:
    (image, boundary), scale, min_size = LARGE[case]
    labels = felzenszwalb_image(image[None], boundary[None], scale=scale, min_size=min_size)
    assert torch.equal(labels[0], by_edge_list(image, boundary, scale, min_size))


def test_any_number_of_channels() -> None:
    image, boundary = random_image(8, 20, 30, 0)
    grey = image[:1]
    expected = felzenszwalb_image(torch.cat([grey, torch.zeros(2, 20, 30)])[None], boundary[None], scale=1.0)
    assert torch.equal(felzenszwalb_image(grey[None], boundary[None], scale=1.0), expected)
    eight = torch.cat([image, torch.zeros(5, 20, 30)])
    assert torch.equal(
        felzenszwalb_image(eight[None], scale=1.0), felzenszwalb_image(image[None], torch.zeros(1, 20, 30), scale=1.0)
    )
    assert not felzenszwalb_image(torch.zeros(2, 0, 20, 30), scale=1.0).any()


@pytest.mark.parametrize("shape", [(0, 3, 4, 5), (2, 3, 0, 5), (2, 3, 4, 0)])
def test_no_pixels(shape: tuple[int, int, int, int]) -> None:
    assert felzenszwalb_image(torch.zeros(shape), scale=1.0).shape == (shape[0], *shape[2:])


def test_batches_strides_and_threads_change_nothing(set_threads) -> None:
    images = torch.stack([random_image(seed, 90, 120, 9)[0] for seed in range(7)])
    expected = [felzenszwalb_image(image[None], scale=2.0, min_size=5)[0] for image in images]
    channels_last = images.permute(0, 2, 3, 1).contiguous().permute(0, 3, 1, 2)
    assert not channels_last.is_contiguous()
    for threads in (1, 2, 5):
        set_threads(threads)
        for batch in (images, channels_last):
            assert torch.equal(felzenszwalb_image(batch, scale=2.0, min_size=5), torch.stack(expected))


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="memory is read from /proc")
@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 0.0])
def test_memory(scale: float) -> None:
    """Below 40 bytes a pixel besides the result, also where nothing is joined in the first pass."""
    code = f"""
import re, torch
from torchjoint.ops import felzenszwalb_image
peak = lambda: 1024 * int(re.search(r"VmHWM:\\s*(\\d+) kB", open("/proc/self/status").read())[1])
image = torch.rand(1, 3, 2000, 2000, generator=torch.Generator().manual_seed(0))
felzenszwalb_image(image[:, :, :300, :300], scale={scale}, min_size=20)
before = peak()
labels = felzenszwalb_image(image, scale={scale}, min_size=20)
print((peak() - before) / labels.numel() - labels.element_size())
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 5 < float(result.stdout) < 40
