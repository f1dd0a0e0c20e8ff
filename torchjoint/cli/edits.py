"""torchjoint edits: brings corrections that were made in another program back into a result."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from torchjoint.results import shared_edits
from torchjoint.results.boxes import read_boxes
from torchjoint.results.edits import FILE, read_edits
from torchjoint.results.folder import load_result, parts_of
from torchjoint.results.mask_report import masked_segments
from torchjoint.results.parts import Parts, edited
from torchjoint.runtime.messages import say
from torchjoint.runtime.outputs import check_no_input


def edits(
    action: tyro.conf.Positional[Literal["import"]],
    result: tyro.conf.Positional[Path],
    file: tyro.conf.Positional[Path],
) -> None:
    """Brings boxes or labels that were edited in another program back into a result, as corrections by hand.

    A thing whose box was deleted joins the one in whose box it lies; superpoints whose points have another label now go
    to the thing of that label; names come along. The labels of RESULT stay; RESULT/edits.json has the corrections, as
    those of the viewer, and `show`, `export` and `load_result` use them. What nobody edited changes nothing; what was
    corrected in RESULT after the export stays, and labels of points that would undo it are refused.

    Args:
        action: import.
        result: folder that `torchjoint segment` wrote, from which the file was exported, at its own level.
        file: .json of labelCloud (centroid_abs); .json of Segments.ai, a label of points or cuboids; .json of CVAT
            (annotations/default.json of format Datumaro 3D); .txt of OpenPCDet's custom data sets; or .csv or .geojson
            of `export`, with names that you have filled in (an empty one changes nothing; the viewer removes names).
    """
    check_no_input(file, parts_of(result), "FILE")
    stored = load_result(result, edits=False)
    parts, told = Parts(stored), f"{file}: is it of another result than {result}?"
    before = read_edits(result, parts.count, stored.manifest)
    labels, corrected = shared_edits.read_point_labels(file, len(stored.points)), edited(stored, before)
    if (names := shared_edits.read_names(file, corrected)) is not None:
        steps = shared_edits.edits_of_names(corrected, names, parts.of_point)
    elif labels is not None:
        steps, others = shared_edits.edits_of_points(parts, before, labels)
        if stored.hierarchy is not None and 2 * others > len(stored.points):
            raise ValueError(f"{told} {others} points have another label than most of their superpoint")
        table = parts.table(before)[parts.of_point]
        if stayed := len(np.setdiff1d(table, table[labels.of_point > 0])):
            say(f"things without a labelled point stay (join them in the viewer): {stayed}")
        if others:
            say(f"points that stay with their superpoint, most of which has another label: {others}")
    else:
        boxes, is_text = read_boxes(file), file.suffix.lower() == ".txt"
        # Corrections may have changed their segments.
        masked = corrected.points[np.isin(stored.points, masked_segments(result))].unique().tolist()
        steps, empty, stayed = shared_edits.edits_of_boxes(corrected, boxes, parts.of_point, is_text, masked)
        if len(empty) > max(1, len(boxes) / 2):
            raise ValueError(f"{told} {len(empty)} of {len(boxes)} boxes are those of no thing")
        if stayed:
            say(f"things without a box stay (they lie in no other box, or --only-masked had left them out): {stayed}")
        if empty:
            say(f"boxes of no thing (split in the viewer): {len(empty)}, such as box {empty[0]}")
    steps = shared_edits.without_older(steps, parts, before, file)
    gathered, joined, named = ([step.kind for step in steps].count(kind) for kind in ("gather", "join", "name"))
    say(f"things gathered: {gathered}, joined to others: {joined}, names changed: {named}")
    called, table = parts.names(before), parts.table(before)
    if gone := {called.get(table[step.superpoints[0]]) for step in steps if step.kind == "name"} - {None}:
        say(f"names that were replaced: {', '.join(sorted(map(repr, gone)))[:300]}")
    if steps:
        steps = tuple(replace(step, granularity=before.granularity) for step in steps)
        shared_edits.save_edits(result, replace(before, steps=before.steps + steps), before, parts)
        say(result / FILE)
