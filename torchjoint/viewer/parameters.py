"""The parameters that can change without seeing the frames again, beside the result of a run in memory."""

from __future__ import annotations

import dataclasses

from torchjoint.config import STAGES, Config
from torchjoint.joint import JointSegmenter
from torchjoint.results.result import Result
from torchjoint.scene import Scene

#: By method of step 6, the handful that somebody turns who looks at the result.
LIVE = {
    "learned": ("refinement.color_weight",),
    "regions": ("region_merging.threshold", "image_support.min_size", "refinement.color_weight"),
    "edges": ("point_segments.scale", "point_segments.min_size", "propagation.weight", "refinement.color_weight"),
    "scan": ("scan.gap", "scan.object_height", "scan.min_size", "refinement.color_weight"),
}


class LiveRun:
    """A run in memory: computes its result again with other parameters.

    Args:
        segmenter: after :meth:`~torchjoint.JointSegmenter.forward`.
        scene: what it segmented.
    """

    def __init__(self, segmenter: JointSegmenter, scene: Scene) -> None:
        self._segmenter, self._scene = segmenter, scene

    @property
    def parameters(self) -> dict[str, float]:
        """Names (stage.parameter) and values of the parameters that can be turned."""
        names = LIVE[self._segmenter.method]
        config = self._segmenter.config
        return {name: float(getattr(getattr(config, name.split(".")[0]), name.split(".")[1])) for name in names}

    def compute(self, values: dict[str, float]) -> Result:
        """The result with other values.

        Raises:
            ValueError: a value that is not allowed; the message names the parameter.
        """
        config: Config = self._segmenter.config
        for name, value in values.items():
            stage, _, parameter = name.partition(".")
            config = config.replace({stage: {parameter: _of_its_kind(stage, parameter, value)}})
        return Result.of(self._segmenter.with_config(config).compute(), self._scene, config)


def _of_its_kind(stage: str, parameter: str, value: float) -> float | int:
    default = next(spec.default for spec in dataclasses.fields(STAGES[stage]) if spec.name == parameter)
    return round(value) if isinstance(default, int) else value
