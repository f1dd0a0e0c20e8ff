"""torchjoint edits: brings corrections that were made in another program back into a result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import tyro

from torchjoint.results.box_edits import edits_of_boxes
from torchjoint.results.boxes import read_boxes
from torchjoint.results.edits import FILE, read_edits, write_edits
from torchjoint.results.loading import load_result
from torchjoint.results.parts import Parts, edited


def edits(
    action: tyro.conf.Positional[Literal["import"]],
    result: tyro.conf.Positional[Path],
    boxes: tyro.conf.Positional[Path],
) -> None:
    """Brings boxes that were edited in another program back into a result, as corrections by hand.

    A thing whose box was deleted joins the one in whose box it lies; names of boxes become names of things. The labels
    stay; RESULT/edits.json has the corrections, as those of the viewer, and `show`, `export` and `load_result` use
    them. Boxes that nobody edited change nothing.

    Args:
        action: import.
        result: folder that `torchjoint segment` wrote, from which the boxes were exported, at its own level.
        boxes: .json of labelCloud (centroid_abs), or .txt of OpenPCDet's custom data sets.
    """
    found, stored = read_boxes(boxes), load_result(result, edits=False)
    parts = Parts(stored)
    before = read_edits(result, parts.count)
    changes = edits_of_boxes(edited(stored, before), found, parts.of_point)
    if changes.steps:
        steps = tuple(replace(step, granularity=before.granularity) for step in changes.steps)
        write_edits(result, replace(before, steps=before.steps + steps))
    print(f"{len(found)} boxes: {changes.joined} things joined others, {changes.named} names changed")
    if changes.empty:
        print(f"{len(changes.empty)} boxes are those of no thing, such as box {changes.empty[0]}; split in the viewer")
    if changes.steps:
        print(result / FILE)
