"""The parameters (all steps) as Markdown tables, as the documents show them."""

import dataclasses
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
    lines = [
        "| parameter | default | unit | sensible | too low looks like | too high looks like |",
        "|---|---:|---|---|---|---|",
    ]
    for marked, spec in marked_parameters().items():
        cells = (spec.metadata[key] for key in ("default", "unit", "sensible", "too_low", "too_high"))
        lines.append(f"| `{marked}` | {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def parameter_table(stage: str | None = None) -> str:
    """All parameters as Markdown tables, one per stage, or the table of one stage. Stages of the default come first.

    Raises:
        ValueError: an unknown stage.
    """
    stages = Config.stages()
    if stage is not None and stage not in stages:
        raise ValueError(f"{stage}: unknown stage, expected one of {', '.join(stages)}")
    parts = []
    for name, parameters in stages.items():
        if stage not in (None, name):
            continue
        rows = []
        for spec in dataclasses.fields(parameters):
            meta = spec.metadata
            default = "null" if spec.default is None else f"{spec.default}"
            doc = meta["doc"] + (f" (one of: {', '.join(meta['choices'])})" if meta["choices"] else "")
            rows.append(f"| `{spec.name}` | {default} | {meta['unit']} | {meta['sensible']} | {doc} |")
        title = (parameters.__doc__ or "").split("\n")[0].rstrip(".")
        head = "| parameter | default | unit | sensible | what it does |\n|---|---:|---|---|---|"
        parts.append(f"**`{name}`**: {title}.\n\n{head}\n" + "\n".join(rows))
    return "\n\n".join(parts)


def superpoint_table() -> str:
    """All parameters of superpoints and their values in each preset as one Markdown table."""
    configs = {name: SuperpointsConfig.from_preset(name) for name in presets("superpoints")}
    lines = [
        f"| parameter | {' | '.join(f'`{name}`' for name in configs)} | unit | sensible | what it does |",
        f"|---|{'---:|' * len(configs)}---|---|---|",
    ]
    for spec in dataclasses.fields(SuperpointsConfig):
        meta = spec.metadata
        values = " | ".join(f"{getattr(config, spec.name)}" for config in configs.values())
        lines.append(f"| `{spec.name}` | {values} | {meta['unit']} | {meta['sensible']} | {meta['doc']} |")
    return "\n".join(lines)
