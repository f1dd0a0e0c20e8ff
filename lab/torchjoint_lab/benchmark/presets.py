"""The presets that the benchmark runs: those of the package, and those of method regions."""

from __future__ import annotations

from torchjoint.config import Config, presets
from torchjoint_lab.regions import PRESETS, RegionsConfig

#: Names of all presets.
NAMES = (*presets(), *PRESETS)


def preset_config(name: str) -> Config:
    """The parameters of a preset; those of method regions are a :class:`RegionsConfig`.

    Raises:
        ValueError, TypeError: an unknown preset, or a bad file; the message names it.
    """
    return RegionsConfig.from_preset(name) if name in PRESETS else Config.from_preset(name)
