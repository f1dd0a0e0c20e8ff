"""Clicks in the viewer that pick a thing: on it, and beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch

from torchjoint.results.edits import Edits, Table
from torchjoint.results.parts import Parts
from torchjoint.results.result import Result


class Click(NamedTuple):
    """A click on a point of the cloud."""

    point: int
    belongs: bool  #: to the thing; False: the thing ends before it


def pieces_of_clicks(parts: Parts, edits: Edits, clicks: Sequence[Click]) -> Table:
    """The pieces of the thing of one or more clicks, ascending; a single click gives the corrected segment.

    Raises:
        ValueError: no click is on the thing, or two that disagree are in one piece.
    """
    if len(clicks) == 1 and clicks[0].belongs:
        table = parts.table(edits)
        return np.flatnonzero(table == table[parts.of_point[clicks[0].point]])
    on, off = (
        torch.tensor([one.point for one in clicks if one.belongs == of], dtype=torch.int64) for of in (True, False)
    )
    return _at_level(parts.result, edits.granularity).pick(on, negative=off).pieces.numpy()


def _at_level(result: Result, level: float | None) -> Result:
    """The result whose default level is the shown one."""
    if result.hierarchy is None or level is None:
        return result
    return replace(result, hierarchy=replace(result.hierarchy, default=result.hierarchy.height_of(level)))
