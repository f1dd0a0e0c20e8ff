"""Step 1: makes the boundary detector, a module from images [B, 3, H, W] to boundary strength [B, H, W] in [0, 1].

Any :class:`torch.nn.Module` of this signature can replace it: ``JointSegmenter(boundary=module)``.
"""

from __future__ import annotations

from importlib import import_module

from torch import nn

from torchjoint.config import BoundaryConfig
from torchjoint.images.gradient_boundary import GradientBoundary
from torchjoint.images.structured_forest import MULTI_SCALE, StructuredForestBoundary


def make_boundary(config: BoundaryConfig, allow_import: bool = False) -> nn.Module:
    """Makes the detector that a config names.

    Args:
        config: its name and parameters.
        allow_import: whether it may be code of the user. A config may come from a stranger, as that of a result.

    Raises:
        ValueError: the user's module may not be imported, cannot be imported or made without arguments, or is no
            :class:`torch.nn.Module`.
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
