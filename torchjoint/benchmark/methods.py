"""The methods that are compared: ours, its parts, and what one could do without it today."""

from __future__ import annotations

import torch
from torch import Tensor

from torchjoint.afterwards import what_is_seen
from torchjoint.benchmark.case import Case
from torchjoint.benchmark.method import Method, Result
from torchjoint.benchmark.planes import planes_and_clusters
from torchjoint.benchmark.space import Between, Choice, Setting, Space
from torchjoint.benchmark.vote import vote
from torchjoint.config import Config
from torchjoint.joint import JointSegmenter
from torchjoint.superpoints import superpoints
from torchjoint.superpoints_config import SuperpointsConfig


def joint(case: Case, setting: Setting, images: bool) -> Result:
    """The whole method; `setting` is of `stage.parameter`, on top of the suite's config."""
    segmenter = _seen(case, _config(case, setting))
    result = segmenter.compute(images=images)
    return Result(result.points, result.images)


def joint_painted(case: Case, setting: Setting, images: bool) -> Result:
    """The joint method's points, painted into the images instead of refining these."""
    return _painted(case, joint(case, setting, False).points, images)


def geometry(case: Case, setting: Setting, images: bool) -> Result:
    """The same graph without the images' evidence, painted into the images."""
    setting = setting | {"propagation.weight": 0.0}
    return _painted(case, _seen(case, _config(case, setting)).compute(images=False).points, images)


def initial(case: Case, setting: Setting, images: bool) -> Result:
    """The images alone, and these voted onto the points."""
    found = _seen(case, _config(case, setting)).state.observations
    label_images = [observation.labels.long() for observation in found]
    return Result(vote(label_images, case.visible, case.scene.points), label_images if images else ())


def scikit_image(case: Case, setting: Setting, images: bool) -> Result:
    """scikit-image's Felzenszwalb-Huttenlocher of each image, voted onto the points."""
    from skimage.segmentation import felzenszwalb

    label_images = [
        torch.from_numpy(felzenszwalb(frame.image.permute(1, 2, 0).numpy(), **setting)).long() for frame in case.frames
    ]
    return Result(vote(label_images, case.visible, case.scene.points), label_images if images else ())


def normals(case: Case, setting: Setting, images: bool) -> Result:
    """Felzenszwalb-Huttenlocher by normals alone, with ScanNet's convexity-discounted weight."""
    return _superpoints(case, {"weight": "segmentator", "color_weight": 0.0} | setting, images)


def distance_normal_color(case: Case, setting: Setting, images: bool) -> Result:
    """Felzenszwalb-Huttenlocher by distance, angle of normals and colour."""
    colors = {"color_weight": 0.0} if case.scene.colors is None else {}
    return _superpoints(case, {"convex_factor": 1.0} | setting | colors, images)


def ransac_dbscan(case: Case, setting: Setting, images: bool) -> Result:
    """RANSAC planes, and DBSCAN of what is left."""
    return _painted(case, planes_and_clusters(case.scene.points, **setting), images)


def _superpoints(case: Case, setting: Setting, images: bool) -> Result:
    config = SuperpointsConfig().replace(setting)
    colors = case.scene.colors if config.color_weight > 0 else None
    return _painted(case, superpoints(case.scene.points, colors, viewpoint=case.viewpoints, preset=config), images)


def _painted(case: Case, points: Tensor | None, images: bool) -> Result:
    return Result(points, case.paint(points) if images and points is not None else ())


def _config(case: Case, setting: Setting) -> Config:
    config = case.config
    for name, value in setting.items():
        stage, _, parameter = name.partition(".")
        config = config.replace({stage: {parameter: value}})
    return config


def _seen(case: Case, config: Config) -> JointSegmenter:
    """A segmenter that has seen all frames; seen again only where the setting asks for it."""
    before = what_is_seen(config)

    def see() -> JointSegmenter:
        segmenter = JointSegmenter(before)
        segmenter.reset(case.scene.points, case.scene.colors, case.scene.normals)
        for start in range(0, len(case.frames), 8):
            segmenter.update(case.frames[start : start + 8])
        return segmenter

    seen: JointSegmenter = case.keep("seen", before, see)
    return seen.with_config(config)


