"""Draws results for the documents: `python lab/studies/gallery.py DATA [PICTURE ...]` (some minutes for all).

DATA has kitchen/ (7-Scenes' style), mosd/, kitti/, and what sensors.py needs. Writes docs/gallery.jpg, kitchen.jpg,
superpoints.jpg and sensors.jpg there. All segmentations are by the default. The pictures of street LiDAR show no
photograph, because its terms do not allow it: in its place stand the boundaries that the detector finds in it.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import sensors
import streets
from matplotlib.figure import Figure
from torch import Tensor
from torchjoint_lab.synthetic import make_domain_scene

import torchjoint as tj
from torchjoint.results.figures import cloud_figure
from torchjoint.results.render import label_colors, render_cloud
from torchjoint.scene.scene import voxel_subsample
from torchjoint.views.visibility import in_any_view

DOCS = Path(__file__).parents[2] / "docs"
JPEG = {"dpi": 100, "pil_kwargs": {"quality": 88, "subsampling": 0}}
CLOUD = (330, 440)
#: Metres around a sensor that are drawn.
NEAR = 25.0


def kitchen(data: Path) -> tj.Scene:
    return tj.load_scene(data / "kitchen").sample_frames(60)


def table_top(data: Path) -> tj.Scene:
    scene = tj.load_scene(data / "mosd" / "learn44.pcd")
    return scene.select_points(voxel_subsample(scene.points, 0.005))


def shelf(_: Path) -> tj.Scene:
    return make_domain_scene("shelf", seed=41, num_views=10, num_points=30_000).scene


def street(data: Path) -> tj.Scene:
    scene = tj.load_scene(data / "kitti" / "training" / "velodyne" / "000008.bin")
    return scene.select_points(in_any_view(scene.points, scene.frames))


#: Title -> scene, frame, whether its photograph may be shown.
ROWS: dict[str, tuple[Callable[[Path], tj.Scene], int, bool]] = {
    "a real kitchen": (kitchen, 0, True),
    "table-top, one view": (table_top, 0, True),
    "generated shelf": (shelf, 3, True),
    "street LiDAR, one camera": (street, 0, False),
}


def draw_gallery(data: Path) -> Figure:
    heights = [2.9 if may_show else 1.9 for _, _, may_show in ROWS.values()]  # the street's image is wide
    figure = Figure(figsize=(14, sum(heights)), layout="constrained")
    rows = figure.subplots(len(ROWS), 4, height_ratios=heights)
    for axes, (title, (make, index, may_show)) in zip(rows, ROWS.items(), strict=True):
        scene = make(data)
        segmenter = tj.JointSegmenter()
        result = segmenter(scene)
        photo = scene.frames[index].image.permute(1, 2, 0)
        if not may_show:
            strength = segmenter.state.observations[index].boundary[..., None].float() / 255
            photo = 1 - strength.sqrt().repeat(1, 1, 3)
        count = f"{len(scene.frames)} image{'s' * (len(scene.frames) > 1)}"
        pictures = {
            f"{title}: {count}" if may_show else f"{title}: boundaries": photo,
            "image alone": label_colors(result.initial_images[index]),
            "joint": label_colors(result.images[index], result.num_point_segments),
            f"{len(scene.points):,} points, {result.num_point_segments} segments": _cloud(scene, result.points),
        }
        for axis, (name, picture) in zip(axes, pictures.items(), strict=True):
            axis.imshow(picture.numpy())
            axis.set(xticks=[], yticks=[])
            axis.set_title(name, fontsize=10)
    return figure


def draw_kitchen(data: Path) -> Figure:
    scene = kitchen(data)
    result = tj.JointSegmenter()(scene)
    figure = Figure(figsize=(13, 9), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=[5, 4.4])
    for column, index in zip(top.subplots(2, 4).T, (0, 15, 24, 59), strict=True):
        photo, labels = scene.frames[index].image.permute(1, 2, 0), result.images[index]
        for axis, picture in zip(column, (photo, label_colors(labels, result.num_point_segments)), strict=True):
            axis.imshow(picture.numpy())
            axis.set(xticks=[], yticks=[])
    for axis, colors in zip(bottom.subplots(1, 2), (scene.colors, label_colors(result.points)), strict=True):
        axis.imshow(render_cloud(scene, colors).numpy())
        axis.set(xticks=[], yticks=[])
    return figure


def draw_superpoints(data: Path) -> Figure:
    scene = tj.load_scene(data / "kitchen")
    return cloud_figure(scene, tj.superpoints(scene.points, scene.colors, scene.normals))


def draw_sensors(data: Path) -> Figure:
    """One scan of each sensor within NEAR of it, the ground in grey."""
    made = make_domain_scene("street", seed=12, num_views=1)
    scans = {
        "KITTI": list(streets.kitti(data))[3].points,
        "SemanticKITTI": next(streets.semantickitti(data)).points,
        "View of Delft": next(sensors.plain("vod", data)).points,
        "Argoverse 2, two sensors": next(sensors.plain("argo", data)).points,
        "nuScenes": next(sensors.nuscenes(data)).points,
        "generated street": made.scene.points,
    }
    figure = Figure(figsize=(14, 7.6), layout="constrained")
    for axis, (title, points) in zip(figure.subplots(2, 3).flat, scans.items(), strict=True):
        labels = tj.JointSegmenter()(tj.Scene(points)).points
        near = points[:, :2].norm(dim=1) < NEAR
        colors = label_colors(labels)
        colors[labels == labels.bincount().argmax()] = 0.75
        scene = tj.Scene(points[near])
        axis.imshow(render_cloud(scene, colors[near], (540, 680)).numpy())
        axis.set(xticks=[], yticks=[])
        things = len(labels[near].unique()) - 1
        axis.set_title(f"{title}: {int(near.sum()):,} points, {things} segments", fontsize=10)
    return figure


def _cloud(scene: tj.Scene, labels: Tensor) -> Tensor:
    return render_cloud(scene, label_colors(labels), CLOUD)


PICTURES = {"gallery": draw_gallery, "kitchen": draw_kitchen, "superpoints": draw_superpoints, "sensors": draw_sensors}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("pictures", nargs="*", metavar="PICTURE", help=f"of {', '.join(PICTURES)}; default: all")
    arguments = parser.parse_args()
    if unknown := set(arguments.pictures) - set(PICTURES):  # `choices` would refuse that there are none
        parser.error(f"PICTURE: expected {', '.join(PICTURES)}, got {', '.join(sorted(unknown))}")
    for name in arguments.pictures or PICTURES:
        PICTURES[name](arguments.data).savefig(DOCS / f"{name}.jpg", **JPEG)


if __name__ == "__main__":
    main()
