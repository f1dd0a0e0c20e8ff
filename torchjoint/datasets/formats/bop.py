"""Reads a scene of BOP, the benchmark for 6D poses of objects: SPLIT/NNNNNN, "BOP-scenewise".

scene_camera.json                  for each image: cam_K, depth_scale, cam_R_w2c and cam_t_w2c (millimetres)
rgb/NNNNNN.png, .jpg, or gray/     8-bit
depth/NNNNNN.png                   16-bit, in depth_scale millimetres (optional)
scene_gt.json                      for each image: the objects and their poses, camera from model (optional)
mask_visib/NNNNNN_MMMMMM.png       pixels of object M in image N, 255 (optional; with scene_gt.json)

Some data sets of BOP have no cam_R_w2c. A scene without it can be read only if it has one image. The world frame is
then that camera's frame. Truth: objects in two images are the same instance if they have the same obj_id and their
positions in the world are at most `SAME_PLACE` apart. All other pixels are void. The cloud is `cloud.ply`, or fused.
"""

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from torchjoint.datasets.cameras import Camera, checked_pose, invert_pose
from torchjoint.datasets.files.readers import of_size, read_image_size, read_label_image
from torchjoint.datasets.files.text import Record, read_record
from torchjoint.datasets.recording import Options, Shot, read_shots, scene_of_frames, sorted_images, tell_unlisted
from torchjoint.runtime.foreign_files import has_file, has_folder, present
from torchjoint.runtime.threads import LazySequence
from torchjoint.scene import Scene

WHAT = "scene_camera.json with rgb/ or gray/ (BOP)"
#: Largest distance between the positions of one object according to two images, metres.
SAME_PLACE = 0.05
SUFFIXES = (".png", ".jpg", ".tif")


def recognizes(path: Path) -> bool:
    return has_folder(path) and has_file(path / "scene_camera.json")


def load(path: Path, options: Options) -> Scene:
    shots = _read_shots(path)
    return scene_of_frames(path, read_shots(shots), options, images=_truth(path, shots))


def _read_shots(path: Path) -> list[Shot]:
    cameras = read_record(path / "scene_camera.json", "the cameras of the images")
    numbers = sorted(int(key) for key in cameras.values if key.isascii() and key.isdigit() and len(key) < 10)
    if not numbers:
        raise ValueError(f"{cameras.name}: expected an entry for each image, got none")
    folder = path / ("rgb" if has_folder(path / "rgb") else "gray")
    files = sorted_images(folder, (one for one in folder.glob("*") if one.suffix in SUFFIXES))
    named = {f"{number:06d}": cameras.record(str(number)) for number in numbers}
    images = {name: folder / f"{name}.png" for name in named} | {file.stem: file for file in files}
    shots = [_read_shot(images[name], camera, len(named) == 1) for name, camera in named.items()]
    tell_unlisted(str(path), [images[name] for name in named])
    return shots


def _read_shot(image: Path, camera: Record, is_alone: bool) -> Shot:
    present(image, f"the image of {camera.name}")
    pose = torch.eye(4, dtype=torch.float64)
    if "cam_R_w2c" in camera:
        pose = _pose(camera, "cam_R_w2c", "cam_t_w2c")
    elif not is_alone:
        raise ValueError(f"{camera.name}: cam_R_w2c: missing; expected the poses of the cameras, or a single image")
    scale = camera.number("depth_scale", 1.0)
    if not 1e-3 <= scale <= 1e3:
        raise ValueError(f"{camera.name}: depth_scale: expected millimetres per step, 0.001 to 1000, got {scale}")
    lens = Camera(camera.numbers("cam_K", 9).view(3, 3), name=f"{camera.name}: cam_K")
    return Shot(image, lens, pose, image.stem, image.parents[1] / "depth" / f"{image.stem}.png", scale / 1000)


def _pose(record: Record, rotation: str, translation: str) -> Tensor:
    pose = torch.cat([record.numbers(rotation, 9).view(3, 3), record.numbers(translation, 3)[:, None] / 1000], 1)
    return checked_pose(pose, f"{record.name}: {rotation}, {translation}")


def _truth(path: Path, shots: Sequence[Shot]) -> Sequence[Tensor]:
    if not has_file(path / "scene_gt.json") or not has_folder(path / "mask_visib"):
        return ()
    truth = read_record(path / "scene_gt.json", "the objects of the images")
    instances = _instances(shots, truth)
    for shot, objects in zip(shots, instances, strict=True):
        if has_file(more := path / "mask_visib" / f"{shot.name}_{len(objects):06d}.png"):
            raise ValueError(f"{truth.name}: {shot.name}: expected an object for {more.name}, got {len(objects)}")

    def read(index: int) -> Tensor:
        image = shots[index].color
        assert isinstance(image, Path)
        labels = torch.full(read_image_size(image), -1, dtype=torch.int64)
        for place, instance in enumerate(instances[index]):
            file = path / "mask_visib" / f"{shots[index].name}_{place:06d}.png"
            labels[of_size(read_label_image(file), file, image) > 0] = instance
        return labels

    return LazySequence(len(shots), read)


def _instances(shots: Sequence[Shot], truth: Record) -> list[list[int]]:
    """The instance of each object of each image."""
    known: list[tuple[float, Tensor]] = []  # obj_id and place of each instance
    found = []
    for shot in shots:
        ids: list[int] = []
        for one in truth.records(str(int(shot.name))):
            world_from_model = invert_pose(shot.world_to_camera) @ _pose(one, "cam_R_m2c", "cam_t_m2c")
            kind, place = one.number("obj_id"), world_from_model[:3, 3]
            near = [
                (float((place - other).norm()), index)
                for index, (of_kind, other) in enumerate(known)
                if of_kind == kind and index not in ids
            ]
            distance, index = min(near, default=(float("inf"), -1))
            if distance > SAME_PLACE:
                index = len(known)
                known.append((kind, place))
            ids.append(index)
        found.append(ids)
    return found
