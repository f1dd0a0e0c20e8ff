"""The methods of the benchmark: the joint method, ablations of it, and common alternatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from torchjoint.config import Config, SuperpointsConfig, evidence_config
from torchjoint.joint import JointSegmenter
from torchjoint.labels.label import label_points
from torchjoint.oversegmentation import superpoints
from torchjoint.runtime.messages import Stopwatch, needed_for
from torchjoint.runtime.threads import one_thread_per_operation
from torchjoint.segments.method import PAPER
from torchjoint.segments.method import Method as StepSix
from torchjoint.views.evidence import Evidence
from torchjoint_lab.benchmark import spaces
from torchjoint_lab.benchmark.case import Case
from torchjoint_lab.benchmark.known_images import KnownImages
from torchjoint_lab.benchmark.method import Method, Result
from torchjoint_lab.benchmark.planes import planes_and_clusters
from torchjoint_lab.benchmark.presets import NAMES, preset_config
from torchjoint_lab.benchmark.space import Setting
from torchjoint_lab.benchmark.vote import vote
from torchjoint_lab.regions import REGIONS, RegionsConfig


def joint(case: Case, setting: Setting, images: bool) -> Result:
    """The whole method; `setting` has keys `stage.parameter` and is applied on top of the suite's preset."""
    config = changed(case.preset, setting)
    result = _seen(case, config).compute(images=images, config=config)
    return Result(result.points, result.images)


def joint_painted(case: Case, setting: Setting, images: bool) -> Result:
    """The joint method's points, projected into the images; replaces the image refinement."""
    return _painted(case, joint(case, setting, False).points, images)


def geometry(case: Case, setting: Setting, images: bool) -> Result:
    """The joint method without votes of the images; the point labels are projected into the images.

    Of the images it knows only which side of a surface their cameras are on.
    """
    config = changed(case.preset, setting)
    segmenter = _seen(case, config)
    blind = replace(Evidence.empty(segmenter.graph), facing=segmenter.state.facing)
    with torch.no_grad(), one_thread_per_operation():
        tree = segmenter.method.segment(segmenter.graph, blind, config)
    return _painted(case, label_points(tree, segmenter.graph).given, images)


def edges(case: Case, setting: Setting, images: bool) -> Result:
    """The joint method with step 6 edge by edge, as in the paper; `setting` is applied on top of the suite's config.

    Steps 7 and 8 are those of the joint method. L of eq. 6 is the edge's own number of views: with the number of images
    r would be nearly constant in rooms.
    """
    config = changed(case.config, {"paper.normalization": "saturating"} | setting)
    result = _seen(case, config, PAPER).compute(images=images, config=config)
    return Result(result.points, result.images)


def preset(name: str) -> Callable[[Case, Setting, bool], Result]:
    """Returns the joint method with one of the presets, for any data."""

    def run(case: Case, setting: Setting, images: bool) -> Result:
        config = preset_config(name)
        result = _seen(case, config).compute(images=images, config=config)
        return Result(result.points, result.images)

    return run


def initial(case: Case, setting: Setting, images: bool) -> Result:
    """The initial image segmentations, and their labels voted onto the points."""
    segments = _known_images(case, changed(case.config, setting))(case.frames, Stopwatch())
    label_images = [found.labels if found.masks is None else found.masks.labels() for found in segments]
    return Result(vote(label_images, case.visible, case.scene.points), label_images if images else ())


def scikit_image(case: Case, setting: Setting, images: bool) -> Result:
    """scikit-image's Felzenszwalb-Huttenlocher on each image, voted onto the points."""
    with needed_for("the method of scikit-image", "scikit-image", "torchjoint-lab"):
        from skimage.segmentation import felzenszwalb

    label_images = [
        torch.from_numpy(felzenszwalb(frame.image.permute(1, 2, 0).numpy(), **setting)).long() for frame in case.frames
    ]
    return Result(vote(label_images, case.visible, case.scene.points), label_images if images else ())


