"""structured_forest: the slow twin, and arguments that are right and wrong."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from reference.arguments import IMAGES, LABELS, NAN, changed
from torchjoint.ops.internal import structured_forest

EXAMPLE: dict[str, Any] = {
    "images": IMAGES, "children": torch.tensor([[2, 0, 0], [0, 0, 0]], dtype=torch.int32),
    "features": torch.tensor([[7, 0, 0], [0, 0, 0]], dtype=torch.int32), "thresholds": torch.full((2, 3), 0.3),
    "boundary_counts": torch.tensor([[0, 1, 2], [1, 0, 0]], dtype=torch.int32),
    "boundary_pixels": torch.tensor([136, 1, 2, 255], dtype=torch.uint8), "trees_per_site": 1, "stride": 2,
}  # fmt: skip


def first(name: str, value: float) -> Tensor:
    """An array of the example, with another first value."""
    return changed(EXAMPLE[name], value, 0, 0)


ERRORS = [
    ({"children": first("children", 9)}, ValueError, "less than 3, got 9 at node 0 of tree 0"),
    (
        {"children": first("children", 1)},
        ValueError,
        "children: expected 0, or more than the node's place + 1",
    ),
    ({"children": first("children", -2)}, ValueError, "got -2 at node 0 of tree 0"),
    (
        {"features": first("features", 7228)},
        ValueError,
        "in [0, 7228), got 7228 at node 0 of tree 0",
    ),
    (
        {"features": first("features", -1)},
        ValueError,
        "features: expected numbers in [0, 7228), got -1",
    ),
    (
        {"thresholds": first("thresholds", NAN)},
        ValueError,
        "thresholds: expected finite numbers, got nan at",
    ),
    (
        {"boundary_counts": first("boundary_counts", -1)},
        ValueError,
        "boundary_counts: expected counts >= 0, got -1 at",
    ),
    (
        {"boundary_counts": first("boundary_counts", 5)},
        ValueError,
        "expected counts of 4 pixels in all, got 9",
    ),
    ({"images": changed(IMAGES, torch.inf, 0, 0, 0, 0)}, ValueError, "images: expected finite numbers, got inf at 0"),
    ({"trees_per_site": 3}, ValueError, "trees_per_site: expected 1 to 2, got 3"),
    ({"trees_per_site": 0}, ValueError, "trees_per_site: expected 1 to 2, got 0"),
    ({"stride": 3}, ValueError, "stride: expected 2 or 4, got 3"),
]
REFUSED = [
    {"images": IMAGES[0]},
    {"children": LABELS},
    {"features": LABELS},
    {"thresholds": IMAGES[0, 0]},
    {"boundary_counts": LABELS},
    {"boundary_pixels": LABELS},
    {"images": torch.zeros(1, 3, 1, 2**14 + 1)},
]

#: The image is mirrored by so many pixels on each side. A patch has 16 x 16 cells, a leaf 16 x 16 pixels.
PADDING, PATCH = 8, 16
NUM_CHANNELS, NUM_ORIENTATIONS = 13, 4
#: Rows and columns of the cells whose differences are features; cells are numbered column by column.
GRID = (1, 4, 8, 11, 14)
#: OpenCV's polynomial for the arc tangent reaches 22.5 degrees, where orientations part, at this ratio.
PARTING = 0.41412405
_RGB_TO_XYZ = ((0.430574, 0.341550, 0.178325), (0.222015, 0.706655, 0.071330), (0.020183, 0.129553, 0.939180))


def structured_forest_reference(
    images: Tensor,
    children: Tensor,
    features: Tensor,
    thresholds: Tensor,
    boundary_counts: Tensor,
    boundary_pixels: Tensor,
    trees_per_site: int,
    stride: int = 2,
) -> Tensor:
    """What :func:`torchjoint.ops.internal.structured_forest` computes; the arguments are not checked."""
    ends = boundary_counts.flatten().long().cumsum(0)
    num_trees, length = children.shape
    result = torch.zeros(len(images), *images.shape[2:])
    for image, strength in zip(images, result, strict=True):
        regular, similarity = forest_channels(image)
        votes = torch.zeros_like(strength)
        rows, columns = (range(0, max(0, size - PATCH), stride // 2) for size in regular.shape[1:])
        for i, row in enumerate(rows):
            for j, column in enumerate(columns):
                patch = (part[:, row : row + PATCH, column : column + PATCH] for part in (regular, similarity))
                values = _features(*patch)
                for turn in range(trees_per_site):
                    tree = ((i + j) % (2 * trees_per_site) + turn) % num_trees
                    leaf = tree * length + _leaf(values, children[tree], features[tree], thresholds[tree])
                    first = int(ends[leaf]) - int(boundary_counts.flatten()[leaf])
                    for pixel in boundary_pixels[first : int(ends[leaf])].tolist():
                        votes[2 * row + pixel % PATCH, 2 * column + pixel // PATCH] += 1
        if strength.numel():
            strength.copy_(triangle_filter(votes * (2.0 * stride**2 / PATCH**2 / trees_per_site), 1))
    return result


def _leaf(values: Tensor, children: Tensor, features: Tensor, thresholds: Tensor) -> int:
    node = 0
    while child := int(children[node]):
        node = child - 1 if values[features[node]] < thresholds[node] else child
    return node


def _features(regular: Tensor, similarity: Tensor) -> Tensor:
    """All 7228 features of a patch, from its cells in both kinds of channels [13, 16, 16]."""
    cells = torch.stack([similarity[:, row, column] for column in GRID for row in GRID], dim=1)
    first, second = torch.triu_indices(len(GRID) ** 2, len(GRID) ** 2, 1)
    return torch.cat([regular.transpose(1, 2).flatten(), (cells[:, first] - cells[:, second]).flatten()])


def forest_channels(image: Tensor) -> tuple[Tensor, Tensor]:
    """The channels of an image [3, H, W], weakly and strongly smoothed, each [13, H / 2, W / 2] of the padded image.

    They are L, u, v; then, for the image and for half of it, the magnitude of the gradient and 4 orientations.
    """
    for dim in (1, 2):
        length = image.shape[dim]
        image = image.index_select(dim, _mirrored(length, PADDING, PADDING + length % 2))
    luv = rgb_to_luv(image)
    half = _mean_of_cells(luv)
    channels = [half]
    for colors, cell in ((luv, 2), (half, 1)):
        magnitude, orientation = _gradient(colors)
        magnitude = magnitude / (triangle_filter(magnitude, 4) + 0.01)
        channels.append((magnitude if cell == 1 else _mean_of_cells(magnitude))[None])
        turns = torch.arange(NUM_ORIENTATIONS)[:, None, None]
        parts = torch.where(orientation == turns, magnitude * (1 / cell**2), 0.0)
        channels.append(parts if cell == 1 else _sum_of_cells(parts))
    stacked = torch.cat(channels)
    return triangle_filter(stacked, 1), triangle_filter(stacked, 4)


def rgb_to_luv(image: Tensor) -> Tensor:
    """Converts RGB [3, H, W] to CIE Luv with 1024 steps of lightness, all about in [0, 1]."""
    red, green, blue = image
    x, y, z = ((a * red + b * green) + c * blue for a, b, c in _RGB_TO_XYZ)
    steps = torch.arange(1024, dtype=torch.float64) / 1024
    slope = 29**3 / 27
    table = torch.where(steps > 8 / slope, 116 * steps.pow(1 / 3) - 16, steps * slope) / 270
    lightness = table.float()[(1024 * y).clamp(0, 1023).long()]
    n = 1 / (((x + 15 * y) + 3 * z) + 1e-35)
    u = lightness * ((52 * x) * n - 13 * 0.197833) + 88 / 270
    v = lightness * ((117 * y) * n - 13 * 0.468331) + 134 / 270
    return torch.stack([lightness, u, v])


def triangle_filter(values: Tensor, radius: int) -> Tensor:
    """Filters [..., H, W] with weights that fall linearly with distance up to `radius`."""
    for dim in (-1, -2):
        length = values.shape[dim]
        padded = values.index_select(dim, _mirrored(length, radius, radius, inner=True))
        weights = [(radius + 1 - i) / (radius + 1) ** 2 for i in range(radius + 1)]
        values = weights[0] * padded.narrow(dim, radius, length)
        for i in range(1, radius + 1):
            both = padded.narrow(dim, radius - i, length) + padded.narrow(dim, radius + i, length)
            values = values + weights[i] * both
    return values


def _gradient(colors: Tensor) -> tuple[Tensor, Tensor]:
    """Magnitude and orientation (0 to 3), [H, W] each, in the channel where the gradient is largest."""
    height, width = colors.shape[1:]
    rows, columns = _mirrored(height, 1, 1), _mirrored(width, 1, 1)
    across = colors[:, :, columns[2:]] - colors[:, :, columns[:-2]]
    down = colors[:, rows[2:]] - colors[:, rows[:-2]]
    squared = across * across + down * down
    best = squared.argmax(dim=0, keepdim=True)  # the first, if several are largest
    across, down, squared = (values.gather(0, best)[0] for values in (across, down, squared))
    wide, tall = across.abs(), down.abs()
    diagonal = torch.where(across * down > 0, 1, 3)
    orientation = torch.where(tall < PARTING * wide, 0, torch.where(wide < PARTING * tall, 2, diagonal))
    orientation[(wide < 1e-5) & (tall < 1e-5)] = 2
    return squared.double().sqrt().float(), orientation


def _mirrored(length: int, before: int, after: int, inner: bool = False) -> Tensor:
    """The places from -before to length + after, mirrored into [0, length); `inner`: the border is not repeated."""
    line = list(range(length))
    period = line + (line[-2:0:-1] if inner else line[::-1])
    return torch.tensor([period[place % len(period)] for place in range(-before, length + after)], dtype=torch.int64)


def _sum_of_cells(values: Tensor) -> Tensor:
    above, below = values[..., ::2, :], values[..., 1::2, :]
    return ((above[..., ::2] + above[..., 1::2]) + below[..., ::2]) + below[..., 1::2]


def _mean_of_cells(values: Tensor) -> Tensor:
    above, below = values[..., ::2, :], values[..., 1::2, :]
    return ((above[..., ::2] + above[..., 1::2]) + (below[..., ::2] + below[..., 1::2])) * 0.25


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    side = share**0.5
    images = torch.rand(1, 3, int(1500 * side), int(1500 * side), generator=torch.Generator().manual_seed(0))
    return lambda: structured_forest(**EXAMPLE | {"images": images})
