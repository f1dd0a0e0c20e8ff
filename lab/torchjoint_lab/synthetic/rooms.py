"""Rooms of :mod:`~torchjoint_lab.synthetic.furnished`, mended: fewer flat things, more misleading texture, clutter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from torchjoint_lab.synthetic.furnished.arrays import Array
from torchjoint_lab.synthetic.furnished.room import make_world
from torchjoint_lab.synthetic.furnished.world import World
from torchjoint_lab.synthetic.quick_render import QuickRenderer
from torchjoint_lab.synthetic.rigs import Walk
from torchjoint_lab.synthetic.settings import DomainSettings
from torchjoint_lab.synthetic.source import Source
from torchjoint_lab.synthetic.stage import Stage
from torchjoint_lab.synthetic.style import Style
from torchjoint_lab.synthetic.support import Support
from torchjoint_lab.synthetic.tabletop import Layout

#: Flat things that are mostly taken away, and those that mostly become part of the wall they hang on.
_THIN, _HUNG = ("paper", "magazine", "card", "envelope"), ("poster", "picture", "notice")
#: Rays that measure how high a room's furniture reaches start here, metres.
_EYE = 2.25


def build(source: Source, settings: DomainSettings) -> Layout:
    """A furnished room and things that lie, pile and lean in it."""
    rng = source.rng
    world = make_world(rng, float(np.clip(0.35 * settings.clutter, 0.15, 0.7)))
    world = repainted(source, without_flats(source, world))
    stage = Stage()
    _clutter(source, stage, world)
    if stage.names:
        world = united(world, stage.build(world.lights, world.ambient))
    x, y, half_x, half_y = world.focus
    low = np.array([x - half_x - 0.6, y - half_y - 0.6, -0.05])
    return Layout(world, Walk(world), (low, np.array([x + half_x + 0.6, y + half_y + 0.6, 1.6])))


def without_flats(source: Source, world: World) -> World:
    """Takes away three quarters of the loose sheets; most posters become part of their wall's surface."""
    names = np.array(world.names)
    walls = np.flatnonzero(names == "wall")
    kept, labels = np.ones(len(world.labels), dtype=bool), world.labels.copy()
    middles = np.stack([world.triangles[world.labels == wall].mean(axis=(0, 1)) for wall in walls])
    for instance in np.flatnonzero(np.isin(names, _THIN + _HUNG)):
        mine = world.labels == instance
        if not source.chance(0.75):
            continue
        if names[instance] in _THIN or source.chance(0.3):
            kept &= ~mine
        else:
            labels[mine] = walls[_wall_behind(world.triangles[mine].mean(axis=(0, 1)), middles)]
    return replace(
        world,
        triangles=world.triangles[kept],
        corners=world.corners[kept],
        labels=labels[kept],
        material_ids=world.material_ids[kept],
    )


def _wall_behind(place: Array, walls: Array) -> int:
    """Which of the walls, given by their middles, a hung thing at ``place`` is on."""
    out = walls[:, :2] / np.linalg.norm(walls[:, :2], axis=1, keepdims=True)
    gap = np.linalg.norm(walls[:, :2], axis=1) - (out * place[:2]).sum(axis=1)
    return int(gap.argmin())


def repainted(source: Source, world: World) -> World:
    """Floors, walls, rugs and boxes get the prints and patterns of the scene's style, most of them."""
    style: Style = source.style
    painters = {"floor": style.floor, "rug": style.cloth, "box": lambda: style.package((0.2, 0.2)), "sofa": style.cloth}
    materials = list(world.materials)
    wall = style.wall() if source.chance(0.6) else None
    shared = set(np.unique(world.material_ids[np.isin(world.labels, _named(world, ("table", "chair", "cabinet")))]))
    hung = {int(m) for m in np.unique(world.material_ids[np.isin(world.labels, _named(world, _HUNG))])}
    for name, paint in painters.items():
        for instance in _named(world, (name,)):
            for material in np.unique(world.material_ids[world.labels == instance]):
                if material not in shared and source.chance(0.7):
                    materials[int(material)] = paint()
    if wall is not None:
        for instance in _named(world, ("wall",)):
            ids, count = np.unique(world.material_ids[world.labels == instance], return_counts=True)
            if int(ids[0]) not in hung and count[0] >= 12:  # the slab itself is the first part of its wall
                materials[int(ids[0])] = wall
    return replace(world, materials=tuple(materials))


def _named(world: World, names: tuple[str, ...]) -> Array:
    return np.flatnonzero(np.isin(np.array(world.names), names))


def _clutter(source: Source, stage: Stage, world: World) -> None:
    """Things that rest in contact on the surfaces of the room."""
    rng, cell = source.rng, 0.01
    half = np.array(world.room[:2]) / 2 - 0.05
    places = Support(rng, stage, tuple(-half), tuple(half), 0.0, cell=cell)
    grid = places.heights.grid
    x, y = np.meshgrid(
        *((np.arange(n - 2) + 0.5) * cell - h for n, h in zip(grid.shape, half, strict=True)), indexing="ij"
    )
    rays = np.zeros((x.size, 6), dtype=np.float32)
    rays[:, 0], rays[:, 1], rays[:, 2], rays[:, 5] = x.ravel(), y.ravel(), _EYE, -1.0
    _, distance, _, _ = QuickRenderer(world).cast(rays)
    grid[1:-1, 1:-1] = np.maximum(_EYE - np.where(np.isfinite(distance), distance, _EYE), 0).reshape(x.shape)
    for _ in range(source.count(6, 18)):
        item = source.thing(0.6)
        way = rng.random()
        if way < 0.5:
            places.stand(item, stacked=0.8)
        elif way < 0.75:
            places.drop(item)
        else:
            places.beside(item)


def united(first: World, second: World) -> World:
    """Both worlds' things; lamps and room are the first's."""
    more, shift = len(first.names), len(first.materials)
    return replace(
        first,
        triangles=np.concatenate([first.triangles, second.triangles]),
        corners=np.concatenate([first.corners, second.corners]),
        labels=np.concatenate([first.labels, second.labels + more]),
        material_ids=np.concatenate([first.material_ids, second.material_ids + shift]),
        materials=first.materials + second.materials,
        names=first.names + second.names,
        kinds=first.kinds + second.kinds,
    )
