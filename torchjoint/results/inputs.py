"""The frames of a result on disk (output after step 8): cameras.json, inputs/NAME.jpg and images_color/NAME.jpg.

With them a result does not need the recording any more: its frames can be shown, cropped and exported.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from PIL import Image
from torch import Tensor

from torchjoint.datasets.files.readers import read_image
from torchjoint.results.figures import overlay
from torchjoint.results.manifest import Check, unchecked
from torchjoint.results.mask_report import MaskMatches, compare_masks, write_mask_report
from torchjoint.runtime.files import frame_files, write_text
from torchjoint.runtime.foreign_files import damage_is, has_file, read_json
from torchjoint.runtime.threads import LazySequence, parallel_map
from torchjoint.scene import Frame, Masks, Scene, Segmentation

CAMERAS, INPUTS, OVERLAYS = "cameras.json", "inputs", "images_color"
#: Quality of the JPEG files.
QUALITY = 90


def write_inputs(folder: Path, scene: Scene, result: Segmentation) -> None:
    """Writes cameras, images, images under the colours of their labels, and what became of masks.

    Equal results give equal bytes. Each frame is read once.

    Args:
        folder: the result.
        scene: its frames, in the order of the result's images.
        result: the segmentation of the scene.
    """
    for part in (INPUTS, OVERLAYS):
        (folder / part).mkdir()
    num_segments, files = result.num_point_segments, frame_files(result.names)

    def write(index: int) -> tuple[dict[str, Any], MaskMatches | None]:
        frame, labels = scene.frames[index], result.images[index]
        pixels = (frame.image * 255).round().to(torch.uint8).permute(1, 2, 0).contiguous()
        _save(folder / INPUTS / f"{files[index]}.jpg", pixels)
        _save(folder / OVERLAYS / f"{files[index]}.jpg", overlay(pixels, labels, num_segments))
        camera = {
            "name": result.names[index],
            "size": list(frame.size),
            "intrinsics": frame.intrinsics.tolist(),
            "world_to_camera": frame.world_to_camera.tolist(),
        }
        return camera, compare_masks(frame.masks, labels, num_segments) if isinstance(frame.masks, Masks) else None

    written = parallel_map(write, range(len(files)))
    write_mask_report(folder, result.names, [fates for _, fates in written])
    lines = ",\n".join(json.dumps(camera) for camera, _ in written)
    write_text(folder / CAMERAS, f'{{"frames": [\n{lines}\n]}}\n')


def read_names(folder: Path) -> dict[str, str]:
    """The name of each file of `inputs/`, without suffix, by the true name of its frame; none without cameras.json."""
    stored = {file.stem for file in (folder / INPUTS).glob("*.jpg")}  # earlier versions had longer names
    names = [str(name) for name in _read_cameras(folder)] if has_file(folder / CAMERAS) else []
    return {name: name if name in stored else file for name, file in zip(names, frame_files(names), strict=True)}


def read_inputs(folder: Path, names: Sequence[str], check: Check = unchecked) -> Sequence[Frame]:
    """Reads the frames of a result, in the order of `names`; images are read, and checked, when they are used."""
    file, files, records = folder / CAMERAS, read_names(folder), _read_cameras(folder)
    with damage_is(f"{file}: not the cameras of these images"):
        keys = ("intrinsics", "world_to_camera")
        cameras = [tuple(torch.tensor(records[name][key], dtype=torch.float64) for key in keys) for name in names]

    def read(index: int) -> Frame:
        intrinsics, world_to_camera = cameras[index]
        file = folder / INPUTS / f"{files[names[index]]}.jpg"
        image = read_image(check(file))
        if list(image.shape[1:]) != (size := records[names[index]].get("size")):
            raise ValueError(f"{file}: expected the size of its camera, {size}, got {list(image.shape[1:])}")
        return Frame(image, intrinsics, world_to_camera, name=names[index])

    return LazySequence(len(names), read, names)


def _read_cameras(folder: Path) -> dict[str, dict[str, Any]]:
    file = folder / CAMERAS
    with damage_is(f"{file}: not the cameras of these images"):
        content = read_json(file, "a result with cameras, which `torchjoint segment` writes")
        return {record["name"]: record for record in content["frames"]}


def _save(file: Path, pixels: Tensor) -> None:
    Image.fromarray(pixels.numpy()).save(file, quality=QUALITY)
