"""Makes one room: floor and walls, furniture along the walls, a table group in the middle, small things on top."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from torchjoint_lab.synthetic.furnished import clutter, furniture
from torchjoint_lab.synthetic.furnished import materials as paint
from torchjoint_lab.synthetic.furnished.arrays import Rng
from torchjoint_lab.synthetic.furnished.layout import Footprints, fill_shelf, furnish
from torchjoint_lab.synthetic.furnished.materials import Material
from torchjoint_lab.synthetic.furnished.mesh import box
from torchjoint_lab.synthetic.furnished.site import Site
from torchjoint_lab.synthetic.furnished.world import Item, Light, Pose, World, WorldBuilder

#: Items along walls, with their probabilities.
_ALONG_WALLS = {"cabinet": 0.42, "high": 0.1, "bookcase": 0.08, "sofa": 0.07, "lamp": 0.09, "bin": 0.06, "gap": 0.18}


#: Adds more to a furnished room; its second argument is :attr:`World.focus`.
FurnishMore = Callable[[Site, tuple[float, float, float, float]], None]


def make_world(
    rng: Rng, clutter_factor: float = 1.0, textures: bool = True, furnish_more: FurnishMore | None = None
) -> World:
    """Makes a furnished room; its floor is at z = 0 and its middle at the origin.

    Args:
        rng: source of all random choices.
        clutter_factor: scales the number of small things on surfaces; 1 gives 90-180 instances.
        textures: False: every material gets the mean colour of its texture.
        furnish_more: adds more to the room when it is furnished; the rest of the room does not change.
    """
    size = (float(rng.uniform(3.9, 5.2)), float(rng.uniform(3.5, 4.4)), float(rng.uniform(2.4, 2.7)))
    site = Site(size, clutter_factor, WorldBuilder(), Footprints())
    _shell(site, rng)
    focus = _table_group(site, rng)
    for wall in rng.permutation(4):
        _along_wall(site, rng, int(wall))
    for wall in range(4):
        _on_wall(site, rng, wall)
    _on_floor(site, rng)
    if furnish_more is not None:
        furnish_more(site, focus)
    world = site.builder.build(_lights(rng, size), float(rng.uniform(0.2, 0.5)), size, focus)
    return world if textures else replace(world, materials=tuple(map(_untextured, world.materials)))


def _untextured(material: Material) -> Material:
    mean = material.tile.reshape(-1, 3).mean(axis=0).round().astype(np.uint8)
    return Material(mean[None, None], material.size, material.gloss, material.absorbs)


def _shell(site: Site, rng: Rng) -> None:
    """Adds floor, four walls and, in two of three rooms, a ceiling: slabs outside of the room's inner box."""
    (w, d, h), builder, t = site.size, site.builder, 0.1
    tone = paint.pick(rng, paint.SOBER[2:4] + paint.WOODS)
    floors = (
        lambda: paint.carpet(rng, tone),
        lambda: paint.wood(rng, paint.pick(rng, paint.WOODS), planks=8),
        lambda: paint.tiles(rng, tone, rng.uniform(0.2, 0.35)),
    )
    builder.place(Item("floor", (w, d, t), [(box((w, d, t)), floors[rng.integers(3)]())]), Pose(z=-t))
    color = paint.pick(rng, paint.WALLS)
    for wall in range(4):
        length = site.length(wall)
        tiled = rng.random() < 0.2
        coat = (
            paint.tiles(rng, paint.pick(rng, paint.WALLS), 0.1)
            if tiled
            else paint.plain(rng, color * rng.uniform(0.97, 1), gloss=0.0)
        )
        builder.place(Item("wall", (length, t, h), [(box((length, t, h)), coat)]), site.at_wall(wall, 0.0, -t))
    if rng.random() < 0.67:
        white = paint.plain(rng, np.array([0.9, 0.9, 0.88]), gloss=0.0)
        builder.place(Item("ceiling", (w, d, t), [(box((w, d, t)), white)]), Pose(z=h))


def _lights(rng: Rng, room: tuple[float, float, float]) -> tuple[Light, ...]:
    count = int(rng.integers(1, 4))
    lights = []
    for _ in range(count):
        at = np.array([*(rng.uniform(-0.35, 0.35, 2) * room[:2]), room[2] - 0.05])
        warmth = rng.uniform(-0.12, 0.12)
        power = np.array([1 + warmth, 1, 1 - warmth]) * rng.uniform(0.6, 1.4) * 4 / count
        lights.append(Light(at, float(rng.uniform(0.05, 0.2)), power))
    return tuple(lights)


