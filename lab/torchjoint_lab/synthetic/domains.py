"""Scenes of many domains, each as hard as its own draw of sensor, cameras, cloud and things makes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from torchjoint.scene import Frame, Scene, Truth
from torchjoint.synthetic import SyntheticScene
from torchjoint_lab.synthetic import (
    bins,
    bleeding,
    desks,
    kitchens,
    lidar_scan,
    rooms,
    shelves,
    streets,
    tabletop,
    workshops,
)
from torchjoint_lab.synthetic.catalogue import Catalogue
from torchjoint_lab.synthetic.depth_sensors import measure
from torchjoint_lab.synthetic.furnished import trajectory
from torchjoint_lab.synthetic.furnished.arrays import Array, Rng
from torchjoint_lab.synthetic.furnished.cloud import Shot
from torchjoint_lab.synthetic.furnished.world import World
from torchjoint_lab.synthetic.photo import shot_of
from torchjoint_lab.synthetic.quick_render import QuickRenderer
from torchjoint_lab.synthetic.settings import DOMAINS, DomainSettings, domain_settings
from torchjoint_lab.synthetic.source import Source
from torchjoint_lab.synthetic.style import Style
from torchjoint_lab.synthetic.tabletop import Layout

_BUILDERS: dict[str, Callable[[Source, DomainSettings], Layout]] = {
    "table": tabletop.build,
    "shelf": shelves.build,
    "bin": bins.build,
    "desk": desks.build,
    "kitchen": kitchens.build,
    "room": rooms.build,
    "workshop": workshops.build,
    "street": streets.build,
}


def make_domain_scene(
    domain: str,
    seed: int = 0,
    *,
    num_views: int | None = None,
    num_points: int | None = None,
    models: Path | str | None = None,
    held_out: bool = False,
    lidar: str | None = None,
) -> SyntheticScene:
    """A scene of one of :data:`DOMAINS`, with exact truth; equal arguments give equal scenes.

    Everything that makes it easy or hard is drawn: see
    :func:`~torchjoint_lab.synthetic.domain_settings`, which says what was drawn. Cells of the cloud average what was
    seen in them, across the borders of things, so that colours bleed as in real fused clouds.

    Args:
        domain: a name of :data:`DOMAINS`. A "street" is one scan of a turning LiDAR at the origin, without colours;
            its ``point_labels`` know every surface, its scene's truth only ground, vehicles, people and poles.
        seed: decides everything else.
        num_views: images; drawn if None.
        num_points: points; drawn if None. Of a street the most: its scan has as many as return.
        models: a folder of Sweet Home 3D catalogues (``*.sh3f``), or of OBJ and GLB files: half of the things are
            models of it, one model an instance. None: built-in shapes only.
        held_out: takes only those kinds of models that False never takes (a fifth of the kinds of things).
        lidar: only streets: the sensor, a name of :data:`LIDARS`; drawn if None.

    Raises:
        ValueError: the message names the argument.
        ModuleNotFoundError: embreex, which casts the rays, is not installed.
    """
    settings = _resolved(domain_settings(domain, seed), num_views, num_points)
    if lidar is not None and (domain != "street" or lidar not in lidar_scan.LIDARS):
        names = ", ".join(lidar_scan.LIDARS)
        raise ValueError(f"lidar: expected None, or for streets one of {names}; got {lidar!r} for {domain}")
    base = np.random.SeedSequence([DOMAINS.index(domain), int(seed)], spawn_key=(1,))
    of_world, of_cameras, of_poses, of_cloud, *of_views = (
        np.random.default_rng(s) for s in base.spawn(4 + 2 * settings.num_views)
    )
    style = Style(of_world, settings.similar, settings.printed, settings.difficult)
    source = Source(of_world, style, None if models is None else Catalogue(models, held_out), settings.clutter)
    layout = _BUILDERS[domain](source, settings)
    world = layout.world
    renderer = QuickRenderer(world, sky=0.9 if domain == "street" else 0.02)
    true_poses = layout.rig.poses(of_cameras, renderer, settings.num_views)
    poses = trajectory.erroneous(of_poses, true_poses, settings.pose_error)
    intrinsics = _intrinsics(settings)
    shots, truths = _shoot(renderer, of_views, true_poses, poses, intrinsics, settings)
    colors: Array | None = None
    if domain == "street":
        points, labels = _at_most(of_cloud, *lidar_scan.scan(of_cloud, renderer, settings, lidar), settings.num_points)
        known = np.isin(np.array(world.names), streets.KNOWN)
    else:
        seen = bleeding.observe(of_cloud, shots, intrinsics, layout.crop if settings.cropped else None)
        least_seen = int(of_cloud.choice([1, 1, 2])) if settings.num_views > 3 else 1
        points, colors, labels = bleeding.thinned(
            of_cloud, seen, settings.spacing, settings.num_points, num_points, least_seen
        )
        known = np.ones(len(world.names), dtype=bool)
    frames = [
        _as_frame(shot, intrinsics, i, settings.keeps_depth and domain != "street") for i, shot in enumerate(shots)
    ]
    return _scene(settings, world, frames, truths, (points, colors, labels), known, true_poses)


def _at_most(rng: Rng, points: Array, labels: Array, most: int) -> tuple[Array, Array]:
    """Random ``most`` of the points, in their order, if there are more."""
    if len(points) <= most:
        return points, labels
    kept = np.sort(rng.choice(len(points), most, replace=False))
    return points[kept], labels[kept]


def _resolved(settings: DomainSettings, num_views: int | None, num_points: int | None) -> DomainSettings:
    for name, value in (("num_views", num_views), ("num_points", num_points)):
        if value is not None and (isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1):
            raise ValueError(f"{name}: expected an integer of at least 1, got {value!r}")
    settings = settings._replace(num_views=int(num_views or settings.num_views))
    settings = settings._replace(num_points=int(num_points or settings.num_points))
    return settings._replace(pose_error=0.0) if settings.num_views == 1 else settings


def _intrinsics(settings: DomainSettings) -> Array:
    height, width = settings.height, settings.width
    focal = width / 2 / np.tan(np.radians(settings.field_of_view / 2))
    return np.array([[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]])


def _shoot(
    renderer: QuickRenderer,
    streams: list[Rng],
    true_poses: list[Array],
    poses: list[Array],
    intrinsics: Array,
    settings: DomainSettings,
) -> tuple[list[Shot], list[Array]]:
    """Images with depth and the instances that depths were measured on; the instances at the pixels' centres."""
    shots, truths = [], []
    for i, (true_pose, pose) in enumerate(zip(true_poses, poses, strict=True)):
        view = renderer.view(true_pose, intrinsics, settings.height, settings.width)
        image = shot_of(streams[2 * i], view, settings)
        depth, measured = measure(streams[2 * i + 1], view, image, float(intrinsics[0, 0]), settings)
        shots.append(Shot(image, depth, measured, pose))
        truths.append(view.labels)
    return shots, truths


