"""The folder and the run of a shown result; they determine which controls the viewer offers."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path

from torch import Tensor

from torchjoint.config import Config
from torchjoint.joint import JointSegmenter
from torchjoint.results.edits import Edits, read_edits
from torchjoint.results.parts import Parts
from torchjoint.results.result import Result
from torchjoint.scene import Scene

#: Names (stage.parameter) of the few parameters of each method that a user changes while looking at the result.
PARAMETERS = {
    "learned": ("refinement.color_weight",),
    "scan": ("scan.gap", "scan.object_height", "scan.min_size", "refinement.color_weight"),
    "paper": ("paper.scale", "paper.min_size", "paper.weight"),
}


class LiveRun:
    """A run in memory: computes its result again with other parameters.

    Args:
        segmenter: has finished :meth:`~torchjoint.JointSegmenter.forward`.
        scene: the segmented scene.
    """

    def __init__(self, segmenter: JointSegmenter, scene: Scene) -> None:
        self._segmenter, self._scene = segmenter, scene

    @property
    def parameters(self) -> dict[str, float]:
        """Names (stage.parameter) and values of the parameters that can be changed."""
        names = PARAMETERS.get(self._segmenter.method.name, PARAMETERS["learned"])
        return {name: float(attrgetter(name)(self._segmenter.config)) for name in names}

    def compute(self, values: dict[str, float]) -> Result:
        """Computes the result of other values.

        Raises:
            ValueError: a value is out of range; the message names the parameter.
        """
        config: Config = self._segmenter.config
        whole = {name for name in values if isinstance(attrgetter(name)(config), int)}
        config = config.set([f"{name}={round(value) if name in whole else value}" for name, value in values.items()])
        return Result.of(self._segmenter.compute(config=config), self._scene, config)


@dataclass(frozen=True)
class Shown:
    """The folder and the run of a shown result."""

    folder: Path | None = None  #: for corrections (edits.json); None: the result cannot be corrected
    #: the run that made the result, if it is still in memory; its parameters can then be changed on the page
    run: LiveRun | None = None
    is_running: bool = False  #: whether the run is not finished, so that segments will change
    has_camera: bool = False  #: whether a camera moves through a cloud that grows
    #: makes a vector [D] of words, as the encoder of the result's embeddings made them of images
    text_encoder: Callable[[str], Tensor] | None = None

    def edits(self, result: Result, granularity: float | None = None) -> Edits:
        """The corrections of the result on disk, at another level if one is given."""
        count = Parts(result).count
        edits = Edits(count) if self.folder is None else read_edits(self.folder, count, result.manifest)
        return edits if granularity is None else replace(edits, granularity=granularity)