def _table_group(site: Site, rng: Rng) -> tuple[float, float, float, float]:
    """Adds a table near the middle, chairs around it and sometimes a rug below; returns :attr:`World.focus`."""
    builder = site.builder
    wood = paint.wood(rng, paint.pick(rng, paint.WOODS), planks=4)
    table = furniture.table(rng, wood)
    yaw = float(rng.choice([0, np.pi / 2], p=[0.75, 0.25]) + rng.normal(0, 0.06))
    home = Pose(rng.uniform(-0.25, 0.25), rng.uniform(-0.25, 0.25), 0.0, yaw)
    if rng.random() < 0.4:
        builder.place(furniture.rug(rng, table.size[0] + 0.8, table.size[1] + 0.8), home)
    pose = builder.place(table, home)
    site.taken.claim(table, pose, 0.6)  # leaves room for the chairs
    frame = wood if rng.random() < 0.5 else paint.wood(rng, paint.pick(rng, paint.WOODS), upright=True)
    cushion = paint.plain(rng, paint.pick(rng, paint.SOBER + paint.VIVID), gloss=0.2) if rng.random() < 0.6 else frame
    slats = int(rng.integers(2, 5))
    w, d, _ = table.size
    places = [(x, -d / 2, np.pi) for x in (-0.2 * w, 0.2 * w)] + [(x, d / 2, 0.0) for x in (-0.2 * w, 0.2 * w)]
    places += [(w / 2, 0, -np.pi / 2), (-w / 2, 0, np.pi / 2)]
    for i in rng.permutation(len(places))[: rng.integers(3, 6)]:
        x, y, turn = places[i]
        out = rng.uniform(0.02, 0.3)  # distance by which the chair is pulled out from the table
        at = pose.at(x, y, 0, turn).at(rng.normal(0, 0.02), out, 0, rng.normal(0, 0.12))
        builder.place(furniture.chair(rng, frame, cushion, slats), at)
    count = int(rng.integers(8, 14) * (0.5 + 0.5 * site.clutter))
    furnish(builder, rng, pose, table.surfaces[0], count, wood)
    reach = abs(np.cos(yaw)), abs(np.sin(yaw))
    return home.x, home.y, (w * reach[0] + d * reach[1]) / 2, (w * reach[1] + d * reach[0]) / 2


def _along_wall(site: Site, rng: Rng, wall: int) -> None:
    """Fills a wall from one end to the other; half of the neighbours touch each other."""
    end = site.length(wall) / 2
    front = (
        paint.plain(rng, paint.pick(rng, paint.VIVID + paint.SOBER + paint.WALLS), gloss=0.3)
        if rng.random() < 0.6
        else paint.wood(rng, paint.pick(rng, paint.WOODS), upright=True)
    )
    height, depth = float(rng.uniform(0.75, 0.95)), float(rng.uniform(0.45, 0.6))
    along = -end + rng.uniform(0.0, 0.2)
    while along < end - 0.3:
        width = min(float(rng.uniform(0.5, 1.7)), end - along)
        item = _wall_item(rng, front, width, height, depth)
        if item is None:
            along += rng.uniform(0.4, 1.0)
            continue
        pose = site.at_wall(wall, along + item.size[0] / 2, item.size[1])
        if along + item.size[0] <= end and site.taken.claim(item, pose):
            site.builder.place(item, pose)
            _load(site, rng, item, pose)
            along += item.size[0] + (0.0 if rng.random() < 0.5 else rng.uniform(0.02, 0.4))
        else:
            along += 0.15


def _wall_item(rng: Rng, front: Material, width: float, height: float, depth: float) -> Item | None:
    """A random item of :data:`_ALONG_WALLS`; None: a gap. Cabinets of a wall share ``front``, ``height``, ``depth``."""
    kind = rng.choice(list(_ALONG_WALLS), p=list(_ALONG_WALLS.values()))
    if kind == "cabinet":
        return furniture.cabinet(rng, front, width, height, depth)
    if kind == "high":
        return furniture.cabinet(rng, front, max(0.45, 0.6 * width), rng.uniform(1.7, 2.1), depth)
    if kind == "bookcase":
        return furniture.bookcase(rng, front, max(0.5, 0.7 * width))
    if kind == "gap":
        return None
    return {"sofa": furniture.sofa, "lamp": furniture.lamp, "bin": furniture.bin_}[kind](rng)


def _load(site: Site, rng: Rng, item: Item, pose: Pose) -> None:
    """Puts things on an item that stands along a wall."""
    for surface in item.surfaces:
        if item.name == "bookcase":
            fill_shelf(site.builder, rng, pose, surface, site.clutter)
            continue
        per_metre = 1.0 if item.name == "sofa" else 3.7
        count = rng.poisson(per_metre * site.clutter * (surface.high[0] - surface.low[0]))
        furnish(site.builder, rng, pose, surface, int(count))


def _on_wall(site: Site, rng: Rng, wall: int) -> None:
    """Adds door, screen, shelf, posters and pictures where no item stands in front of them."""
    hung = [furniture.door(rng)] if rng.random() < 0.6 else []
    hung += [furniture.screen(rng)] if rng.random() < 0.25 else []
    white = paint.wood(rng, paint.pick(rng, paint.WOODS))
    hung += [furniture.wall_shelf(rng, white)] if rng.random() < 0.5 else []
    hung += [furniture.poster(rng) for _ in range(rng.integers(1, 5))]
    for item in hung:
        for _ in range(10):
            along = rng.uniform(-0.5, 0.5) * (site.length(wall) - item.size[0])
            z = 0.0 if item.name == "door" else float(rng.uniform(1.35 if item.surfaces else 1.05, 1.45))
            pose = site.at_wall(wall, along, item.size[1], z)
            if item.size[2] + z < site.size[2] - 0.05 and site.taken.claim(item, pose, margin=0.01):
                site.builder.place(item, pose)
                for surface in item.surfaces:
                    furnish(site.builder, rng, pose, surface, int(rng.poisson(4 * site.clutter)))
                break


def _on_floor(site: Site, rng: Rng) -> None:
    """Adds boxes, balls and bins on the free floor."""
    for _ in range(round(rng.integers(2, 6) * (0.5 + 0.5 * site.clutter))):
        make = (clutter.carton, clutter.sphere, furniture.bin_, clutter.tray)[rng.integers(4)]
        item = make(rng)
        spread = np.array(site.size[:2]) / 2 - 0.3
        for _ in range(10):
            x, y = rng.uniform(-spread, spread)
            pose = Pose(float(x), float(y), 0.0, float(rng.uniform(-np.pi, np.pi)))
            if site.taken.claim(item, pose, 0.02):
                site.builder.place(item, pose)
                break
