"""torchjoint export: writes a result in the format of another tool."""

import warnings
from pathlib import Path
from typing import Literal

import torch
import tyro

from torchjoint.cli.arguments import OptionalOut, output_file, output_files_in
from torchjoint.cli.output import at_level, tell_of_edits
from torchjoint.datasets.files import las
from torchjoint.datasets.files.ply import write_cloud
from torchjoint.datasets.files.readers import fingerprint
from torchjoint.results.boxes import has_level_axes, upright_points
from torchjoint.results.exports import FORMATS, SUFFIXES
from torchjoint.results.exports.boxes import export_geojson, export_labelcloud_classes
from torchjoint.results.folder import load_result, parts_of, read_origin
from torchjoint.results.labelled_file import label_file
from torchjoint.results.mask_report import select_masked
from torchjoint.runtime.messages import say

#: What a folder of a format has in it.
_IN_FOLDER = {"sam": (".json",), "ply": (".ply",), "scannet": (".txt",), "openmask3d": (".pt", ".npy")}
#: A second suffix that the file of a format may have.
_ALSO = {"las": ".laz", "geojson": ".json"}

#: What has boxes that turn about z alone.
_BOXES = ("openpcdet", "labelcloud", "segmentsai-cuboids", "cvat")

Format = Literal[
    "coco", "sam", "ply", "las", "npz", "csv", "geojson", "scannet", "masks", "openmask3d", "graph", "openpcdet",
    "labelcloud", "segmentsai", "segmentsai-cuboids", "cvat",
]  # fmt: skip


def export(
    result: tyro.conf.Positional[Path],
    format: Format,
    out: OptionalOut = None,
    granularity: float | None = None,
    only_masked: bool = False,
    overwrite: bool = False,
) -> None:
    """Writes a result in the format of another tool.

    Args:
        result: folder that `torchjoint segment` wrote.
        format: coco: COCO's JSON of instances, for all images; sam: a JSON for each image, as in SA-1B; ply: a cloud
            for each segment; las: the .las or .laz that was segmented, with all that it has, and the dimensions `label`
            and `confidence` (other clouds: points, colours and these); npz: all labels as arrays; csv: a line for each
            segment: name, points, place, size, confidence; geojson: the same with the footprint of each segment, seen
            along z, in the coordinate system of the .las or .laz that was segmented; scannet: instances as its
            benchmark reads them, SCENE.txt and predicted_masks/; masks: the same as an archive with pred_masks,
            pred_score and pred_classes; openmask3d: SCENE_masks.pt and the saved embeddings,
            SCENE_openmask3d_features.npy; graph: what stands on what, as "relations" in RESULT/segments.json, without
            corrections; openpcdet, labelcloud,
            segmentsai-cuboids, cvat: upright boxes with names, for networks of detection and for annotation, and
            OUT.ply, the cloud turned, if z is not up in RESULT (labelcloud: and _classes.json beside it, unless there);
            segmentsai: the label of each point, for annotation (`torchjoint edits import` brings boxes and labels
            back). coco, sam and las need `pip install 'torchjoint[export]'`.
        out: file, or folder for sam, ply, scannet and openmask3d; default: RESULT-FORMAT in the current folder, with
            the format's suffix (.laz if RESULT is of a .laz).
        granularity: another level than RESULT holds, 0 (coarse) to 1 (fine), without joins and splits by hand; not with
            method paper.
        only_masked: only what the masks of the run show: segments that lie in masks with at least half of their pixels.
            The others are -1, or left out. Corrections by hand are not in it.
        overwrite: replace OUT.
    """
    if only_masked and granularity is not None:
        raise ValueError("--only-masked: expected no --granularity, because masks are compared with the stored level")
    if format == "graph":
        if out is not None or granularity is not None or only_masked:
            raise ValueError("--format graph adds to segments.json: expected no -o, --granularity, --only-masked")
        tell_of_edits(result, "--format graph leaves corrections by hand out; load_result(RESULT).graph() has them")
        load_result(result, edits=False).graph().save(result)
        say(result / "segments.json")
        return
    loaded = load_result(result, edits=not only_masked)
    if only_masked:
        tell_of_edits(result, "--only-masked leaves corrections by hand out; do not import OUT")
        loaded = select_masked(result, loaded)
    loaded = at_level(result, loaded, granularity)
    is_laz = format == "las" and read_origin(result).scene.lower().endswith(".laz")
    out = out or Path(f"{result.resolve().name}-{format}{'.laz' if is_laz else SUFFIXES.get(format, '')}")
    inputs, kinds = parts_of(result), _IN_FOLDER.get(format)
    made = output_files_in(out, kinds, overwrite, inputs) if kinds else output_file(out, overwrite, inputs)
    ends = [one for one in (SUFFIXES.get(format), _ALSO.get(format)) if one]
    if ends and out.suffix.lower() not in ends:
        raise ValueError(f"-o: expected a name that ends in {' or '.join(ends)}, got {out}")
    is_turned = format in _BOXES and not has_level_axes(loaded.scene)
    # A cloud of this name without boxes is a user's.
    turned = output_file(out.with_suffix(".ply"), overwrite and out.exists(), [*inputs, out]) if is_turned else None
    with made.written() as path:
        if format == "geojson":
            export_geojson(path, loaded, las.epsg_of(survey) if (survey := _survey(result)) else None)
        elif format == "las" and (survey := _survey(result)) is not None:
            label_file(survey, path, loaded)
        else:
            FORMATS[format](path, loaded)
    say(out)
    if format == "labelcloud" and ((classes := out.with_name("_classes.json")).exists() or classes.is_symlink()):
        say(f"{classes}: was there, and stays; delete it to have the names of this result in labelCloud")
    elif format == "labelcloud":
        with output_file(classes, False, inputs).written() as path:
            export_labelcloud_classes(path, loaded)
        say(f"{classes}: the names, and that angles are degrees; labelCloud reads it beside {out.name}")
    if turned is not None:
        with turned.written() as path:
            points = torch.from_numpy(upright_points(loaded.scene)).to(loaded.scene.points.dtype)
            write_cloud(path, points, loaded.scene.colors)
        say(f"{turned.path}: the cloud turned so that z is up, to which the boxes belong")


def _survey(result: Path) -> Path | None:
    """The .las or .laz that was segmented; None, with a warning, if it is gone or another; None for other inputs."""
    origin = read_origin(result)
    source = Path(origin.scene)
    if source.suffix.lower() not in las.SUFFIXES:
        return None
    # The record may come from others, and name any file: who did not segment it does not know its fingerprint.
    if source.is_file() and fingerprint(source) == origin.fingerprint:
        return source
    told = "not there any more, or changed since; OUT has neither its coordinate system nor its other dimensions"
    way_out = "`torchjoint label RESULT FILE -o OUT.laz` puts the labels into the file as it is now"
    warnings.warn(f"{source}: {told}; {way_out}", stacklevel=3)
    return None
