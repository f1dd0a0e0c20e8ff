"""Reads a result's folder, with its scene and the corrections by hand (output after step 8)."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from torchjoint.results.edits import FILE, read_edits
from torchjoint.results.embeddings import read_embeddings
from torchjoint.results.folder import read_config, read_points, read_record, read_result
from torchjoint.results.inputs import CAMERAS, read_inputs
from torchjoint.results.manifest import open_manifest, unchecked
from torchjoint.results.mask_report import names_of_masks
from torchjoint.results.parts import Parts, edited
from torchjoint.results.result import Result
from torchjoint.runtime.foreign_files import has_file
from torchjoint.runtime.threads import on_cpu
from torchjoint.scene import Scene, Segmentation


@on_cpu()
def load_result(folder: str | Path, *, edits: bool = True, verify: bool = True) -> Result:
    """Reads a folder that ``torchjoint segment`` wrote: labels, all levels, the cloud, cameras and parameters.

    :attr:`Result.embeddings <torchjoint.results.result.Result.embeddings>` are those that were saved with it.

    Images and frames are read when they are used, in the order of their names. Frames have the images as they were
    saved, in JPEG. A result of an earlier version has no frames.

    The files must be those that the run wrote: manifest.json has their checksums. Images are compared when they are
    read.

    Args:
        folder: the result.
        edits: apply the corrections of edits.json, if there are any; ids are then renumbered. Levels from
            :meth:`~torchjoint.Segmentation.at` do not contain the corrections.
        verify: False: also read a result whose files were changed, lost or exchanged after the run.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError, TypeError: a file is damaged or of another result; the message names it.

    Example::

        result = load_result("out/")
        result.images[0], result.at(0.3), result.crops(7, k=3)[0].image
    """
    folder = Path(folder)
    stored, config = read_points(folder), read_config(folder)
    check = open_manifest(folder) if verify else unchecked
    segmentation = read_result(folder, check)
    if verify:
        _check_counts(folder, segmentation)
    frames = read_inputs(folder, segmentation.names, check) if has_file(folder / CAMERAS) else ()
    scene = Scene(stored.points, frames, stored.colors, name=folder.resolve().name)
    values = {one.name: getattr(segmentation, one.name) for one in fields(Segmentation)}
    vectors = read_embeddings(folder, len(stored.points))
    names = names_of_masks(folder)
    result = Result(**values, scene=scene, config=config, saved_embeddings=vectors, segment_names=names)
    if not edits or not has_file(folder / FILE):
        return result
    return edited(result, read_edits(folder, Parts(result).count))


def _check_counts(folder: Path, result: Segmentation) -> None:
    """Compares the counts of run.yaml, which also version 0.1.0 wrote."""
    expected, _ = read_record(folder)
    got = {"points": len(result.points), "frames": len(result.images), "point_segments": result.num_point_segments}
    if expected != got:
        raise ValueError(f"{folder}: expected the counts of run.yaml, {expected}, got {got}; of another result?")