def normals(case: Case, setting: Setting, images: bool) -> Result:
    """Felzenszwalb-Huttenlocher on normals alone, with ScanNet's convexity-discounted weight."""
    return _superpoints(case, {"weight": "segmentator", "color_weight": 0.0} | setting, images)


def distance_normal_color(case: Case, setting: Setting, images: bool) -> Result:
    """Felzenszwalb-Huttenlocher on distance, angle between normals, and colour."""
    colors = {"color_weight": 0.0} if case.scene.colors is None else {}
    return _superpoints(case, {"convex_factor": 1.0} | setting | colors, images)


def ransac_dbscan(case: Case, setting: Setting, images: bool) -> Result:
    """RANSAC planes, then DBSCAN of the remaining points."""
    return _painted(case, planes_and_clusters(case.scene.points, **setting), images)


def _superpoints(case: Case, setting: Setting, images: bool) -> Result:
    config = SuperpointsConfig().replace(setting)
    colors = case.scene.colors if config.color_weight > 0 else None
    return _painted(case, superpoints(case.scene.points, colors, viewpoint=case.viewpoints, preset=config), images)


def _painted(case: Case, points: Tensor | None, images: bool) -> Result:
    return Result(points, case.paint(points) if images and points is not None else ())


def changed(config: Config, setting: Setting) -> Config:
    """Returns a config with some parameters replaced; keys are `stage.parameter`."""
    for name, value in setting.items():
        stage, _, parameter = name.partition(".")
        config = config.replace({stage: {parameter: value}})
    return config


def _known_images(case: Case, config: Config) -> KnownImages:
    """Boundaries and initial labels; computed again only if the setting changes an image stage."""
    stages = (config.boundary, config.contours)
    bounded: KnownImages = case.keep("boundaries", stages, lambda: KnownImages(config, case.frames))
    more = (*stages, config.image_graph, config.image_segments)
    known: KnownImages = case.keep("images", more, lambda: KnownImages(config, case.frames, bounded))
    return known


def _seen(case: Case, config: Config, method: StepSix | None = None) -> JointSegmenter:
    """A segmenter that has seen all frames; the frames are seen again only if the setting changes such a stage.

    Args:
        case: the scene.
        config: of the segmenter.
        method: of step 6; default: as the config says.
    """
    before = evidence_config(config)
    method = method or (REGIONS if isinstance(config, RegionsConfig) else None)

    def see() -> JointSegmenter:
        segmenter = JointSegmenter(before, method=method, allow_import=True)
        segmenter.image_segmenter = _known_images(case, before)
        segmenter.reset(case.scene.points, case.scene.colors, case.scene.normals)
        for start in range(0, len(case.frames), 8):
            segmenter.update(case.frames[start : start + 8])
        return segmenter

    seen: JointSegmenter = case.keep("seen", (before, method), see)
    return seen


def _of_config(setting: Setting) -> Config:
    return changed(RegionsConfig(), setting)  # it has the stages of all suites' presets


METHODS = {
    method.name: method
    for method in (
        Method("joint", "joint (final)", joint, spaces.JOINT, checked=_of_config),
        Method("joint_painted", "joint, its points painted", joint_painted, like="joint"),
        *(Method(f"preset_{name}", f"joint, preset {name}", preset(name)) for name in NAMES),
        Method("edges", "joint, step 6 by edges", edges, spaces.EDGES, checked=_of_config),
        Method("geometry", "geometry only", geometry, spaces.GEOMETRY, checked=_of_config),
        Method("initial", "images only (initial), voted", initial, spaces.INITIAL, judged="2D", checked=_of_config),
        Method("scikit_image", "scikit-image fh, voted", scikit_image, spaces.SCIKIT_IMAGE, judged="2D"),
        Method("normals", "normals-only fh", normals, spaces.NORMALS, checked=SuperpointsConfig().replace),
        Method(
            "distance_normal_color",
            "distance + normal + colour fh",
            distance_normal_color,
            spaces.COLORED,
            checked=SuperpointsConfig().replace,
        ),
        Method("ransac_dbscan", "RANSAC planes + DBSCAN", ransac_dbscan, spaces.RANSAC_DBSCAN),
    )
}
