"""The parameters (all steps) as Markdown tables, as the documents show them."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from torchjoint.config.config import Config, presets
from torchjoint.config.superpoints import SuperpointsConfig


def marked_parameters() -> dict[str, dataclasses.Field[Any]]:
    """The few parameters that users change by name (stage.parameter), in the order of the method's steps."""
    return {
        f"{name}.{spec.name}": spec
        for name, stage in Config.stages().items()
        for spec in dataclasses.fields(stage)
        if spec.metadata["too_low"]
    }


def marked_table() -> str:
    """The parameters that users change, and what a bad value looks like, as one Markdown table."""
    rows = {
        marked: [spec.metadata[key] for key in ("default", "unit", "sensible", "too_low", "too_high")]
        for marked, spec in marked_parameters().items()
    }
    return _table(["default"], ["unit", "sensible", "too low looks like", "too high looks like"], rows)


def parameter_table(stage: str | None = None) -> str:
    """All parameters as Markdown tables, one per stage, or the table of one stage. Stages of the default come first.

    Raises:
        ValueError: an unknown stage.
    """
    stages = Config.stages()
    if stage is not None and stage not in stages:
        raise ValueError(f"{stage}: unknown stage, expected one of {', '.join(stages)}")
    parts = []
    for name in stages if stage is None else [stage]:
        rows = {}
        for spec in dataclasses.fields(stages[name]):
            meta = spec.metadata
            doc = meta["doc"] + (f" (one of: {', '.join(meta['choices'])})" if meta["choices"] else "")
            default = "null" if spec.default is None else spec.default
            rows[spec.name] = [default, meta["unit"], meta["sensible"], doc]
        title = (stages[name].__doc__ or "").split("\n")[0].rstrip(".")
        parts.append(f"**`{name}`**: {title}.\n\n{_table(['default'], ['unit', 'sensible', 'what it does'], rows)}")
    return "\n\n".join(parts)


def superpoint_table() -> str:
    """All parameters of superpoints and their values in each preset as one Markdown table."""
    configs = {name: SuperpointsConfig.from_preset(name) for name in presets("superpoints")}
    rows = {
        spec.name: [getattr(config, spec.name) for config in configs.values()]
        + [spec.metadata[key] for key in ("unit", "sensible", "doc")]
        for spec in dataclasses.fields(SuperpointsConfig)
    }
    return _table([f"`{name}`" for name in configs], ["unit", "sensible", "what it does"], rows)


def _table(numbers: Sequence[str], texts: Sequence[str], rows: Mapping[str, Sequence[object]]) -> str:
    """A Markdown table of parameters, by their names: columns of numbers, then of texts."""
    head = f"| parameter | {' | '.join([*numbers, *texts])} |\n|---|{'---:|' * len(numbers)}{'---|' * len(texts)}"
    return "\n".join([head, *(f"| `{name}` | {' | '.join(map(str, cells))} |" for name, cells in rows.items())])
