"""The folder and the run of a shown result; they determine which controls the viewer offers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from torch import Tensor

from torchjoint.results.edits import Edits, read_edits
from torchjoint.results.parts import Parts
from torchjoint.results.result import Result
from torchjoint.viewer.parameters import LiveRun


@dataclass(frozen=True)
class Shown:
    """The folder and the run of a shown result."""

    folder: Path | None = None  #: for corrections (edits.json); None: the result cannot be corrected
    #: the run that made the result, if it is still in memory; its parameters can then be changed on the page
    run: LiveRun | None = None
    is_running: bool = False  #: whether the run is not finished, so that segments will change
    #: makes a vector [D] of words, as the encoder of the result's embeddings made them of images
    text_encoder: Callable[[str], Tensor] | None = None

    def edits(self, result: Result, granularity: float | None = None) -> Edits:
        """The corrections of the result on disk, at another level if one is given.

        Raises:
            ValueError: edits.json is damaged, or belongs to another result.
        """
        count = Parts(result).count
        edits = Edits(count) if self.folder is None else read_edits(self.folder, count)
        return edits if granularity is None else replace(edits, granularity=granularity)