def _as_frame(shot: Shot, intrinsics: Array, index: int, keeps_depth: bool) -> Frame:
    return Frame(
        image=torch.from_numpy(np.ascontiguousarray(shot.image.transpose(2, 0, 1))),
        intrinsics=torch.from_numpy(intrinsics.copy()),
        world_to_camera=torch.from_numpy(shot.camera_from_world),
        depth=torch.from_numpy(shot.depth) if keeps_depth else None,
        name=f"frame-{index:06d}",
    )


def _scene(
    settings: DomainSettings,
    world: World,
    frames: list[Frame],
    image_labels: list[Array],
    cloud: tuple[Array, Array | None, Array],
    known: Array,
    true_poses: list[Array],
) -> SyntheticScene:
    """Puts it together; ``cloud`` has points, colours and instances, ``known`` [I] says which of them truth knows."""
    points, colors, labels = cloud
    known = np.append(known, False)  # of label -1
    void = [np.where(known[image], image, -1) for image in (labels, *image_labels)]
    kinds = {instance: kind for instance, kind in enumerate(world.kinds) if kind != "other" and known[instance]}
    truth = Truth(torch.from_numpy(void[0]), tuple(torch.from_numpy(image) for image in void[1:]), kinds)
    scene = Scene(
        torch.from_numpy(points),
        tuple(frames),
        None if colors is None else torch.from_numpy(colors),
        name=f"{settings.domain}-{settings.seed}",
        truth=truth,
    )
    return SyntheticScene(
        scene=scene,
        point_labels=torch.from_numpy(labels),
        image_labels=tuple(torch.from_numpy(image) for image in image_labels),
        instance_names=world.names,
        instance_kinds=world.kinds,
        true_world_to_camera=tuple(torch.from_numpy(pose) for pose in true_poses),
        triangles=torch.from_numpy(world.triangles),
        triangle_labels=torch.from_numpy(world.labels),
    )
