"""Parameters that can be changed after all frames were seen, because the stored evidence does not depend on them."""

from __future__ import annotations

import dataclasses
from typing import TypeVar

from torchjoint.config.config import Config

C = TypeVar("C", bound=Config)


def evidence_config(config: C) -> C:
    """The config with the `afterwards` parameters at their defaults. Equal results mean equal stored evidence."""
    default = type(config)()
    stages = {}
    for stage in config.afterwards:
        given = dataclasses.asdict(getattr(config, stage))
        kept = {name: value for name, value in given.items() if f"{stage}.{name}" in config.before}
        stages[stage] = getattr(default, stage).replace(kept)
    return dataclasses.replace(config, **stages)


def evidence_differences(first: Config, second: Config) -> list[str]:
    """Names (stage.parameter) of the parameters that differ and that change the stored evidence."""
    one, other = evidence_config(first).to_dict(), evidence_config(second).to_dict()
    return [
        f"{stage}.{name}"
        for stage, values in one.items()
        for name, value in values.items()
        if value != other.get(stage, {}).get(name)
    ]
