"""Where a result in the viewer is from, on which it depends what can be done with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from torchjoint.results.edits import Edits, read_edits
from torchjoint.results.parts import Parts
from torchjoint.results.result import Result
from torchjoint.viewer.parameters import LiveRun


@dataclass(frozen=True)
class Shown:
    """What belongs to a result that is shown.

    Attributes:
        folder: where corrections are read, saved (edits.json), and selections are exported; None: nowhere, so nothing
            can be corrected.
        run: the run that made the result, if it is still in memory: its parameters can then be changed on the page.
        is_running: the frames are still coming, and segments will change.
    """

    folder: Path | None = None
    run: LiveRun | None = None
    is_running: bool = False

    def edits(self, result: Result, granularity: float | None = None) -> Edits:
        """The corrections of the result on disk, at another level if one is given.

        Raises:
            ValueError: edits.json is damaged, or of another result.
        """
        count = Parts(result).count
        edits = Edits(count) if self.folder is None else read_edits(self.folder, count)
        return edits if granularity is None else replace(edits, granularity=granularity)
