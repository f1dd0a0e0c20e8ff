"""Reads COLMAP's reconstructions (J. Schönberger, J.-M. Frahm, "Structure-from-Motion Revisited", CVPR 2016).

sparse/N, sparse, or the folder itself    the model: cameras, images and points3D, .bin or .txt; of several sparse/N the
                                          one with most images, which a warning tells. rigs and frames of COLMAP 3.12
                                          and later are not needed: images have whole poses there, too
images, or images_2, _4, _8               the images, in the first folder that holds the model's names; or in the folder
                                          itself
cloud.ply, fused.ply, dense/fused.ply,    the cloud, the first that exists; otherwise the model's sparse points, which
dense/N/fused.ply                         are few for a segmentation; N is that of sparse/N; of several models only this

If the given folder is the model itself, images and clouds are also searched in its parent and grandparent folders.
Images may be resized, but not cropped; lens distortion is removed. The scale of a reconstruction is arbitrary: its
"metres" are the model's unit, unless the model was aligned.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from torchjoint.datasets.files.colmap_model import has_model, read_images, read_points
from torchjoint.datasets.files.text import frame_names, path_inside
from torchjoint.datasets.recording import Options, Shot, find_cloud, read_shots, scene_of_frames, tell_unlisted
from torchjoint.runtime.foreign_files import has_file, has_folder, present
from torchjoint.scene import Frame, Scene

WHAT = "COLMAP's cameras and images (.bin or .txt) in sparse/0, in sparse, or in the folder itself"

_IMAGES = ("images", "images_2", "images_4", "images_8", ".")


def recognizes(path: Path) -> bool:
    """Returns whether the folder has a sparse model."""
    return has_folder(path) and bool(_models(path))


def load(path: Path, options: Options) -> Scene:
    """Loads the folder; see :func:`torchjoint.load_scene`."""
    models = _models(path)
    model = _largest(path, models)
    around = list(path.absolute().parents)[:2] if model == path else []
    frames = _read_frames(model, [path, *around])
    number = model.name if model.name.isdigit() else "0"
    names = ["fused.ply", "dense/fused.ply"] if len(models) == 1 and number == "0" else []
    clouds = [base / name for base in (path, *around) for name in (*names, f"dense/{number}/fused.ply")]
    if find_cloud(path, options, clouds) is not None:
        return scene_of_frames(path, frames, options, clouds)
    points, colors = read_points(model)
    return Scene(points, frames, colors, name=path.name)


def _models(path: Path) -> list[Path]:
    """The models of which one is read: COLMAP numbers those of parts that it could not join."""
    numbered = (path / "sparse").glob("[0-9]*") if has_folder(path / "sparse") else ()
    parts = sorted((one for one in numbered if one.name.isdigit() and has_model(one)), key=lambda one: int(one.name))
    return parts or [one for one in (path / "sparse", path) if has_model(one)][:1]


def _largest(path: Path, models: Sequence[Path]) -> Path:
    if len(models) == 1:
        return models[0]
    counts = [len(read_images(model)) for model in models]
    best = counts.index(max(counts))
    parts = ", ".join(f"sparse/{model.name} has {count}" for model, count in zip(models, counts, strict=True))
    warnings.warn(
        f"{path}: {len(models)} models, of parts that COLMAP did not join: sparse/{models[best].name} is read; images: "
        f"{parts}; give the folder of another model to read it",
        stacklevel=4,
    )
    return models[best]


def _read_frames(model: Path, bases: Sequence[Path]) -> Sequence[Frame]:
    images = read_images(model)
    folder = _image_folder(bases, images[0].name, str(model))
    files = [path_inside(folder, image.name, str(model)) for image in images]
    for file in files:
        present(file, f"an image of the model in {model}")
    tell_unlisted(str(model), files)
    names = frame_names([image.name for image in images])
    parts = zip(files, images, names, strict=True)
    shots = [Shot(file, image.camera, image.world_to_camera, name) for file, image, name in parts]
    return read_shots(shots)


def _image_folder(bases: Sequence[Path], name: str, source: str) -> Path:
    folders = [base / place for base in bases for place in _IMAGES]
    for folder in folders:
        if has_file(path_inside(folder, name, source)):
            return folder
    places = ", ".join(str(folder) for folder in folders)
    raise FileNotFoundError(f"{source}: its image {name!r} is missing; looked for it in {places}")
