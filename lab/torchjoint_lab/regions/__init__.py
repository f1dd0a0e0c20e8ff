"""Step 6, method regions: hand-made costs of boundaries, and the presets that were tuned with it."""

from __future__ import annotations

from torchjoint.joint import JointSegmenter
from torchjoint_lab.regions.config import PRESETS, RegionsConfig
from torchjoint_lab.regions.method import REGIONS

__all__ = ["PRESETS", "REGIONS", "RegionsConfig", "segmenter"]


def segmenter(preset: str) -> JointSegmenter:
    """A segmenter with method regions.

    Args:
        preset: one of PRESETS, or a YAML file.

    Raises:
        ValueError, TypeError: an unknown preset, or a bad file; the message names it.
    """
    return JointSegmenter(RegionsConfig.from_preset(preset), method=REGIONS)
