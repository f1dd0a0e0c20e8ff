"""What a command says about its run."""

import warnings
from collections.abc import Mapping
from pathlib import Path

from torchjoint.results.edits import FILE as EDITS
from torchjoint.results.folder import read_record
from torchjoint.results.mask_report import count_masks, names_of_masks
from torchjoint.results.result import Result
from torchjoint.runtime.foreign_files import has_file, read_json
from torchjoint.runtime.messages import counted, say
from torchjoint.scene import Segmentation


def tell_of_edits(result: Path, told: str) -> None:
    """Warns if a result has corrections."""
    if has_file(result / EDITS) and read_json(result / EDITS, "a list of edits")["edits"]:
        warnings.warn(f"{result / EDITS}: {told}", stacklevel=4)


def at_level(result: Path, loaded: Result, granularity: float | None) -> Result:
    """A result at another level, with a warning if this leaves corrections out; None: as it is."""
    if granularity is None:
        return loaded
    tell_of_edits(result, "--granularity gives a level without joins and splits; names stay where a segment has one")
    found = loaded.at(granularity)
    if names_of_masks(result) and found.num_point_segments > loaded.num_point_segments:
        told = "smaller things have the names of those that they are parts of; segment --granularity votes on names"
        warnings.warn(f"{result}: {told}", stacklevel=3)
    return found


def summarize(result: Segmentation, out: Path) -> None:
    """Prints the numbers of points, segments and images, the seconds of the run, and the written files."""
    _, parts = read_record(out)
    images = f", {counted(len(result.images), 'image')}" if len(result.images) else ""
    say(f"{len(result.points)} points in {counted(result.num_point_segments, 'segment')}{images}")
    say(f"{sum(parts.values()):.1f} seconds: {_listed(parts)}")
    say(f"segmenting, added up over threads: {_listed(result.seconds)}")
    if (masks := count_masks(out)) is not None:
        alone = f", {masks[1]} one of their image alone" if masks[1] else "" if masks[2] else ": their files have none"
        say(f"masks: {masks[0]} of {masks[2]} became a segment{alone} (IoU at least .5); masks.json tells of each")
    files = sorted(one for one in out.iterdir() if one.is_file() or any(one.iterdir()))
    say(f"written to {out}: {', '.join(one.name + '/' * one.is_dir() for one in files)} (docs/quickstart.md)")


def _listed(seconds: Mapping[str, float]) -> str:
    return ", ".join(f"{part} {value:.1f}" for part, value in seconds.items())
