"""torchjoint label: puts the labels of a result into a cloud, a survey, a mesh or Gaussian splats."""

from pathlib import Path

import tyro

from torchjoint.cli.arguments import OptionalOut, output_file, output_files_in
from torchjoint.cli.output import at_level
from torchjoint.datasets.files import las, text_clouds
from torchjoint.datasets.files.clouds import SUFFIXES
from torchjoint.results.folder import load_result, parts_of
from torchjoint.results.labelled_file import label_file, part_files
from torchjoint.runtime.foreign_files import is_there
from torchjoint.runtime.messages import say


def label(
    result: tyro.conf.Positional[Path],
    file: tyro.conf.Positional[Path],
    out: OptionalOut = None,
    granularity: float | None = None,
    name: str = "label",
    overwrite: bool = False,
) -> None:
    """Puts the labels of a result into the file of a cloud, a survey, a mesh or Gaussian splats.

    Each vertex gets the label of the nearest point of RESULT.

    Args:
        result: folder that `torchjoint segment` wrote.
        file: a .ply, .las, .laz, .obj, .glb, .gltf, .off, .stl, .csv, .txt, .xyz, .asc or .pts in the frame of RESULT;
            mostly the file that was segmented. .las and .laz need `pip install 'torchjoint[las]'`, meshes
            `'torchjoint[mesh]'`.
        out: .ply: FILE with labels of its vertices and triangles; all else in a .ply stays, to the byte. .las, .laz:
            FILE with the dimensions NAME and NAME_confidence (`confidence`, if it is free); all else stays. .csv, .txt,
            .xyz, .asc, .pts: the rows of FILE with one more column. .glb: the mesh in the colours of the segments, one
            node for each. A folder: a .ply for each segment, with all properties of FILE's vertices. Default:
            FILE-labelled with the suffix of FILE, or .ply.
        granularity: another level than RESULT holds, 0 (coarse) to 1 (fine), without joins and splits by hand; not with
            method paper.
        name: of the property of the labels in a .ply, of the dimension in a .las, or of the column in text.
        overwrite: replace OUT; a folder must hold nothing but the .ply files of an earlier run.
    """
    loaded = at_level(result, load_result(result), granularity)
    if not is_there(file):
        cloud = min(result.glob("cloud-*mm.ply"), default=result / "points.ply")
        raise FileNotFoundError(f"{file} does not exist; the cloud of this result is {cloud}")
    kinds = ".ply", ".glb", *las.SUFFIXES, *text_clouds.SUFFIXES
    out = out or Path(f"{file.stem}-labelled{file.suffix if file.suffix.lower() in kinds else '.ply'}")
    is_file = out.suffix.lower() in kinds
    if not is_file and out.suffix.lower() in SUFFIXES and not out.is_dir():
        raise ValueError(f"-o: expected a file that ends in {', '.join(kinds)}, or a folder, got {out}")
    inputs = (file, *parts_of(result))
    made = output_file(out, overwrite, inputs) if is_file else output_files_in(out, (".ply",), overwrite, inputs)
    if not name.isidentifier():
        raise ValueError(f"--name: expected letters, digits and _, got {name!r}")
    with made.written() as path:
        if is_file:
            label_file(file, path, loaded, name=name)
        else:
            part_files(file, path, loaded)
    say(out)
