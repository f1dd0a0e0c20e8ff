"""Step 1: the boundary detector that a config names; and the one by gradients."""

from __future__ import annotations

from importlib import import_module

import torch
from torch import Tensor, nn

from torchjoint.config import BoundaryConfig
from torchjoint.images.contours import smooth
from torchjoint.images.forest import MULTI_SCALE, StructuredForestBoundary
from torchjoint.runtime.threads import parallel_map

#: Standard deviation of the blur before the gradient, pixels. It suppresses the noise of a camera but keeps edges.
GRADIENT_SMOOTHING = 1.0

#: Gradient at which the boundary is 1 - 1/e, Lab units per pixel. Clear edges exceed it; shading is far below it.
CONTRAST = 8.0


#: Rows of the matrix from linear RGB to XYZ, and the white of D65.
_XYZ = (
    (0.412453, 0.35758, 0.180423, 0.95047), (0.212671, 0.71516, 0.072169, 1.0), (0.019334, 0.119193, 0.950227, 1.08883)
)  # fmt: skip


def to_lab(rgb: Tensor) -> Tensor:
    """Colours [3, ...] RGB in [0, 1] -> CIE Lab, without a matrix product, which torch may round to bfloat16."""
    red, green, blue = torch.where(rgb > 0.04045, ((rgb + 0.055).clamp(min=0) / 1.055).pow(2.4), rgb / 12.92)
    xyz = torch.stack([(x * red).add(green, alpha=y).add(blue, alpha=z) / white for x, y, z, white in _XYZ])
    x, y, z = torch.where(xyz > 0.008856, xyz.clamp(min=0.008856).pow(1 / 3), 7.787 * xyz + 4 / 29)
    return torch.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)])


class GradientBoundary(nn.Module):
    """Gradient magnitude of the smoothed image in CIE Lab, b = 1 - exp(-|g| / contrast).

    Distances in Lab are close to the differences that people perceive, so one contrast suits dark and bright scenes.

    Args:
        smoothing: standard deviation of the Gaussian, pixels; 0 = none.
        contrast: gradient at which b = 1 - 1/e, Lab units per pixel.
    """

    def __init__(self, smoothing: float = GRADIENT_SMOOTHING, contrast: float = CONTRAST) -> None:
        super().__init__()
        self.smoothing = smoothing
        self.contrast = contrast

    @torch.no_grad()
    def forward(self, images: Tensor) -> Tensor:
        """Boundary strength of images: [B, 3, H, W] RGB in [0, 1] -> [B, H, W] in [0, 1].

        The result of an image does not depend on the other images, bit for bit.

        Raises:
            ValueError: a shape other than [B, 3, H, W].
        """
        if images.ndim != 4 or images.shape[1] != 3:
            raise ValueError(f"images: expected shape [B, 3, H, W], got {list(images.shape)}")
        if images.shape[0] == 0:
            return images[:, 0]
        return torch.stack(parallel_map(self._single, images))

    def _single(self, image: Tensor) -> Tensor:
        lab = smooth(to_lab(image.contiguous())[None], self.smoothing)
        padded = torch.nn.functional.pad(lab, (1, 1, 1, 1), mode="replicate")[0]
        right, down = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2], padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
        magnitude = torch.stack([right, down], 1).div_(2).square_().sum(dim=(0, 1)).sqrt_()
        return 1 - torch.exp(-magnitude / self.contrast)


def make_boundary(config: BoundaryConfig, allow_import: bool = False) -> nn.Module:
    """Makes the detector that a config names.

    Args:
        config: its name and parameters.
        allow_import: whether it may be code of the user. A config may come from a stranger, as that of a result.
    """
    if config.detector == "gradient":
        return GradientBoundary()
    if config.detector == "structured_forest":
        scales = MULTI_SCALE if config.multi_scale else (1.0,)
        return StructuredForestBoundary(config.model, scales)
    if not allow_import:
        raise ValueError(
            f"boundary.detector: expected gradient or structured_forest, got code, {config.detector}; "
            "allow_import=True imports it, if you trust it"
        )
    return _make_own(config.detector)


def _make_own(name: str) -> nn.Module:
    module, _, attribute = name.partition(":")
    try:
        detector = getattr(import_module(module), attribute)()
    except (ImportError, AttributeError, TypeError) as error:
        raise ValueError(f"boundary.detector: {name} cannot be made: {error}") from error
    if not isinstance(detector, nn.Module):
        raise ValueError(f"boundary.detector: expected {name}() to be a torch.nn.Module, got {type(detector).__name__}")
    return detector
