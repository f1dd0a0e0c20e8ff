"""Parameters of steps 3 and 5-8 that can still be changed after all frames were seen.

What a segmenter stores of the frames does not depend on these parameters.
"""

from __future__ import annotations

import dataclasses

from torchjoint.config.config import STAGES, Config


def _all_of(stage: str) -> tuple[str, ...]:
    return tuple(spec.name for spec in dataclasses.fields(STAGES[stage]))


_STEP_6 = (
    "point_segments",
    "pieces",
    "region_merging",
    "image_support",
    "occlusion_bridging",
    "scan",
)

AFTERWARDS = {
    "point_graph": ("distance_weight", "convex_factor", "color_weight"),
    "propagation": ("overlap_threshold", "normalization", "weight"),
    **{stage: _all_of(stage) for stage in (*_STEP_6, "refinement")},
}


def evidence_config(config: Config) -> Config:
    """The config with the AFTERWARDS parameters at their defaults: two configs with equal results store the same."""
    default = Config().to_dict()
    # Regions and edges store the same. Scan builds no graph, so it collects no evidence from images. Learned chooses
    # the neighbours of the graph itself. Auto is one of these two.
    method = config.point_segments.method
    default["point_segments"]["method"] = "regions" if method == "edges" else method
    return config.replace(
        {stage: {name: default[stage][name] for name in names} for stage, names in AFTERWARDS.items()}
    )


def evidence_differences(first: Config, second: Config) -> list[str]:
    """Names (stage.parameter) of the parameters that differ and on which the stored observations depend."""
    one, other = evidence_config(first), evidence_config(second)
    return [
        f"{stage.name}.{spec.name}"
        for stage in dataclasses.fields(one)
        for spec in dataclasses.fields(getattr(one, stage.name))
        if getattr(getattr(one, stage.name), spec.name) != getattr(getattr(other, stage.name), spec.name)
    ]