_GRAPH: Space = {
    "point_graph.neighbors": Choice((10, 16, 24)),
    "point_graph.normal_neighbors": Choice((20, 30, 45, 60)),
    "point_graph.convex_factor": Between(0.03, 1.0),
    "point_graph.distance_weight": Between(0.05, 5.0, or_zero=True),
    "point_graph.color_weight": Between(0.05, 1.0, or_zero=True),
    "point_segments.scale": Between(0.3, 30.0),
    "point_segments.min_size": Between(50, 1000, whole=True),
}
_LIDAR_GRAPH: Space = {
    **{name: values for name, values in _GRAPH.items() if not name.endswith("color_weight")},
    "point_graph.neighbors": Choice((8, 12, 16, 24)),
    "point_graph.normal_neighbors": Choice((10, 20, 30)),
    "point_graph.reach": Choice((0.0, 0.3, 0.5, 0.7)),
    "point_segments.min_size": Between(5, 100, whole=True),
}
_EVIDENCE: Space = {
    "propagation.window": Choice((1, 3, 5)),
    "propagation.overlap_threshold": Choice((0.5, 0.7, 0.9)),
    "propagation.weight": Between(0.02, 0.6),
}
_IMAGES: Space = {
    "image_segments.scale": Between(0.5, 30.0),
    "image_segments.min_size": Between(50, 2000, whole=True),
}
_SUPERPOINTS: Space = {
    "neighbors": Choice((8, 12, 16, 24)),
    "normal_neighbors": Choice((10, 20, 30, 45, 60)),
    "min_size": Between(50, 1000, whole=True),
}
_LIDAR_SUPERPOINTS: Space = {
    **_SUPERPOINTS,
    "reach": Choice((0.0, 0.3, 0.5, 0.7)),
    "min_size": Between(5, 100, whole=True),
}
_NORMALS: Space = {"scale": Between(0.0003, 1.0)}
_COLORED: Space = {
    "distance_weight": Between(0.05, 20.0, or_zero=True),
    "angle_weight": Between(0.1, 2.0),
    "scale": Between(0.3, 30.0),
}

METHODS = {
    method.name: method
    for method in (
        Method("joint", "joint (final)", joint, {
            "": {**_GRAPH, **_EVIDENCE}, "mosd": {**_GRAPH, **_EVIDENCE, **_IMAGES}, "kitti": {**_LIDAR_GRAPH, **_EVIDENCE, **_IMAGES},
        }),
        Method("joint_painted", "joint, its points painted", joint_painted, like="joint"),
        Method("geometry", "geometry only", geometry, {"": _GRAPH, "kitti": _LIDAR_GRAPH}),
        Method("initial", "images only (initial), voted", initial, {"": _IMAGES}),
        Method("scikit_image", "scikit-image fh, voted", scikit_image, {"": {
            "scale": Between(30, 3000), "sigma": Choice((0.5, 0.8, 1.2, 2.0)), "min_size": Between(50, 2000, whole=True),
        }}),
        Method("normals", "normals-only fh", normals, {
            "": {**_SUPERPOINTS, **_NORMALS}, "kitti": {**_LIDAR_SUPERPOINTS, **_NORMALS},
        }),
        Method("distance_normal_color", "distance + normal + colour fh", distance_normal_color, {
            "": {**_SUPERPOINTS, **_COLORED, "color_weight": Between(0.05, 2.0, or_zero=True)},
            "kitti": {**_LIDAR_SUPERPOINTS, **_COLORED},
        }),
        Method("ransac_dbscan", "RANSAC planes + DBSCAN", ransac_dbscan, {
            "": {"distance": Between(0.005, 0.05), "min_share": Between(0.01, 0.3), "max_planes": Choice((1, 2, 4, 8, 16)),
                 "eps": Between(0.01, 0.1), "min_points": Choice((4, 8, 16, 32))},
            "kitti": {"distance": Between(0.05, 0.4), "min_share": Between(0.03, 0.3), "max_planes": Choice((1, 2, 3)),
                      "eps": Between(0.2, 1.5), "min_points": Choice((2, 4, 8, 16))},
        }),
    )
}  # fmt: skip
