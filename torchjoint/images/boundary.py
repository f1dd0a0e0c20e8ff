"""Step 1: the boundary detector that a config names; and the one by gradients."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from threading import Lock
from typing import Any

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


def to_lab(colors: Tensor) -> Tensor:
    """RGB in [0, 1] -> CIE Lab, [..., 3, H, W] each."""
    import kornia  # here, because it takes a tenth of a second, and many commands need none

    with _exact_products():
        return kornia.color.rgb_to_lab(colors)


_SETTING = Lock()


@contextmanager
def _exact_products() -> Iterator[None]:
    """Torch may be set to round matrix products to bfloat16, by one function for all devices or for the CPU; not here.

    The setting is that of all threads.
    """
    put: Callable[[str], None]
    with _SETTING:
        try:
            before, put, exact = torch.get_float32_matmul_precision(), torch.set_float32_matmul_precision, "highest"
        except RuntimeError:  # it was not set by the function
            of_cpu: Any = torch.backends.mkldnn.matmul  # type: ignore[attr-defined]
            before, put, exact = of_cpu.fp32_precision, partial(setattr, of_cpu, "fp32_precision"), "ieee"
        if before != exact:
            put(exact)
        try:
            yield
        finally:
            if before != exact:
                put(before)


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
        return torch.stack(parallel_map(self._single, images)) if len(images) else images[:, 0]

    def _single(self, image: Tensor) -> Tensor:
        lab = smooth(to_lab(image[None].contiguous()), self.smoothing)
        return 1 - torch.exp(-_gradient(lab[0]).square_().sum(dim=(0, 1)).sqrt_() / self.contrast)


def _gradient(values: Tensor) -> Tensor:
    """Central differences to the right and down, with replicated image borders: [C, H, W] -> [C, 2, H, W]."""
    # The same as kornia's spatial_gradient(mode="diff"), but ten times faster than its convolution.
    height, width = values.shape[1:]
    padded = torch.nn.functional.pad(values[None], (1, 1, 1, 1), mode="replicate")[0]
    gradient = values.new_empty(values.shape[0], 2, height, width)
    torch.sub(padded[:, 1:-1, 2:], padded[:, 1:-1, :-2], out=gradient[:, 0])
    torch.sub(padded[:, 2:, 1:-1], padded[:, :-2, 1:-1], out=gradient[:, 1])
    return gradient.div_(2)


def make_boundary(config: BoundaryConfig, allow_import: bool = False) -> nn.Module:
    """Makes the detector that a config names.

    Args:
        config: its name and parameters.
        allow_import: whether it may be code of the user. A config may come from a stranger, as that of a result.
    """
    if config.detector == "gradient":
        return GradientBoundary()
    if config.detector == "structured_forest":
        return StructuredForestBoundary(config.model, MULTI_SCALE if config.multi_scale else (1.0,))
    if not allow_import:
        told = f"boundary.detector: expected gradient or structured_forest, got code, {config.detector}"
        raise ValueError(f"{told}; allow_import=True imports it, if you trust it")
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
