"""felzenszwalb_image: arguments that are right and wrong; its twin is felzenszwalb on the edges of the image."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from reference.arguments import IMAGES, NAN, changed
from torchjoint.ops import felzenszwalb_image

EXAMPLE: dict[str, Any] = {"images": IMAGES, "boundaries": IMAGES[:, 0], "scale": 1.0}
ERRORS = [
    ({"images": IMAGES.numpy()}, TypeError, "images: expected a torch.Tensor, got ndarray"),
    ({"images": IMAGES.double()}, TypeError, "images: expected dtype torch.float32, got"),
    ({"images": IMAGES.byte()}, TypeError, "images: expected dtype torch.float32, got torch.uint8"),
    ({"images": IMAGES[0]}, ValueError, "images: expected shape [B, C, H, W], got [3, 2, 4]"),
    ({"images": changed(IMAGES, NAN, 1, 2)}, ValueError, "images: expected numbers between"),
    ({"images": changed(IMAGES, torch.inf, 0)}, ValueError, "images: expected numbers between"),
    ({"boundaries": IMAGES}, ValueError, "boundaries: expected shape [B, H, W] = [2, 2, 4], got"),
    ({"boundaries": IMAGES[:1, 0]}, ValueError, "boundaries: expected shape [B, H, W] = [2, 2, 4]"),
    ({"boundaries": -IMAGES[:, 0] / 0}, ValueError, "boundaries: expected numbers between"),
    ({"boundaries": 3}, TypeError, "boundaries: expected a torch.Tensor, got int"),
    ({"scale": -1.0}, ValueError, "scale: expected a number >= 0, got -1.0"),
    ({"min_size": 1.5}, TypeError, "min_size: expected int, got float"),
    ({"color_weight": NAN}, ValueError, "color_weight: expected a number >= 0, got nan"),
    ({"boundary_weight": -2}, ValueError, "boundary_weight: expected a number >= 0, got -2"),
]
REFUSED = [
    {"images": IMAGES[0]},
    {"images": IMAGES.double()},
    {"boundaries": IMAGES[:, 0, :1]},
    {"scale": NAN},
    {"min_size": -1},
    {"color_weight": NAN},
    {"boundary_weight": -1.0},
]


def long_call(share: float = 1) -> Callable[[], Any]:
    """A call that takes some tenths of a second, or about such a share of that."""
    side = share**0.5
    images = torch.rand(1, 3, int(1500 * side), int(1500 * side), generator=torch.Generator().manual_seed(0))
    return lambda: felzenszwalb_image(images, scale=1.0)
