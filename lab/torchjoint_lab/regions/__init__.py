"""Step 6, method regions: hand-made costs of boundaries, and the presets that were tuned with it."""

from __future__ import annotations

from torch import Tensor

from torchjoint.config import Config
from torchjoint.joint import JointSegmenter
from torchjoint_lab.regions.config import PRESETS, RegionsConfig
from torchjoint_lab.regions.method import Regions

__all__ = ["PRESETS", "Regions", "RegionsConfig", "make_regions", "segmenter"]


def segmenter(preset: str) -> JointSegmenter:
    """A segmenter with method regions.

    Args:
        preset: one of PRESETS, or a YAML file.

    Raises:
        ValueError, TypeError: an unknown preset, or a bad file; the message names it.
    """
    return JointSegmenter(RegionsConfig.from_preset(preset), method=make_regions)


def make_regions(config: Config, points: Tensor) -> Regions:
    """Makes method regions, for any points; used as ``JointSegmenter(config, method=make_regions)``."""
    return Regions(config)
