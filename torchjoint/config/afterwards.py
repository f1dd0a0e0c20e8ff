"""Parameters that can still be changed when all frames have been seen: what was seen does not depend on them."""

from __future__ import annotations

import dataclasses

from torchjoint.config.config import STAGES, Config


def _all_of(stage: str) -> tuple[str, ...]:
    return tuple(spec.name for spec in dataclasses.fields(STAGES[stage]))


_STEP_6 = (
    "point_segments",
    "regions",
    "pieces",
    "region_merging",
    "image_support",
    "occlusion_bridging",
    "scan",
)

AFTERWARDS = {
    "point_graph": ("distance_weight", "angle_weight", "convex_factor", "color_weight"),
    "propagation": ("overlap_threshold", "normalization", "saturation", "weight"),
    **{stage: _all_of(stage) for stage in (*_STEP_6, "refinement")},
}


def what_is_seen(config: Config) -> Config:
    """The config with its afterwards parameters at their defaults: equal ones see the same."""
    default = Config().to_dict()
    if config.point_segments.method == "scan":  # for which no graph is made, and so no evidence of images is gathered
        default["point_segments"]["method"] = "scan"
    return config.replace(
        {stage: {name: default[stage][name] for name in names} for stage, names in AFTERWARDS.items()}
    )


def seen_otherwise(first: Config, second: Config) -> list[str]:
    """The parameters, as stage.parameter, in which two configs see different things."""
    one, other = what_is_seen(first), what_is_seen(second)
    return [
        f"{stage.name}.{spec.name}"
        for stage in dataclasses.fields(one)
        for spec in dataclasses.fields(getattr(one, stage.name))
        if getattr(getattr(one, stage.name), spec.name) != getattr(getattr(other, stage.name), spec.name)
    ]
